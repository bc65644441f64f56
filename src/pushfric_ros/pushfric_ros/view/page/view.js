// Shows the story of a run, which comes as one flat dict, first whole and then in changes; pushfric_ros/view/story.py lists its keys.
import { drawError, drawFriction, drawMap, drawObject, inWords, wayToPlace } from "./drawings.js";

const RETRY_MS = 2000;
const STALE_MS = 3000; // an image older than this is no longer what the camera sees
const WITHOUT_TOKEN = 4001, RUN_ENDED = 1001;

const token = new URLSearchParams(location.search).get("token") ?? "";
const at = (id) => document.getElementById(id);
let story = {};
let picture = null; // address of the image shown
let pictureAt = -Infinity;
let drawing = false; // a redraw is due
let connection = "connecting"; // or live, lost, ended, refused
let moment = null; // the push after which the estimate is shown; null: now
let newsAt = performance.now(); // when something last came

// Numbers, as JSON has them and as people read them

const number = (value) => (value === "inf" ? Infinity : typeof value === "number" ? value : NaN);
const known = (value) => value !== undefined && value !== null;
const mm = (metres, digits = 2) => (Number.isFinite(number(metres)) ? (number(metres) * 1e3).toFixed(digits).replace(/^-(0\.?0*)$/, "$1") : "–");
const plain = (value, digits = 2) => (number(value) === Infinity ? "∞" : Number.isFinite(number(value)) ? number(value).toFixed(digits) : "–");
const counted = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;
const rowsOf = () => Object.keys(story).filter((key) => key.startsWith("push/")).map((key) => story[key]).sort((a, b) => a.push - b.push);

/** The number of a push: its place in the plan, and whether it was repeated; push_plan.number_of says the same. */
function numberOf(push) {
  const count = story.plan?.count;
  return count ? `${push % count + 1}${push >= count ? " (again)" : ""}` : `${push + 1}`;
}

