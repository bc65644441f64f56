// The drawings of the page: SVG in its own pixels, so that text and lines keep their size.
const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 640;
const CHI2_90 = 4.605; // the 90 % ellipse: x' C^-1 x <= this

export const number = (value) => (value === "inf" ? Infinity : typeof value === "number" ? value : NaN);

// The belief's p_CF; that of the program as long as nothing is believed
export const believed = (estimate) => estimate?.belief.center_of_friction ?? estimate?.center_of_friction;

export function made(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

export const path = (points, closed) => points.map(([x, y], index) => `${index ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("") + (closed ? "Z" : "");

/** A step of 1, 2 or 5 times a power of ten that divides a span into about this many parts. */
export function niceStep(span, parts) {
  const raw = span / parts, power = 10 ** Math.floor(Math.log10(raw));
  return power * ([1, 2, 5].find((step) => step * power >= raw) ?? 10);
}

/** The object in its own frame: w, p_CF with its ellipse, and where it was touched.
 *
 * `estimate` is what is shown, `pinned` what it is compared with; `moments` are the observations so far, `last` the newest of them.
 */
export function drawObject(svg, outline, estimate, pinned, moments, last) {
  if (!outline.length) {
    svg.replaceChildren();
    return;
  }
  const { to, back, scale, span } = ownFrame(svg, outline), parts = [];
  Object.assign(svg, { toScreen: to, toObject: back });
  parts.push(made("path", { class: "outline", d: path(outline.map(to), true) }));
  const counting = moments.filter(({ row }) => !row.excluded), every = Math.ceil(counting.length / MOST_CONTACTS);
  parts.push(made("path", { class: "contact", d: counting.filter((_, index) => index % every === 0).map((one) => wedge(one, to, 11)).join("") }));
  if (last) parts.push(made("path", { class: "touched", d: wedge(last, to, 20) }));
  const area = 0.1 * span[0] * span[1] * scale * scale; // of all discs together
  for (const [shown, kind] of [[estimate, "weight"], [pinned, "weight pinned"]]) {
    const weights = shown?.belief.w ?? shown?.w;
    shown?.support_points.forEach((point, index) => {
      const [u, v] = to(point), radius = Math.sqrt((area * number(weights[index])) / Math.PI);
      if (kind === "weight") parts.push(made("circle", { class: "point", cx: u, cy: v, r: 2.5 }));
      if (radius > 0.5) {
        const disc = made("circle", { class: kind, cx: u, cy: v, r: radius });
        disc.append(made("title", {}, `w ${(100 * weights[index]).toFixed(1)} % at (${(1e3 * point[0]).toFixed(1)}, ${(1e3 * point[1]).toFixed(1)}) mm`));
        parts.push(disc);
      }
    });
  }
  parts.push(made("g", { class: "pusher" }));
  for (const [shown, kind] of [[pinned, " pinned"], [estimate, ""]]) {
    const center = believed(shown)?.map(number);
    if (!center?.every(Number.isFinite)) continue;
    const [u, v] = to(center), spread = shown.belief.covariance;
    if (spread) parts.push(drawnEllipse(spread, u, v, scale, kind));
    parts.push(made("path", { class: `center${kind}`, d: `M${u - 11} ${v}H${u + 11}M${u} ${v - 11}V${v + 11}` }));
  }
  parts.push(...drawnScale(scale, OBJECT_HEIGHT));
  svg.replaceChildren(...parts);
}

const OBJECT_HEIGHT = 480;
const MOST_CONTACTS = 1500; // more of them would hide one another

// Where the object's own frame lies in a drawing
function ownFrame(svg, outline, share = 0.72) {
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${OBJECT_HEIGHT}`);
  const sides = [0, 1].map((axis) => outline.map((point) => point[axis])).map((values) => [Math.min(...values), Math.max(...values)]);
  const middle = sides.map(([low, high]) => (low + high) / 2), span = sides.map(([low, high]) => high - low);
  const scale = Math.min((share * WIDTH) / span[0], (0.92 * share * OBJECT_HEIGHT) / span[1]); // [px/m]
  const to = ([x, y]) => [WIDTH / 2 + (x - middle[0]) * scale, OBJECT_HEIGHT / 2 - 8 - (y - middle[1]) * scale];
  const back = ([u, v]) => [middle[0] + (u - WIDTH / 2) / scale, middle[1] + (OBJECT_HEIGHT / 2 - 8 - v) / scale];
  return { to, back, scale, span };
}

