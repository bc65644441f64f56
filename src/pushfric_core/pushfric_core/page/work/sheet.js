// What pages have in common on which a person works over a picture: the command's answers, and what is drawn
const SVG = "http://www.w3.org/2000/svg";
export const NEAR_PX = 14; // a click this close to a point on the screen chooses it
export const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

const token = new URLSearchParams(location.search).get("token") ?? "";
const headers = token ? { Authorization: `Bearer ${token}` } : {};
export const at = (id) => document.getElementById(id);
export const round = (value) => Math.round(100 * value) / 100;

export function made(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

// What is asked of the command, one after the other

let last = Promise.resolve();
let open = 0;
export function asked(what, options) {
  document.body.ariaBusy = ++open > 0;
  last = last.then(async () => {
    const answer = await fetch(what, { headers, ...options });
    return answer.headers.get("Content-Type") === "image/png" ? answer.blob() : answer.json();
  });
  const mine = last;
  last = mine.catch(() => {}).finally(() => (document.body.ariaBusy = --open > 0));
  return mine;
}

export async function tell(what, body) {
  try {
    const answer = await asked(what, { method: "POST", body });
    if (!answer.done) say(answer.message, true);
    return answer;
  } catch {
    return gone();
  }
}

export function gone() {
  say("Nobody answers: the command has ended", true);
  return { done: false };
}

export function say(text, failed) {
  at("answer").textContent = text;
  at("answer").classList.toggle("failed", failed);
  at("answer").hidden = false;
}

/** Save on a click; then the page is over. */
export function whenSaved(over) {
  at("save").addEventListener("click", async () => {
    at("save").disabled = true;
    const answer = await tell("save");
    if (!answer.done) return (at("save").disabled = false);
    say(answer.message, false);
    at("prompt").textContent = "Saved";
    at("now").className = "finished";
    for (const control of document.querySelectorAll("button, input")) control.disabled = true;
    over();
  });
}

let address = "";
/** The command's present picture. */
export async function loaded() {
  if (address) URL.revokeObjectURL(address);
  return (address = URL.createObjectURL(await asked("picture.png")));
}

/** Where an event happens in a drawing, in its units. */
export function under(svg, event) {
  const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  return [round(x), round(y)];
}

/** A cross with its middle left open, so that the point can be seen. */
export function cross(u, v, size, name) {
  const from = size * 0.3, d = `M${u - size} ${v}H${u - from}M${u + from} ${v}H${u + size}M${u} ${v - size}V${v - from}M${u} ${v + from}V${v + size}`;
  return [made("path", { class: "halo", d }), made("path", { class: name, d })];
}

/** A word beside a place, as large on the screen at every scale. */
export function label(x, y, text, scale) {
  const element = made("text", { x: x + 8 * scale, y: y - 7 * scale }, text);
  element.style.fontSize = `${15 * scale}px`;
  return element;
}

/** A line of the table of points, which can be chosen and removed. */
export function rowOf(index, chosen, cells, choose, remove) {
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
