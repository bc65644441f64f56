// Points of the table, clicked in the camera's picture. The command keeps them, so a reload loses nothing.
import { ARROWS, NEAR_PX, asked, at, cross, gone, label, loaded, made, round, rowOf, say, tell, under, whenSaved } from "./sheet.js";

const LOUPE = { width: 32, height: 24 }; // px of the picture
let state = null; // what the command says
let points = []; // [u, v, x, y]; x and y are null until they are typed
let chosen = -1;
let picture = ""; // its address

const mm = (metres, digits = 2) => (Number.isFinite(metres) ? (1e3 * metres).toFixed(digits) : "–");

async function begin() {
  try {
    state = await asked("state");
    if (!state.done) return say(state.message, true);
    points = state.points;
    chosen = points.length - 1;
    await load();
  } catch {
    gone();
  }
}

async function load() {
  picture = await loaded();
  redraw();
}

let changes = 0;
async function changed() {
  redraw();
  const mine = ++changes;
  const answer = await tell("work", JSON.stringify(points));
  if (answer.done && mine === changes) {
    state = answer;
    redraw();
  }
}

// Points

function add(u, v) {
  const used = new Set(points.map(([, , x, y]) => `${x} ${y}`));
  const [x, y] = state.marks.find(([x, y]) => !used.has(`${x} ${y}`)) ?? [null, null];
  points.push([u, v, x, y]);
  choose(points.length - 1);
  changed();
}

function choose(index) {
  chosen = index;
  redraw();
}

function put(u, v) {
  const inside = (value, size) => Math.min(Math.max(round(value), 0), size - 1);
  points[chosen].splice(0, 2, inside(u, state.width), inside(v, state.height));
  changed();
}

at("picture").addEventListener("click", (event) => {
  if (!state) return;
  const [u, v] = under(at("picture"), event), scale = perPixel();
  const far = points.map(([a, b]) => Math.hypot(a - u, b - v) / scale);
  const nearest = far.indexOf(Math.min(...far));
  if (far[nearest] < NEAR_PX) return choose(nearest);
  if (u < 0 || v < 0 || u > state.width - 1 || v > state.height - 1) return;
  add(u, v);
  // a keyboard on the screen would hide the picture
  if (event.pointerType === "mouse" && points[chosen][2] === null) at("x").focus();
});

at("loupe").addEventListener("click", (event) => {
  if (points[chosen]) put(...under(at("loupe"), event));
});

for (const [id, step] of [["picture", 1], ["loupe", 0.1]]) {
  at(id).addEventListener("keydown", (event) => {
    if (!state) return;
    const arrow = ARROWS[event.key], far = event.shiftKey ? 10 * step : step;
    if (arrow && points[chosen]) put(points[chosen][0] + far * arrow[0], points[chosen][1] + far * arrow[1]);
    else if (event.key === "Enter" && id === "picture") add(Math.round(state.width / 2), Math.round(state.height / 2));
    else return;
    event.preventDefault();
  });
}

for (const [id, axis] of [["x", 2], ["y", 3]]) {
  at(id).addEventListener("input", () => {
    points[chosen][axis] = typed(at(id));
    changed();
  });
}

at("another").addEventListener("click", async () => {
  at("another").disabled = true;
  if ((await tell("another")).done) await load();
  at("another").disabled = false;
});

whenSaved(() => (state = null));

// The page

/** Pixels of the picture for one of the screen. */
const perPixel = () => state.width / at("picture").clientWidth;

function redraw() {
  if (!state) return;
  const { fit } = state;
  at("target").textContent = state.target.split("/").at(-1);
  at("target").title = state.target;
  at("source").textContent = `from ${state.source}`;
  at("now").className = fit ? "finished" : "placing";
  at("prompt").textContent = prompt();
  at("trust").textContent = fit
    ? `The points are off by ${mm(fit.rms)} mm on the table (rms), ${fit.rms_px.toFixed(2)} px. A place anywhere in the picture is off by ${mm(fit.median)} mm (1 sigma, median), ${mm(fit.largest)} mm at worst.`
    : points.length ? state.problem : "Then say where it is on the table. The origin and the directions of x and y are yours to choose; z points up.";
  at("save").disabled = !fit;
  drawPicture();
  drawLoupe();
  drawPlace();
  drawRows();
  drawMap();
  document.body.classList.remove("waiting");
}

