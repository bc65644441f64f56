// An object's outline and support points, drawn on a sheet in mm. The command keeps them, so a reload loses nothing.
import { made, niceStep } from "./drawings.js";

const FARTHEST = 1e5; // of a coordinate [mm]
const NEAR_PX = 14; // a click this close to a point on the screen chooses it
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

const token = new URLSearchParams(location.search).get("token") ?? "";
const headers = token ? { Authorization: `Bearer ${token}` } : {};
const at = (id) => document.getElementById(id);
const round = (value) => Math.round(100 * Math.min(Math.max(value, -FARTHEST), FARTHEST)) / 100;

// What is asked of the command, one after the other

let last = Promise.resolve();
let open = 0;
function asked(what, options) {
  document.body.ariaBusy = ++open > 0;
  last = last.then(async () => {
    const answer = await fetch(what, { headers, ...options });
    return answer.headers.get("Content-Type") === "image/png" ? answer.blob() : answer.json();
  });
  const mine = last;
  last = mine.catch(() => {}).finally(() => (document.body.ariaBusy = --open > 0));
  return mine;
}

async function tell(what, body) {
  try {
    const answer = await asked(what, { method: "POST", body });
    if (!answer.done) say(answer.message, true);
    return answer;
  } catch {
    return gone();
  }
}

function gone() {
  say("Nobody answers: the command has ended", true);
  return { done: false };
}

function say(text, failed) {
  at("answer").textContent = text;
  at("answer").classList.toggle("failed", failed);
  at("answer").hidden = false;
}

let address = "";
/** The command's present picture. */
async function loaded() {
  if (address) URL.revokeObjectURL(address);
  return (address = URL.createObjectURL(await asked("picture.png")));
}

/** Where an event happens in a drawing, in its units. */
function under(svg, event) {
  const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  return [round(x), round(y)];
}

/** A cross with its middle left open, so that the point can be seen. */
function cross(u, v, size, name) {
  const from = size * 0.3, d = `M${u - size} ${v}H${u - from}M${u + from} ${v}H${u + size}M${u} ${v - size}V${v - from}M${u} ${v + from}V${v + size}`;
  return [made("path", { class: "halo", d }), made("path", { class: name, d })];
}

/** A word beside a place, as large on the screen at every scale. */
function label(x, y, text, scale) {
  const element = made("text", { x: x + 8 * scale, y: y - 7 * scale }, text);
  element.style.fontSize = `${15 * scale}px`;
  return element;
}

/** A line of the table of points, which can be chosen and removed. */
function rowOf(index, chosen, cells, choose, remove) {
  const line = document.createElement("tr"), button = document.createElement("button");
  line.classList.toggle("chosen", index === chosen);
  for (const [label, text] of cells) {
    const cell = line.insertCell();
    cell.dataset.label = label;
    cell.textContent = text;
  }
  button.textContent = "Remove";
  button.ariaLabel = `Remove ${cells[0].join(" ")}`;
  button.addEventListener("click", (event) => {
    event.stopPropagation();
    remove(index);
  });
  line.insertCell().append(button);
  line.addEventListener("click", () => choose(index));
  return line;
}

// The drawing

const LOUPE = { width: 16, height: 12 }; // mm
const MARGIN = 0.3; // of the outline's longer side
const WRONG = "Not an object yet";
let state = null; // what the command says
let drawn = null; // what is sent to it, in mm and degrees
let kind = "outline"; // of the points that are drawn
let chosen = -1;
let picture = ""; // its address
let view = null; // of the sheet: x, y, width, height in its drawing, whose y points down

const known = () => (kind === "outline" ? drawn.outline : drawn.support.points ?? []);
const scaled = (factor) => (points) => points.map(([x, y]) => [+(factor * x).toFixed(6), +(factor * y).toFixed(6)]);
const inMm = scaled(1e3), inMetres = scaled(1e-3);

async function begin() {
  try {
    take(await asked("state"));
    chosen = drawn ? drawn.outline.length - 1 : -1;
    if (!state.done) return say(state.message, true);
    if (state.has_picture) picture = await loaded();
    fit();
  } catch {
    gone();
  }
}

function take(answer) {
  state = answer;
  if (!answer.done) return;
  const { grid, inset, spacing, points } = answer.support, [x, y, turn] = answer.picture;
  drawn = { outline: inMm(answer.outline), support: { grid, inset, spacing, points: points && inMm(points) }, picture: [1e3 * x, 1e3 * y, turn] };
}

