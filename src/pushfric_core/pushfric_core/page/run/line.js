// The line of a run: its pushes and events, and three curves over all of its observations.
import { made, number, path } from "./drawings.js";

const PAD = 8; // half of the slider's thumb, so that both lie below one another [px]
const TOP = 22, TALL = 54, LABEL = 22, FOOT = 24;

const DECADES = 3; // of a curve, at most: what is smaller lies at the bottom
const SMALLEST = -3; // power of ten that is worth an axis

const TRACKS = [
  ["p_CF within", " mm", ({ known }) => 1e3 * number(known?.belief.radius)],
  ["Fit error per observation", " mm", ({ known }) => (1e3 * number(known?.objective)) / known?.data_points],
  ["Prediction off by", "°", ({ off }) => number(off)],
];
const SIGNS = { bad: "✗", note: "◆", good: "✓" };

/** Draw all of the run; returns where each index of a moment is, up to the last that the slider has. */
export function drawLine(svg, run, last, wide = Math.max(svg.clientWidth, 200)) {
  const height = TOP + TRACKS.length * (TALL + LABEL) + FOOT;
  const { moments, pushes, events } = run;
  const to = (index) => PAD + (index / Math.max(1, last)) * (wide - 2 * PAD);
  const parts = [];
  svg.setAttribute("viewBox", `0 0 ${wide} ${height}`);
  let free = -Infinity;
  pushes.filter((push) => push.moments.length).forEach((push, rank) => {
    const [left, right] = [push.moments[0].index - 0.5, push.moments.at(-1).index + 0.5].map((index) => to(Math.min(last, Math.max(0, index))));
    if (push.excluded || rank % 2 === 0) parts.push(made("rect", { class: push.excluded ? "band out" : "band", x: left, y: TOP, width: Math.max(0.5, right - left), height: height - TOP - FOOT }));
    const name = run.numberOf(push.push).replace(" (again)", "′"), middle = (left + right) / 2;
    if (middle - free < 12 + 5 * name.length) return;
    free = middle + 5 * name.length;
    parts.push(made("text", { x: middle, y: height - 7, "text-anchor": "middle" }, name));
  });
  TRACKS.forEach(([, unit, value], track) => parts.push(...drawnTrack(moments.map(value), unit, to, TOP + track * (TALL + LABEL) + LABEL, wide)));
  for (const { at, kind, text } of events) {
    const sign = made("text", { class: `event ${kind}`, x: to(Math.max(0, at - 0.5)), y: TOP - 6, "text-anchor": "middle" }, SIGNS[kind]);
    sign.append(made("title", {}, text));
    parts.push(sign);
  }
  const cursors = made("g", { class: "cursors" });
  svg.replaceChildren(...parts, cursors);
  return to;
}

/** Mark the moment that is shown and the one that it is compared with, each with its values. */
export function drawCursors(svg, run, to, shown, pinned) {
  const height = svg.viewBox.baseVal.height, parts = [];
  for (const [moment, kind] of [[pinned, "cursor pinned"], [shown, "cursor"]]) {
    if (moment) parts.push(made("path", { class: kind, d: `M${to(moment.index)} ${TOP - 4}V${height - FOOT}` }));
  }
  const at = { ...(shown ?? run.moments.at(-1)), known: run.estimateAt(shown) }; // that of now is not one of a push that was left out since
  TRACKS.forEach(([name, unit, value], track) => {
    const found = value(at);
    const text = made("text", { class: "strong", x: PAD, y: TOP + track * (TALL + LABEL) + 16 }, `${name} `);
    text.append(made("tspan", { class: "value_text" }, Number.isFinite(found) ? `${found < 10 ** (SMALLEST - DECADES) ? 0 : +found.toPrecision(2)}${unit}` : "–"));
    parts.push(text);
  });
  svg.querySelector(".cursors").replaceChildren(...parts);
}

// A curve over a logarithmic axis, with its extremes in each column of pixels: a long run costs no more than a short one
function drawnTrack(values, unit, to, top, wide) {
  const logs = values.map((value) => (value > 0 && Number.isFinite(value) ? Math.log10(value) : NaN));
  const most = logs.reduce((most, log) => (log > most ? log : most), -Infinity);
  if (!Number.isFinite(most)) return [];
  const high = Math.max(SMALLEST + 1, Math.ceil(most)), least = logs.reduce((least, log) => (log < least ? log : least), Infinity);
  const low = Math.max(Math.min(Math.floor(least), high - 1), high - DECADES);
  const v = (log) => top + TALL - 4 - ((TALL - 8) * Math.max(0, log - low)) / (high - low);
  const parts = [];
  for (let tick = low; tick <= high; tick += 1) {
    parts.push(made("path", { class: "grid", d: `M${PAD} ${v(tick)}H${wide - PAD}` }));
    if (tick === low || tick === high) parts.push(made("text", { class: "tick", x: wide - PAD, y: v(tick) + (tick === high ? 4 : -1), "text-anchor": "end" }, `${+(10 ** tick).toPrecision(1)}${unit}`));
  }
  const columns = new Map(); // pixel -> its least and greatest value
  logs.forEach((log, index) => {
    if (Number.isNaN(log)) return;
    const x = values.length > wide ? Math.round(to(index)) : to(index), column = columns.get(x);
    if (!column) columns.set(x, [log, log]);
    else if (log < column[0]) column[0] = log;
    else if (log > column[1]) column[1] = log;
  });
  const line = [...columns].flatMap(([x, ends]) => [...new Set(ends)].map((log) => [x, v(log)]));
  parts.push(made("path", { class: "curve", d: path(line) }));
  if (values.length <= wide / 4) parts.push(made("path", { class: "dots", d: line.map(([x, y]) => `M${x.toFixed(1)} ${y.toFixed(1)}h0`).join("") }));
  return parts;
}