function prompt() {
  const next = state.marks[points.length];
  if (next) return `Click the point at x ${mm(next[0], 1)} mm, y ${mm(next[1], 1)} mm (${points.length + 1} of ${state.marks.length})`;
  if (state.fit) return "Save, or add points";
  return points.length && state.problem ? "Not calibrated yet" : "Click a point of the table";
}

function image() {
  return made("image", { href: picture, x: -0.5, y: -0.5, width: state.width, height: state.height, preserveAspectRatio: "none" });
}

const path = (line) => line.map(([u, v], index) => `${index ? "L" : "M"}${u} ${v}`).join("");

function drawPicture() {
  const svg = at("picture"), { fit } = state;
  svg.setAttribute("viewBox", `-0.5 -0.5 ${state.width} ${state.height}`);
  const scale = perPixel(), parts = [image()];
  if (fit) {
    for (const line of fit.lines) parts.push(made("path", { class: "grid_line", d: path(line) }));
    const [origin, x, y] = fit.axes;
    for (const [end, name] of [[x, "x"], [y, "y"]]) {
      parts.push(made("path", { class: "axis_line", d: path([origin, end]) }));
      parts.push(label(...end, name, scale));
    }
    for (const [u, v] of fit.seen) parts.push(made("circle", { class: "seen", cx: u, cy: v, r: 5 * scale }));
  }
  points.forEach(([u, v], index) => {
    parts.push(...cross(u, v, 11 * scale, index === chosen ? "mark chosen" : "mark"));
    parts.push(label(u, v, index + 1, scale));
  });
  svg.replaceChildren(...parts);
}

function drawLoupe() {
  const svg = at("loupe"), point = points[chosen];
  const [u, v] = point ?? [(state.width - 1) / 2, (state.height - 1) / 2];
  svg.setAttribute("viewBox", `${u - LOUPE.width / 2} ${v - LOUPE.height / 2} ${LOUPE.width} ${LOUPE.height}`);
  const parts = [image()], seen = state.fit?.seen[chosen];
  if (seen) parts.push(made("circle", { class: "seen", cx: seen[0], cy: seen[1], r: 0.8 }));
  if (point) parts.push(...cross(u, v, 5, "mark chosen"));
  svg.replaceChildren(...parts);
}

function drawPlace() {
  const point = points[chosen];
  at("chosen").textContent = point ? `Point ${chosen + 1} at (${point[0].toFixed(1)}, ${point[1].toFixed(1)}) px` : "The chosen point";
  for (const [id, axis] of [["x", 2], ["y", 3]]) {
    const input = at(id), value = point?.[axis] ?? null;
    input.disabled = !point;
    // what is being typed, such as "1.", stays
    if (value !== typed(input)) input.value = value === null ? "" : +(1e3 * value).toFixed(6);
  }
}

function typed(input) {
  return Number.isFinite(input.valueAsNumber) ? +(input.valueAsNumber / 1e3).toFixed(9) : null;
}

function drawRows() {
  const known = (value) => (value === null ? "–" : `${+(1e3 * value).toFixed(3)}`);
  at("rows").replaceChildren(...points.map(([, , x, y], index) => {
    const off = state.fit ? mm(state.fit.errors[index]) : "–";
    return rowOf(index, chosen, [["point", index + 1], ["x [mm]", known(x)], ["y [mm]", known(y)], ["off by [mm]", off]], choose, remove);
  }));
  at("no_rows").hidden = points.length > 0;
}

function remove(index) {
  points.splice(index, 1);
  chosen = Math.min(chosen, points.length - 1);
  changed();
}

function drawMap() {
  const svg = at("map"), { fit } = state;
  const wide = 420, high = Math.round((wide * state.height) / state.width);
  svg.setAttribute("viewBox", `0 0 ${wide} ${high}`);
  at("map_caption").textContent = fit ? "A stronger colour is worse. Points near it, and more points, make it better." : "At least four points give a calibration";
  if (!fit) return svg.replaceChildren();
  const rows = fit.map.length, columns = fit.map[0].length, parts = [];
  fit.map.forEach((line, i) => line.forEach((error, j) => {
    const x = (j * wide) / columns, y = (i * high) / rows, opacity = 0.08 + 0.5 * (error / fit.largest);
    parts.push(made("rect", { x, y, width: wide / columns, height: high / rows, "fill-opacity": opacity.toFixed(3) }));
    parts.push(made("text", { x: x + wide / columns / 2, y: y + high / rows / 2 + 5, "text-anchor": "middle" }, mm(error, error < 0.01 ? 2 : 0)));
  }));
  svg.replaceChildren(...parts);
}

addEventListener("resize", redraw);
begin();