let changes = 0;
async function changed(find = false) {
  if (area(drawn.outline) < 0) { // corners go counter-clockwise, as the pushes' edges count
    drawn.outline.reverse();
    if (kind === "outline" && chosen >= 0) chosen = drawn.outline.length - 1 - chosen;
  }
  redraw();
  const mine = ++changes, [x, y, turn] = drawn.picture, { points, ...even } = drawn.support;
  const support = points ? { points: inMetres(points) } : even;
  const answer = await tell("work", JSON.stringify({ outline: inMetres(drawn.outline), support, picture: [x / 1e3, y / 1e3, turn], find }));
  if (!answer.done) at("save").disabled = Boolean(state.problem) || !find;
  else if (mine === changes) {
    find ? take(answer) : (state = answer);
    redraw();
  }
  return answer.done;
}

function area(corners) {
  return corners.reduce((sum, [x, y], index) => {
    const [u, v] = corners[(index + 1) % corners.length];
    return sum + (x * v - u * y) / 2;
  }, 0);
}

// Points

function add(x, y) {
  const points = known(), place = kind === "outline" && points.length > 2 ? edgeNear(points, x, y) + 1 : points.length;
  points.splice(place, 0, [round(x), round(y)]);
  chosen = place;
  changed();
}

/** A further point by the keyboard: in the middle of the edge after the chosen corner, or of the object. */
function addNext() {
  const points = known(), [left, top, width, height] = view;
  if (kind === "outline" && chosen >= 0 && points.length > 2) {
    const [a, b] = [points[chosen], points[(chosen + 1) % points.length]];
    points.splice(chosen + 1, 0, [round((a[0] + b[0]) / 2), round((a[1] + b[1]) / 2)]);
    chosen += 1;
    return changed();
  }
  add(left + width / 2, -(top + height / 2));
}

/** The edge to which a point is nearest. */
function edgeNear(corners, x, y) {
  const far = corners.map(([ax, ay], index) => {
    const [bx, by] = corners[(index + 1) % corners.length], [ex, ey] = [bx - ax, by - ay];
    const along = Math.min(1, Math.max(0, ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey || 1)));
    return Math.hypot(x - ax - along * ex, y - ay - along * ey);
  });
  return far.indexOf(Math.min(...far));
}

function put(x, y) {
  known()[chosen] = [round(x), round(y)];
  changed();
}

function remove(index) {
  known().splice(index, 1);
  chosen = Math.min(chosen, known().length - 1);
  changed();
}

function choose(index) {
  chosen = index;
  redraw();
}

/** Draw corners or support points. Support points are drawn where they are known, which the grid is not. */
function draw(what) {
  kind = what;
  chosen = known().length - 1;
  if (kind === "support" && !drawn.support.points) return setSupport("points");
  redraw();
}

const before = {}; // the grid, while points are drawn, and the points, while a grid is
function setSupport(way) {
  const { points, ...even } = drawn.support;
  if (points) before.points = points;
  else before.grid = even;
  drawn.support = way === "points" ? { points: before.points ?? [] } : before.grid ?? state.usual;
  kind = way === "points" ? "support" : "outline";
  chosen = known().length - 1;
  changed();
}

/** The point at which an event happens; -1 if it happens at none. */
function pointAt(event) {
  const [u, v] = under(at("picture"), event), far = known().map(([x, y]) => Math.hypot(x - u, -y - v) / perPixel());
  return far.findIndex((one) => one < NEAR_PX && one === Math.min(...far));
}

let dragged = false;
at("picture").addEventListener("pointerdown", (event) => {
  if (!state || pointAt(event) < 0) return;
  dragged = true;
  at("picture").setPointerCapture(event.pointerId);
  choose(pointAt(event));
});
at("picture").addEventListener("click", (event) => {
  if (!state || pointAt(event) >= 0) return;
  const [u, v] = under(at("picture"), event);
  add(u, -v);
});
at("picture").addEventListener("pointermove", (event) => {
  if (!dragged || !state || !known()[chosen]) return;
  const [u, v] = under(at("picture"), event);
  if (known()[chosen][0] !== u || known()[chosen][1] !== -v) put(u, -v);
});
for (const end of ["pointerup", "pointercancel"]) at("picture").addEventListener(end, () => (dragged = false));

at("loupe").addEventListener("click", (event) => {
  const [u, v] = under(at("loupe"), event);
  if (known()[chosen]) put(u, -v);
});