// A wedge from outside, along the inward normal
function wedge({ contact: [x, y, nx, ny] }, to, long) {
  const [u, v] = to([x, y]), side = [-0.45 * ny * long, 0.45 * nx * long];
  return path([[u, v], [u + long * nx + side[0], v - long * ny - side[1]], [u + long * nx - side[0], v - long * ny + side[1]]], true);
}

function drawnScale(scale, height) {
  const bar = niceStep(WIDTH / scale, 6);
  return [
    made("path", { class: "scale", d: `M20 ${height - 26}v8h${bar * scale}v-8` }),
    made("text", { x: 20 + (bar * scale) / 2, y: height - 24, "text-anchor": "middle" }, `${+(bar * 1e3).toPrecision(3)} mm`),
  ];
}

/** Where a moment's motion would take the object if it went on for a while: as it was seen, and as it had been predicted. */
export function drawPrediction(svg, outline, moment) {
  if (!outline.length || !moment) {
    svg.replaceChildren();
    return;
  }
  const { to, scale, span } = ownFrame(svg, outline, 0.6);
  const size = Math.hypot(...span), [vx, vy, omega] = moment.twist;
  const lasting = 0.18 * size / Math.max(Math.hypot(vx, vy) + 0.5 * size * Math.abs(omega), 1e-9);
  const parts = [made("path", { class: "outline", d: path(outline.map(to), true) })];
  for (const [twist, kind] of [[moment.twist, "happened"], [moment.predicted, "predicted"]]) {
    if (twist) parts.push(made("path", { class: kind, d: path(placed(outline, afterwards(twist, lasting)).map(to), true) }));
  }
  parts.push(made("path", { class: "touched", d: wedge(moment, to, 20) }));
  parts.push(...drawnScale(scale, OBJECT_HEIGHT));
  svg.replaceChildren(...parts);
}

// The pose after a constant twist of the object's own frame
function afterwards([vx, vy, omega], lasting) {
  const turn = omega * lasting;
  const [sine, versine] = Math.abs(turn) < 1e-6 ? [1, turn / 2] : [Math.sin(turn) / turn, (1 - Math.cos(turn)) / turn];
  return [lasting * (sine * vx - versine * vy), lasting * (versine * vx + sine * vy), turn];
}

function drawnEllipse([[xx, xy], [, yy]], u, v, scale, kind) {
  const mean = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy);
  const radii = [mean + half, Math.max(0, mean - half)].map((variance) => Math.max(1, Math.sqrt(CHI2_90 * variance) * scale));
  const turned = (-Math.atan2(2 * xy, xx - yy) / 2) * (180 / Math.PI);
  return made("ellipse", { class: `ellipse${kind}`, cx: u, cy: v, rx: radii[0], ry: radii[1], transform: `rotate(${turned} ${u} ${v})` });
}

/** The tip; one that may be elsewhere is hollow, and says so. */
function tipMark(pusher, [u, v], scale) {
  const radius = Math.max(4, pusher.radius * scale), circle = { class: `tip${pusher.in_doubt ? " doubted" : ""}`, cx: u, cy: v, r: radius };
  const said = pusher.age > 1 ? `in doubt, reported ${pusher.age.toFixed(0)} s ago` : "in doubt";
  return [made("circle", circle), ...(pusher.in_doubt ? [made("text", { x: u + radius + 5, y: v + 4 }, said)] : [])];
}

/** The pushing line and the tip, from the table into the object's frame. */
export function drawPusher(svg, outline, { pose, pusher }) {
  const parts = [];
  if (pose && pusher && outline.length) {
    const { to, scale } = ownFrame(svg, outline);
    const tip = turned([pusher.tip[0] - pose[0], pusher.tip[1] - pose[1]], -pose[2]), along = turned(pusher.direction, -pose[2]);
    const reach = WIDTH / scale;
    parts.push(made("path", { class: "line", d: path([-reach, reach].map((far) => to([tip[0] + far * along[0], tip[1] + far * along[1]]))) }));
    parts.push(...tipMark(pusher, to(tip), scale));
  }
  svg.querySelector(".pusher")?.replaceChildren(...parts);
}

const turned = ([x, y], theta) => [Math.cos(theta) * x - Math.sin(theta) * y, Math.sin(theta) * x + Math.cos(theta) * y];
const placed = (points, [x, y, theta]) => points.map((point) => turned(point, theta)).map(([u, v]) => [u + x, v + y]);