// Connection

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/live?token=${encodeURIComponent(token)}`);
  socket.binaryType = "blob";
  const look = () => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify({ looks: !document.hidden }));
  document.addEventListener("visibilitychange", look);
  socket.onopen = () => { if (document.hidden) look(); };
  socket.onmessage = ({ data }) => {
    if (data instanceof Blob) {
      show(data);
      return;
    }
    const { all, some } = JSON.parse(data);
    if (all) story = {};
    for (const [key, value] of Object.entries(all ?? some)) {
      if (value === null) delete story[key];
      else story[key] = value;
    }
    connection = "live";
    newsAt = performance.now();
    redraw();
  };
  socket.onclose = ({ code }) => {
    document.removeEventListener("visibilitychange", look);
    if (code === WITHOUT_TOKEN) connection = "refused";
    else if (connection !== "refused" && connection !== "ended") connection = code === RUN_ENDED ? "ended" : "lost";
    redraw();
    setTimeout(connect, RETRY_MS);
  };
}

function show(blob) {
  if (picture && !at("overlay").complete) return; // the one before is not even drawn
  const before = picture;
  picture = URL.createObjectURL(blob);
  pictureAt = performance.now();
  at("overlay").src = picture;
  if (before) URL.revokeObjectURL(before);
  redraw();
}

async function ask(what, said = what) {
  try {
    const answered = await fetch(what, { method: "POST", headers: token ? { Authorization: `Bearer ${token}` } : {} });
    const { done, message } = await answered.json();
    say(`${said}: ${message}`, !done);
  } catch {
    say(`${said}: nobody answers; use the switch at the pusher`, true);
  }
}

let silence;
function say(text, failed) {
  at("answer").textContent = text[0].toUpperCase() + text.slice(1);
  at("answer").classList.toggle("failed", failed);
  at("answer").hidden = false;
  clearTimeout(silence);
  silence = setTimeout(() => { at("answer").hidden = true; }, failed ? 20000 : 8000);
}

// The page

function redraw() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    drawHeader();
    drawNow();
    drawTime();
    drawNumbers();
    drawCamera();
    drawMap(at("map"), story);
    const [estimate, rows] = estimateShown();
    drawObject(at("drawing"), moment === null ? story : { ...story, estimate, pusher: null }, rows);
    drawFriction(at("friction_chart"), estimate);
    drawError(at("error_chart"), rowsOf(), numberOf);
    drawTable();
    drawNodes();
  });
}

function drawHeader() {
  at("object").textContent = story.object?.name ?? "pushfric";
  at("cell").textContent = story.cell ?? "";
  const age = Math.round((performance.now() - newsAt) / 1e3);
  const lost = `no connection for ${age} s, trying again …; what is shown is that old. Stop works`;
  const said = { connecting: "connecting …", live: "", lost, ended: "the run has ended", refused: "" };
  write("connection", said[connection]);
  at("connection").className = connection === "lost" ? "lost" : "";
  document.title = story.object ? `${story.object.name} – pushfric` : "pushfric";
  const live = connection === "live";
  const pushes = live && known(story["node/actuator"]);
  at("stop").disabled = live && !pushes; // never for want of a connection: a request may still arrive
  at("reset").disabled = !(pushes && ["hold", "alarm"].includes(story.pusher?.mode));
  const phase = live ? story.plan?.phase : undefined;
  at("repeat").disabled = phase !== "choosing";
  at("skip").disabled = !["placing", "pushing", "waiting", "choosing"].includes(phase);
  at("end").disabled = !phase || phase === "finished";
}

function drawNow() {
  const { plan, fault, estimate } = story;
  let prompt = plan?.message || (estimate ? "Estimating from the data points as they come" : "Waiting for the run …");
  if (connection === "refused") prompt = "This page needs its token: open the address that was printed when the run began. Stop works without it.";
  if (fault === "stopped" && plan?.phase !== "finished") prompt = "The pusher is stopped: press Reset to let it move again";
  write("prompt", prompt[0].toUpperCase() + prompt.slice(1));
  const way = wayToPlace(story);
  at("place").hidden = !way;
  if (way) at("place").textContent = plan.in_place ? "✓ It lies in place" : `Lay it onto the dashed outline: ${inWords(...way)} to go`;
  at("place").classList.toggle("there", Boolean(plan?.in_place));
  at("result").hidden = !(story.report && plan?.phase === "finished");
  write("report", story.report ?? "");
  write("purpose", plan && plan.phase !== "finished" ? plan.purpose : "");
  at("details").hidden = !plan?.details;
  write("technical", plan?.details ?? "");
  at("now").className = connection === "live" ? plan?.phase ?? "" : "lost";
  at("progress").parentElement.hidden = !plan;
  if (plan) {
    const done = plan.completed + plan.aborted + plan.skipped;
    at("progress").max = Math.max(1, plan.count);
    at("progress").value = plan.phase === "finished" ? plan.count : plan.push % plan.count;
    at("count").textContent = `${done} of ${counted(plan.count, "push").replace(/pushs$/, "pushes")}${plan.aborted ? `, ${plan.aborted} of them aborted` : ""}${plan.skipped ? `, ${plan.skipped} skipped` : ""}`;
  }
  const verdict = estimate?.verdict;
  at("trust").textContent = !verdict ? "" : verdict.use ? "✓ The estimate may be used." : `✗ Do not use the estimate yet: ${textOf(verdict.reasons)}`;
  if (verdict?.notes.length) at("trust").textContent += ` To be put right: ${textOf(verdict.notes)}.`;
  if (known(estimate?.change)) at("trust").textContent += ` The object seems to be another one since push ${estimate.change.since_push + 1}.`;
}

function drawTime() {
  const rows = rowsOf().filter((row) => row.after);
  if (moment !== null && !rows.some((row) => row.push === moment)) moment = null;
  at("time").hidden = rows.length < 2;
  at("time").classList.toggle("past", moment !== null);
  const slider = at("moment"), chosen = rows.findIndex((row) => row.push === moment);
  slider.max = rows.length;
  slider.value = chosen < 0 ? rows.length : chosen;
  const name = chosen < 0 ? "now" : `after push ${numberOf(moment)}`;
  slider.setAttribute("aria-valuetext", name);
  if (at("moment_name").value !== name) at("moment_name").value = name;
}

// The estimate at the moment that is shown, and the rows of the pushes up to then
function estimateShown() {
  const rows = rowsOf(), last = rows.findIndex((row) => row.push === moment);
  return last < 0 ? [story.estimate, rows] : [rows[last].after, rows.slice(0, last + 1)];
}

function drawNumbers() {
  const [estimate] = estimateShown();
  const [x, y] = estimate?.center_of_friction ?? [];
  unit("center", estimate ? `${mm(x)}, ${mm(y)}` : "–", "mm");
  at("confidence").textContent = known(estimate?.confidence) ? `off by at most ${mm(estimate.confidence)} mm, with 90 %` : "";
  const mu = estimate?.mu_c;
  const measured = known(mu?.value);
  at("mu").textContent = !mu ? "–" : measured ? plain(mu.value) : `≥ ${plain(mu.p90)}`;
  at("mu_kind").textContent = !mu ? "" : measured ? `${plain(mu.interval[0])} to ${plain(mu.interval[1])} with 90 %, from ${mu.kind}` : "a lower bound (90 % of the data points)";
  unit("fit", estimate ? mm(estimate.objective, 3) : "–", "mm");
  at("certified").textContent = estimate ? `${estimate.status}; certified to ${(number(estimate.gap) * 1e3).toExponential(0)} mm` : "";
  at("points").textContent = estimate ? counted(estimate.data_points, "data point") : "–";
  at("pushes").textContent = estimate ? `of ${estimate.pushes} ${estimate.pushes === 1 ? "push" : "pushes"}` : "";
}

function textOf(reasons) {
  return reasons.map((reason) => reason.text).join("; ");
}

// Text that is read out: only if it changes
function write(id, text) {
  if (at(id).textContent !== text) at(id).textContent = text;
}

function unit(id, text, what) {
  const name = document.createElement("span");
  name.className = "unit";
  name.textContent = ` ${what}`;
  at(id).replaceChildren(text, ...(text === "–" ? [] : [name]));
}

function drawCamera() {
  const tracker = story["node/tracker"];
  const old = performance.now() - pictureAt > STALE_MS;
  at("overlay").hidden = !picture;
  at("overlay").classList.toggle("old", old && !known(story["node/player"])); // a bag holds few
  at("no_image").hidden = Boolean(picture);
  at("no_image").textContent = known(story["node/player"]) ? "No image yet: a bag holds few or none" : "No image yet";
  const unseen = tracker && tracker.level !== "ok";
  at("seen").textContent = !tracker ? "" : unseen ? `✗ ${tracker.message}` : `✓ The object is ${tracker.message}, ${tracker.values["residual [px]"] ?? "–"} px from its outline`;
  at("seen").classList.toggle("problem", Boolean(unseen));
}

function drawTable() {
  const rows = rowsOf();
  at("no_rows").hidden = rows.length > 0;
  const body = at("rows");
  for (const kept of [...body.children]) if (!story[`push/${kept.dataset.push}`]) kept.remove();
  rows.forEach((row, index) => {
    let line = body.querySelector(`tr[data-push="${row.push}"]`);
    if (!line) {
      line = document.createElement("tr");
      line.dataset.push = row.push;
      for (const label of ["push", "data points", "p_CF x [mm]", "p_CF y [mm]", "μ_c 90 %", "fit error [mm]", "verdict", ""]) {
        const cell = line.insertCell();
        if (label) cell.dataset.label = label;
      }
      const button = document.createElement("button");
      button.addEventListener("click", () => {
        const what = row.excluded || rejectionOf(row) ? "keep" : "exclude";
        ask(`${what}/${row.push}`, `${what} push ${numberOf(row.push)}`);
      });
      line.lastChild.append(button);
      body.insertBefore(line, body.children[index] ?? null);
    }
    const { after } = row;
    const [verdict, bad] = judged(row);
    const texts = [numberOf(row.push), row.contacts.length, mm(after?.center_of_friction[0]), mm(after?.center_of_friction[1]), plain(after?.mu_c.p90), mm(after?.objective, 3), verdict];
    texts.forEach((text, column) => { line.cells[column].textContent = text; });
    line.cells[6].className = bad ? "bad" : "";
    const left = Boolean(rejectionOf(row));
    line.className = row.excluded || left ? "out" : "";
    const button = line.lastChild.firstChild;
    const out = row.excluded || left;
    button.textContent = out ? "Keep" : "Exclude";
    button.ariaLabel = `${button.textContent} push ${numberOf(row.push)}`;
    button.disabled = connection !== "live" || !row.contacts.length;
  });
}

// Why the estimator leaves a push out by itself, as the last estimate says; undefined if it does not
function rejectionOf(row) {
  return row.excluded ? undefined : story.estimate?.rejected?.find((one) => one.push === row.push);
}

function judged(row) {
  if (row.excluded) return [row.aborted ? "aborted, left out" : "excluded", row.aborted];
  const rejected = rejectionOf(row);
  if (rejected) return [`✗ left out: ${rejected.reason.text}`, true];
  if (row.aborted) return ["✗ aborted", true];
  if (!row.contacts.length) return ["no data point yet", false];
  return ["✓ counts", false];
}

function drawNodes() {
  const sums = story["node/estimator"]?.values ?? {};
  const kinds = ["poses", "pusher states", "wrenches", "observations", "pushes"].filter((kind) => sums[kind]);
  at("ledger").textContent = kinds.map((kind) => `${kind}: ${sums[kind]}`).join("; ");
  const signs = { ok: "✓", warning: "!", error: "✗", stale: "?" };
  const list = at("nodes");
  for (const name of Object.keys(story).filter((key) => key.startsWith("node/")).sort()) {
    const { level, message, values } = story[name];
    let details = list.querySelector(`[data-node="${name}"]`);
    if (!details) {
      details = document.createElement("details");
      details.dataset.node = name;
      details.innerHTML = '<summary><span class="level"></span><span class="node"></span><span class="message"></span></summary><dl></dl>';
      list.insertBefore(details, [...list.children].find((other) => other.dataset.node > name) ?? null);
    }
    details.className = level;
    details.querySelector(".level").textContent = signs[level];
    details.querySelector(".level").ariaLabel = level;
    details.querySelector(".node").textContent = name.slice("node/".length);
    details.querySelector(".message").textContent = message;
    if (details.open) {
      details.querySelector("dl").replaceChildren(...Object.entries(values).flatMap(([key, value]) => [made("dt", key), made("dd", value)]));
    }
  }
  for (const kept of [...list.children]) if (!story[kept.dataset.node]) kept.remove();
}

function made(tag, text) {
  const element = document.createElement(tag);
  element.textContent = text;
  return element;
}

at("moment").addEventListener("input", ({ target }) => {
  moment = rowsOf().filter((row) => row.after)[target.value]?.push ?? null;
  redraw();
});
for (const what of ["stop", "reset", "repeat", "skip", "end"]) at(what).addEventListener("click", () => ask(what));
document.addEventListener("keydown", (event) => {
  if (event.code !== "Space" || at("stop").disabled) return; // whatever has the focus
  event.preventDefault();
  if (!event.repeat) ask("stop");
});
document.addEventListener("keyup", (event) => {
  if (event.code === "Space" && !at("stop").disabled) event.preventDefault(); // a button acts when the key is let go
});
at("nodes").addEventListener("toggle", redraw, true);
setInterval(redraw, 1000); // an image grows old without news
connect();