for (const [id, step] of [["picture", 1], ["loupe", 0.1]]) {
  at(id).addEventListener("keydown", (event) => {
    if (!state) return;
    const arrow = ARROWS[event.key], far = event.shiftKey ? 10 * step : step, point = known()[chosen], count = known().length;
    if (arrow && point) put(point[0] + far * arrow[0], point[1] - far * arrow[1]);
    else if (event.key === "Enter") addNext();
    else if (event.key === "Delete" && point) remove(chosen);
    else if (event.key.startsWith("Page") && count) choose((chosen + count + (event.key === "PageDown" ? 1 : -1)) % count);
    else return;
    event.preventDefault();
  });
}

for (const [id, axis] of [["x", 0], ["y", 1]]) {
  at(id).addEventListener("input", () => {
    if (!Number.isFinite(at(id).valueAsNumber)) return;
    known()[chosen][axis] = round(at(id).valueAsNumber);
    changed();
  });
}
["picture_x", "picture_y", "picture_turn"].forEach((id, index) => {
  at(id).addEventListener("input", () => {
    drawn.picture[index] = at(id).valueAsNumber || 0;
    changed();
  });
});
for (const id of ["columns", "rows_of_grid"]) {
  at(id).addEventListener("input", () => {
    const grid = ["columns", "rows_of_grid"].map((one) => Math.max(1, Math.round(at(one).valueAsNumber) || 1));
    drawn.support = { grid, inset: drawn.support.inset };
    changed();
  });
}
for (const radio of document.querySelectorAll("[name=kind]")) radio.addEventListener("change", () => draw(radio.value));
for (const radio of document.querySelectorAll("[name=support]")) radio.addEventListener("change", () => setSupport(radio.value));
at("fit").addEventListener("click", () => fit());
at("find").addEventListener("click", () => {
  draw("outline");
  changed(true).then(fit);
});
at("another").addEventListener("click", async () => {
  at("another").disabled = true;
  if ((await tell("another")).done) {
    picture = await loaded();
    take(await asked("state"));
    redraw();
  }
  at("another").disabled = false;
});
at("save").addEventListener("click", async () => {
  at("save").disabled = true;
  const answer = (await changed()) && (await tell("save")); // another page may have drawn since
  if (!answer?.done) return (at("save").disabled = false);
  say(answer.message, false);
  at("prompt").textContent = "Saved";
  at("now").className = "finished";
  for (const control of document.querySelectorAll("button, input")) control.disabled = true;
  state = null;
});

// The page

/** Millimetres of the sheet for one pixel of the screen. */
const perPixel = () => view[2] / at("picture").clientWidth;

/** Show the outline with a margin, or all of the picture, or an empty sheet. */
function fit() {
  const { left, bottom, width, height } = state.region, all = [1e3 * left, -1e3 * (bottom + height), 1e3 * width, 1e3 * height];
  view = all;
  if (drawn.outline.length > 2) {
    const [xs, ys] = [0, 1].map((axis) => drawn.outline.map((corner) => corner[axis]));
    const [low, high] = [[Math.min(...xs), Math.min(...ys)], [Math.max(...xs), Math.max(...ys)]];
    const margin = MARGIN * Math.max(high[0] - low[0], high[1] - low[1]);
    view = [low[0] - margin, -high[1] - margin, high[0] - low[0] + 2 * margin, high[1] - low[1] + 2 * margin];
  }
  redraw();
}

/** Side of a square: about fifteen lie along the longer side. */
const step = () => niceStep(Math.max(view[2], view[3]), 15);