/** How far the object is from its place: [distance in m, angle in degrees, counter-clockwise]; undefined if either is unknown. */
export function wayToPlace({ pose, plan }) {
  if (!pose || plan?.phase !== "placing") return undefined;
  const [x, y, theta] = plan.placement;
  const turn = theta - pose[2];
  return [Math.hypot(x - pose[0], y - pose[1]), (Math.atan2(Math.sin(turn), Math.cos(turn)) * 180) / Math.PI];
}

/** The table from above, x to the right: its axes, the pushing line, the object with its axes, and where it is to be placed.
 *
 * `trail` are moments: the way that the object has gone, up to a moment that is looked back at.
 */
export function drawMap(svg, story, trail = []) {
  const height = 480, parts = [];
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${height}`);
  const { pose, pusher, plan } = story, outline = story.object?.outline ?? [];
  const ghost = plan?.phase === "placing" ? placed(outline, plan.placement) : [];
  const object = pose ? placed(outline, pose) : [];
  const home = pusher && pusher.direction.map((along, axis) => pusher.tip[axis] - pusher.position * along);
  const size = 2 * Math.max(0.01, ...outline.map(([x, y]) => Math.hypot(x, y)));
  const stroke = home ? [home, home.map((from, axis) => from + 1.6 * size * pusher.direction[axis])] : [];
  const near = object.filter(([x, y]) => Math.hypot(x, y) < 10 * size);
  const all = [[0, 0], ...ghost, ...near, ...stroke, ...trail.flatMap(({ pose: past }) => (past ? [past] : []))];
  const step = 0.02; // so that the picture stands still while the object moves
  if (!svg.still || !svg.sides) svg.sides = [Math.floor, Math.ceil].flatMap((to, end) => [0, 1].map((axis) => step * to((end ? 1 : -1) * 0.5 + (end ? Math.max : Math.min)(...all.map((point) => point[axis])) / step)));
  const [left, low, right, high] = svg.sides;
  const scale = Math.min((WIDTH - 60) / (right - left), (height - 70) / (high - low));
  const to = ([x, y]) => [WIDTH / 2 + (x - (left + right) / 2) * scale, height / 2 - 10 - (y - (low + high) / 2) * scale];
  svg.toTable = ([u, v]) => [(left + right) / 2 + (u - WIDTH / 2) / scale, (low + high) / 2 - (v - height / 2 + 10) / scale];
  const axes = (at, name) => [[1, 0], [0, 1]].forEach((way, axis) => {
    const ends = placed([[0, 0], way.map((value) => 0.25 * size * value)], at).map(to);
    parts.push(...arrow(ends, "frame_axis"));
    parts.push(made("text", axis ? { x: ends[1][0] + 5, y: ends[1][1] - 5 } : { x: ends[1][0], y: ends[1][1] + 22, "text-anchor": "end" }, "xy"[axis]));
    if (name && axis) parts.push(made("text", { x: ends[0][0] - 8, y: ends[0][1] + 6, "text-anchor": "end" }, name));
  });
  if (home) {
    parts.push(made("path", { class: "line", d: path(stroke.map(to)) }));
    parts.push(...tipMark(pusher, to(pusher.tip), scale));
  }
  if (pose) parts.unshift(made("path", { class: "outline", d: path(object.map(to), true) }));
  axes([0, 0, 0], "table");
  if (pose) axes(pose, "");
  if (pose && story["node/simulated_cell"]) {
    const [[u, v]] = placed([[0.25 * size, 0]], pose).map(to);
    parts.push(made("circle", { class: "handle", cx: u, cy: v, r: 12 }));
  }
  if (trail.length) {
    parts.push(made("path", { class: "trail", d: path(trail.filter(({ pose: past }) => past).map(({ pose: past }) => to(past))) }));
    const at = trail.at(-1), inward = turned(at.contact.slice(2), pose?.[2] ?? 0).map((value) => -value);
    if (pose) {
      const [touched] = placed([at.contact], pose), from = touched.map((value, axis) => value - 0.2 * size * inward[axis]);
      parts.push(...arrow([to(from), to(touched)], "push"));
    }
  }
  if (ghost.length) {
    parts.push(made("path", { class: plan.in_place ? "ghost there" : "ghost", d: path(ghost.map(to), true) }));
    const [u, v] = to(plan.placement);
    const [distance, turn] = wayToPlace(story) ?? [];
    if (plan.in_place) parts.push(made("text", { class: "there", x: u, y: v + 26, "text-anchor": "middle" }, "✓ in place"));
    else if (pose) {
      parts.push(...arrow([to(pose), [u, v]], "way"));
      const rows = [[0, 0], ...ghost, ...object].map((point) => to(point)[1]), below = Math.max(...rows) + 46; // clear of all arrows
      parts.push(made("text", { class: "way_text", x: u, y: below < height - 44 ? below : Math.min(...rows) - 12, "text-anchor": "middle" }, inWords(distance, turn)));
    }
  }
  parts.push(...drawnScale(scale, height));
  svg.replaceChildren(...parts);
}

export const inWords = (distance, turn) => `${(1e3 * distance).toFixed(0)} mm${Math.abs(turn) < 2 ? "" : `, turn ${turn > 0 ? "↺" : "↻"} ${Math.abs(turn).toFixed(0)}°`}`;

function arrow([[a, b], [u, v]], kind) {
  const long = Math.hypot(u - a, v - b);
  if (long < 2) return [];
  const head = Math.min(10, 0.4 * long), [x, y] = [(u - a) / long, (v - b) / long];
  const back = (side) => [u - head * (x - 0.5 * side * y), v - head * (y + 0.5 * side * x)];
  return [made("path", { class: kind, d: path([[a, b], [u, v]]) + path([back(1), [u, v], back(-1)]) })];
}

/** The lower bounds on mu_c as a histogram, with the 90 % and 100 % marks, and its value with the interval. */
export function drawFriction(svg, estimate) {
  const height = 280, left = 24, right = WIDTH - 24, base = height - 34, top = 58;
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${height}`);
  const { counts = [], bin_width: bin = 0.05 } = estimate?.histogram ?? {}, mu = estimate?.mu_c, its = estimate?.belief.mu_c;
  const finite = (mu ? [mu.max, its?.value, ...(its?.interval ?? [])] : []).map(number).filter(Number.isFinite);
  const end = Math.min(2.05, Math.max(1, 1.15 * Math.max(0, ...finite)));
  const to = (value) => left + (Math.min(value, end) / end) * (right - left);
  const parts = [];
  const step = niceStep(end, 6);
  for (let tick = 0; tick <= end + 1e-9; tick += step) {
    parts.push(made("path", { class: "grid", d: `M${to(tick)} ${top}V${base}` }));
    parts.push(made("text", { x: to(tick), y: height - 12, "text-anchor": "middle" }, `${+tick.toFixed(2)}`));
  }
  const highest = Math.max(1, ...counts);
  counts.forEach((count, index) => {
    if (count && index * bin < end) {
      const tall = ((base - top) * count) / highest;
      parts.push(made("rect", { class: "count", x: to(index * bin) + 1, y: base - tall, width: Math.max(1, to((index + 1) * bin) - to(index * bin) - 2), height: tall }));
    }
  });
  parts.push(made("path", { class: "axis", d: `M${left} ${base}H${right}` }));
  if (mu) {
    for (const [value, label] of [[mu.p90, "90 %"], [mu.max, "100 %"]]) {
      const u = to(number(value));
      parts.push(made("path", { class: "bound", d: `M${u} ${base}V${top - 4}` }));
      parts.push(made("text", { x: u, y: top - 10, dy: label === "90 %" ? "-1.2em" : 0, "text-anchor": u > right - 40 ? "end" : u < left + 40 ? "start" : "middle", class: "strong" }, `${label}: ${number(value) === Infinity ? "∞" : number(value).toFixed(2)}`));
    }
    const [low, high] = (its?.interval ?? []).map(number);
    if (Number.isFinite(low)) {
      const open = !Number.isFinite(high), v = base - 14;
      parts.push(made("path", { class: "interval", d: `M${to(low)} ${v}H${open ? right : to(high)}` }));
      if (open) parts.push(made("path", { class: "center", d: `M${right - 8} ${v - 9}L${right + 3} ${v}L${right - 8} ${v + 9}` }));
      if (Number.isFinite(number(its.value))) parts.push(made("circle", { class: "value", cx: to(number(its.value)), cy: v, r: 7 }));
    }
  }
  svg.replaceChildren(...parts);
}
