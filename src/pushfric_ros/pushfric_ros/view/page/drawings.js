// The drawings of the page: SVG in its own pixels, so that text and lines keep their size.
const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 640;
const CHI2_90 = 4.605; // the 90 % ellipse: x' C^-1 x <= this

const number = (value) => (value === "inf" ? Infinity : typeof value === "number" ? value : NaN);

function made(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

const path = (points, closed) => points.map(([x, y], index) => `${index ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("") + (closed ? "Z" : "");

/** A step of 1, 2 or 5 times a power of ten that divides a span into about this many parts. */
function niceStep(span, parts) {
  const raw = span / parts, power = 10 ** Math.floor(Math.log10(raw));
  return power * ([1, 2, 5].find((step) => step * power >= raw) ?? 10);
}

/** The object in its own frame: w, p_CF with its ellipse, and where the pusher is. */
export function drawObject(svg, story, rows) {
  const height = 480, parts = [];
  const outline = story.object?.outline ?? [];
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${height}`);
  if (!outline.length) {
    svg.replaceChildren();
    return;
  }
  const xs = outline.map(([x]) => x), ys = outline.map(([, y]) => y);
  const middle = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
  const span = [Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys)];
  const scale = Math.min((0.72 * WIDTH) / span[0], (0.66 * height) / span[1]); // [px/m]
  const to = ([x, y]) => [WIDTH / 2 + (x - middle[0]) * scale, height / 2 - 8 - (y - middle[1]) * scale];

  const estimate = story.estimate?.object === story.object.name ? story.estimate : null;
  parts.push(made("path", { class: "outline", d: path(outline.map(to), true) }));

  for (const row of rows) {
    if (row.excluded) continue;
    for (const [x, y, nx, ny] of row.contacts) {
      const [u, v] = to([x, y]); // a wedge from outside, along the inward normal
      const side = [-ny, nx];
      const wedge = [[u, v], [u + 11 * nx + 5 * side[0], v - 11 * ny - 5 * side[1]], [u + 11 * nx - 5 * side[0], v - 11 * ny + 5 * side[1]]];
      parts.push(made("path", { class: "contact", d: path(wedge, true) }));
    }
  }
  if (estimate) {
    const area = 0.1 * span[0] * span[1] * scale * scale; // of all discs together
    estimate.support_points.forEach((point, index) => {
      const [u, v] = to(point);
      parts.push(made("circle", { class: "point", cx: u, cy: v, r: 2.5 }));
      const radius = Math.sqrt((area * number(estimate.w[index])) / Math.PI);
      if (radius > 0.5) {
        const disc = made("circle", { class: "weight", cx: u, cy: v, r: radius });
        disc.append(made("title", {}, `w ${(100 * estimate.w[index]).toFixed(1)} % at (${(1e3 * point[0]).toFixed(1)}, ${(1e3 * point[1]).toFixed(1)}) mm`));
        parts.push(disc);
      }
    });
  }
  parts.push(...drawnPusher(story, to, scale));
  const center = estimate?.center_of_friction.map(number);
  if (center?.every(Number.isFinite)) {
    const [u, v] = to(center);
    const spread = estimate.center_of_friction_covariance;
    if (spread) parts.push(drawnEllipse(spread, u, v, scale));
    parts.push(made("path", { class: "center", d: `M${u - 11} ${v}H${u + 11}M${u} ${v - 11}V${v + 11}` }));
  }
  const bar = niceStep(WIDTH / scale, 6);
  parts.push(made("path", { class: "scale", d: `M20 ${height - 26}v8h${bar * scale}v-8` }));
  parts.push(made("text", { x: 20 + (bar * scale) / 2, y: height - 24, "text-anchor": "middle" }, `${+(bar * 1e3).toPrecision(3)} mm`));
  svg.replaceChildren(...parts);
}

function drawnEllipse([[xx, xy], [, yy]], u, v, scale) {
  const mean = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy);
  const radii = [mean + half, Math.max(0, mean - half)].map((variance) => Math.max(1, Math.sqrt(CHI2_90 * variance) * scale));
  const turned = (-Math.atan2(2 * xy, xx - yy) / 2) * (180 / Math.PI);
  return made("ellipse", { class: "ellipse", cx: u, cy: v, rx: radii[0], ry: radii[1], transform: `rotate(${turned} ${u} ${v})` });
}