function redraw() {
  if (!state) return;
  const { problem } = state, support = drawn.support, points = known();
  at("target").textContent = state.target.split("/").at(-1);
  at("target").title = state.target;
  at("source").textContent = state.source ? `over ${state.source}` : "";
  at("another").hidden = at("find").hidden = !state.has_picture;
  at("now").className = problem ? "placing" : "finished";
  write("prompt", prompt());
  write("trust", problem ? (at("prompt").textContent === WRONG ? problem : "") : `${drawn.outline.length} corners, ${state.supports.length} support points`);
  at("trust").classList.toggle("problem", Boolean(problem));
  at("save").disabled = Boolean(problem);
  at("step").textContent = step();
  for (const radio of document.querySelectorAll("[name=kind]")) radio.checked = radio.value === kind;
  for (const radio of document.querySelectorAll("[name=support]")) radio.checked = (radio.value === "points") === Boolean(support.points);
  const grid = support.grid ?? before.grid?.grid ?? ["", ""];
  ["columns", "rows_of_grid"].forEach((id, index) => {
    at(id).disabled = Boolean(support.points);
    if (at(id).valueAsNumber !== grid[index]) at(id).value = grid[index];
  });
  at("placing").hidden = !state.has_picture;
  document.body.classList.remove("waiting");
  ["picture_x", "picture_y", "picture_turn"].forEach((id, index) => {
    if ((at(id).valueAsNumber || 0) !== drawn.picture[index] || !at(id).value) at(id).value = drawn.picture[index];
  });
  drawSheet(at("picture"), view, perPixel(), true);
  const [x, y] = points[chosen] ?? [view[0] + view[2] / 2, -view[1] - view[3] / 2];
  drawSheet(at("loupe"), [x - LOUPE.width / 2, -y - LOUPE.height / 2, LOUPE.width, LOUPE.height], LOUPE.width / at("loupe").clientWidth, false);
  at("chosen").textContent = points[chosen] ? nameOf(chosen) : "The chosen point";
  for (const [id, axis] of [["x", 0], ["y", 1]]) {
    const input = at(id), value = points[chosen]?.[axis];
    input.disabled = value === undefined;
    if (value === undefined) input.value = "";
    else if (input.valueAsNumber !== value) input.value = value; // what is being typed, such as "1.", stays
  }
  at("rows_name").textContent = kind === "outline" ? "Corners" : "Support points";
  at("rows").replaceChildren(...points.map(([x, y], index) => {
    return rowOf(index, chosen, [[kind === "outline" ? "corner" : "support point", index], ["x [mm]", x], ["y [mm]", y]], choose, remove);
  }));
  at("no_rows").hidden = points.length > 0;
  at("picture").ariaLabel = `The object from above, ${points[chosen] ? `${nameOf(chosen)} at x ${points[chosen][0]} mm, y ${points[chosen][1]} mm` : "no point chosen"}`;
}

const nameOf = (index) => `${kind === "outline" ? "Corner" : "Support point"} ${index}`;

function prompt() {
  if (drawn.outline.length < 3) return `Draw the outline: ${3 - drawn.outline.length} or more corners`;
  if (drawn.support.points && !drawn.support.points.length) return "Draw the points where it touches the table";
  return state.problem ? WRONG : "Save, or go on";
}

// Text that is read out: only if it changes
function write(id, text) {
  if (at(id).textContent !== text) at(id).textContent = text;
}

/** The sheet, or a part of it: squares, axes, picture, outline and supports. */
function drawSheet(svg, [left, top, width, height], scale, whole) {
  svg.setAttribute("viewBox", `${left} ${top} ${width} ${height}`);
  svg.style.aspectRatio = `${width} / ${height}`;
  const parts = [], points = known(), support = drawn.support.points ?? inMm(state.supports);
  if (picture) {
    const { left, bottom, width, height } = state.region, [x, y, turn] = drawn.picture;
    const lies = { x: 1e3 * left, y: -1e3 * (bottom + height), width: 1e3 * width, height: 1e3 * height };
    parts.push(made("image", { href: picture, ...lies, preserveAspectRatio: "none", transform: `translate(${x} ${-y}) rotate(${-turn})` }));
  }
  const size = whole ? step() : 1;
  for (let x = Math.ceil(left / size) * size; x <= left + width; x += size) parts.push(made("path", { class: "square", d: `M${x} ${top}v${height}` }));
  for (let y = Math.ceil(top / size) * size; y <= top + height; y += size) parts.push(made("path", { class: "square", d: `M${left} ${y}h${width}` }));
  for (const [name, x, y] of [["x", step(), 0], ["y", 0, step()]]) {
    parts.push(made("path", { class: "axis_line", d: `M0 0L${x} ${-y}` }));
    if (whole) parts.push(label(x, -y, name, scale));
  }
  const corners = drawn.outline.map(([x, y]) => `${x} ${-y}`);
  if (corners.length) parts.push(made("path", { class: "drawn", d: `M${corners.join("L")}${corners.length > 2 ? "Z" : ""}` }));
  for (const [x, y] of support) parts.push(made("circle", { class: "support", cx: x, cy: -y, r: 4 * scale }));
  points.forEach(([x, y], index) => {
    parts.push(...cross(x, -y, 9 * scale, index === chosen ? "mark chosen" : "mark"));
    if (whole) parts.push(label(x, -y, index, scale));
  });
  svg.replaceChildren(...parts);
}

addEventListener("resize", redraw);
begin();