/** The pushing line and the tip, from the table into the object's frame. */
function drawnPusher({ pose, pusher }, to, scale) {
  if (!pose || !pusher) return [];
  const [x, y, theta] = pose, [cos, sin] = [Math.cos(theta), Math.sin(theta)];
  const turned = ([a, b]) => [cos * a + sin * b, -sin * a + cos * b];
  const tip = turned([pusher.tip[0] - x, pusher.tip[1] - y]), along = turned(pusher.direction);
  const reach = WIDTH / scale;
  const ends = [-reach, reach].map((far) => to([tip[0] + far * along[0], tip[1] + far * along[1]]));
  const [u, v] = to(tip);
  return [
    made("path", { class: "line", d: path(ends) }),
    made("circle", { class: "tip", cx: u, cy: v, r: Math.max(4, pusher.radius * scale) }),
  ];
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

/** The table from above, x to the right: its axes, the pushing line, the object with its axes, and where it is to be placed. */
export function drawMap(svg, story) {
  const height = 480, parts = [];
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${height}`);
  const { pose, pusher, plan } = story, outline = story.object?.outline ?? [];
  const ghost = plan?.phase === "placing" ? placed(outline, plan.placement) : [];
  const object = pose ? placed(outline, pose) : [];
  const home = pusher && pusher.direction.map((along, axis) => pusher.tip[axis] - pusher.position * along);
  const size = 2 * Math.max(0.01, ...outline.map(([x, y]) => Math.hypot(x, y)));
  const stroke = home ? [home, home.map((from, axis) => from + 1.6 * size * pusher.direction[axis])] : [];
  const near = object.filter(([x, y]) => Math.hypot(x, y) < 10 * size);
  const all = [[0, 0], ...ghost, ...near, ...stroke];
  const step = 0.02; // so that the picture stands still while the object moves
  const [left, low, right, high] = [Math.floor, Math.ceil].flatMap((to, end) => [0, 1].map((axis) => step * to((end ? 1 : -1) * 0.5 + (end ? Math.max : Math.min)(...all.map((point) => point[axis])) / step)));
  const scale = Math.min((WIDTH - 60) / (right - left), (height - 70) / (high - low));
  const to = ([x, y]) => [WIDTH / 2 + (x - (left + right) / 2) * scale, height / 2 - 10 - (y - (low + high) / 2) * scale];
  const axes = (at, name) => [[1, 0], [0, 1]].forEach((way, axis) => {
    const ends = placed([[0, 0], way.map((value) => 0.25 * size * value)], at).map(to);
    parts.push(...arrow(ends, "frame_axis"));
    parts.push(made("text", { x: ends[1][0] + 5, y: ends[1][1] - 5 }, `${"xy"[axis]}${name}`));
  });
  if (home) {
    parts.push(made("path", { class: "line", d: path(stroke.map(to)) }));
    const [u, v] = to(pusher.tip);
    parts.push(made("circle", { class: "tip", cx: u, cy: v, r: Math.max(4, pusher.radius * scale) }));
  }
  if (pose) parts.unshift(made("path", { class: "outline", d: path(object.map(to), true) }));
  axes([0, 0, 0], " table");
  if (pose) axes(pose, "");
  if (ghost.length) {
    parts.push(made("path", { class: plan.in_place ? "ghost there" : "ghost", d: path(ghost.map(to), true) }));
    const [u, v] = to(plan.placement);
    const [distance, turn] = wayToPlace(story) ?? [];
    if (plan.in_place) parts.push(made("text", { class: "there", x: u, y: v + 26, "text-anchor": "middle" }, "✓ in place"));
    else if (pose) {
      parts.push(...arrow([to(pose), [u, v]], "way"));
      const [a, b] = to(pose);
      parts.push(made("text", { class: "way_text", x: (a + u) / 2 + 10, y: (b + v) / 2 + 18 }, inWords(distance, turn)));
    }
  }
  const bar = niceStep(WIDTH / scale, 6);
  parts.push(made("path", { class: "scale", d: `M20 ${height - 26}v8h${bar * scale}v-8` }));
  parts.push(made("text", { x: 20 + (bar * scale) / 2, y: height - 24, "text-anchor": "middle" }, `${+(bar * 1e3).toPrecision(3)} mm`));
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
  const height = 200, left = 24, right = WIDTH - 24, base = height - 34, top = 46;
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${height}`);
  const { counts = [], bin_width: bin = 0.05 } = estimate?.histogram ?? {};
  const mu = estimate?.mu_c;
  const finite = (mu ? [mu.max, mu.value, ...(mu.interval ?? [])] : []).map(number).filter(Number.isFinite);
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
      parts.push(made("text", { x: u, y: label === "90 %" ? top - 28 : top - 10, "text-anchor": u > right - 40 ? "end" : "middle", class: "strong" }, `${label}: ${number(value) === Infinity ? "∞" : number(value).toFixed(2)}`));
    }
    const [low, high] = (mu.interval ?? []).map(number);
    if (Number.isFinite(low)) {
      const open = !Number.isFinite(high), v = base - 14;
      parts.push(made("path", { class: "interval", d: `M${to(low)} ${v}H${open ? right : to(high)}` }));
      if (open) parts.push(made("path", { class: "center", d: `M${right - 8} ${v - 9}L${right + 3} ${v}L${right - 8} ${v + 9}` }));
      if (Number.isFinite(number(mu.value))) parts.push(made("circle", { class: "value", cx: to(number(mu.value)), cy: v, r: 7 }));
    }
  }
  svg.replaceChildren(...parts);
}

/** The fit error per data point after each push. */
export function drawError(svg, rows, numberOf) {
  const height = 200, left = 58, right = WIDTH - 8, base = height - 34, top = 14;
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${height}`);
  const shown = rows.filter((row) => row.after);
  const values = shown.map(({ after }) => (1e3 * number(after.objective)) / after.data_points);
  const highest = Math.max(0.01, ...values.filter(Number.isFinite));
  const step = niceStep(highest, 3), end = step * Math.ceil(highest / step);
  const parts = [];
  for (let tick = 0; tick <= end + step / 2; tick += step) {
    const v = base - ((base - top) * tick) / end;
    parts.push(made("path", { class: "grid", d: `M${left} ${v}H${right}` }));
    parts.push(made("text", { x: left - 8, y: v + 5, "text-anchor": "end" }, `${+tick.toPrecision(3)}`));
  }
  const wide = (right - left) / Math.max(8, shown.length);
  const every = Math.ceil(shown.length / 20);
  shown.forEach((row, index) => {
    const tall = Number.isFinite(values[index]) ? ((base - top) * values[index]) / end : 0;
    const u = left + index * wide;
    parts.push(made("rect", { class: row.excluded ? "bar out" : "bar", x: u + 0.18 * wide, y: base - tall, width: 0.64 * wide, height: tall, rx: 2 }));
    if (index % every === 0) parts.push(made("text", { x: u + wide / 2, y: height - 12, "text-anchor": "middle" }, numberOf(row.push).replace(" (again)", "′")));
  });
  parts.push(made("path", { class: "axis", d: `M${left} ${base}H${right}` }));
  svg.replaceChildren(...parts);
}
