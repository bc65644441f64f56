// Shows a run: live, told first as a whole and then in changes; or one that is over, whose story is in the page.
import { believed, drawFriction, drawMap, drawObject, drawPrediction, drawPusher, inWords, number, wayToPlace } from "./drawings.js";
import { drawCursors, drawLine } from "./line.js";
import { drawCard, listenForGuess } from "./play.js";
import { Run } from "./run.js";

const CALM_MS = 400; // for so long after a moment was chosen, only moments are drawn: whoever looks through them does not wait
const FRAME_MS = 20, REST = 10; // after a frame that takes longer, as of a long run that goes on, so many pass without the whole run
const RETRY_MS = 2000, PAPER = 688; // width of a sheet of A4 without its margins [px]
const WITHOUT_TOKEN = 4001, RUN_ENDED = 1001;
const SWITCHES = document.querySelectorAll("#switches button"); // that a person at a simulated cell turns over

const token = new URLSearchParams(location.search).get("token") ?? "";
const headers = token ? { Authorization: `Bearer ${token}` } : {};
const at = (id) => document.getElementById(id);
const run = new Run();
let story = run.story;
let picture = null; // address of the image shown
let drawing = false; // a redraw is due
let connection = "connecting"; // or live, lost, ended, refused; over: the story is in the page
let chosen = null, pinned = null; // numbers of the moment that is shown and of the one compared with; null: now, none
let wholeAt = 0, waiting; // when the whole run may be drawn again, and the timer for it
let drawn = []; // what the drawings show
let toLine; // from the index of a moment to its place on the line
let newsAt = performance.now(); // when something last came

// Numbers, as JSON has them and as people read them

const known = (value) => value !== undefined && value !== null;
const mm = (metres, digits = 2) => (Number.isFinite(number(metres)) ? plain(number(metres) * 1e3, digits) : "–");
const unsigned = (text) => text.replace(/^-(0\.?0*)$/, "$1"); // a zero has no sign
const plain = (value, digits = 2) => (number(value) === Infinity ? "∞" : Number.isFinite(number(value)) ? unsigned(number(value).toFixed(digits)) : "–");
const counted = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;
// mu_c as it is believed, with the command line's digits
const friction = (estimate) => {
  const { value, interval } = estimate?.belief.mu_c ?? {};
  return known(value) ? plain(value, 3) : interval ? `≥ ${plain(interval[0], 3)}` : "–";
};
const momentOf = (n) => run.moments.find((moment) => moment.n === n);
// What is shown: a moment, or undefined, which is the present
const shown = () => momentOf(chosen) ?? (connection === "over" ? run.moments.at(-1) : undefined);

// Connection

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/live?token=${encodeURIComponent(token)}`);
  socket.binaryType = "blob";
  const look = () => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify({ looks: !document.hidden }));
  document.addEventListener("visibilitychange", look);
  socket.onopen = () => { if (document.hidden) look(); };
  socket.onmessage = ({ data }) => {
    if (connection === "ended") return location.reload(); // only another run can speak now
    if (data instanceof Blob) {
      show(data);
      return;
    }
    run.take(JSON.parse(data));
    connection = run.story.recorded ? "over" : "live";
    newsAt = performance.now();
    if (run.story.reported) takeReport(socket);
    redraw();
  };
  socket.onclose = ({ code }) => {
    document.removeEventListener("visibilitychange", look);
    if (connection === "over") return;
    if (code === WITHOUT_TOKEN) connection = "refused";
    else if (connection !== "refused" && connection !== "ended") connection = code === RUN_ENDED ? "ended" : "lost";
    redraw();
    setTimeout(connect, RETRY_MS);
  };
}

// The report, to be saved, and what it alone can tell, before nobody serves them any more
let report = null;
async function takeReport(socket) {
  if (report !== null) return;
  report = "";
  try {
    const answered = await fetch(`report.html?token=${encodeURIComponent(token)}`), text = await answered.text();
    if (!answered.ok) throw new Error(text);
    report = URL.createObjectURL(new Blob([text], { type: "text/html" }));
    if (!run.story.tables) {
      const { doubts, files, tables, made } = JSON.parse(text.match(/id="story">(.*)<\/script>/)[1]);
      run.take({ some: { doubts, files, tables, made } });
    }
    at("result_page").href = report;
  } catch {
    report = null; // it stays in its file
  }
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ has_report: true }));
  redraw();
}

function show(blob) {
  if (picture && !at("overlay").complete) return; // the one before is not even drawn
  const before = picture;
  picture = URL.createObjectURL(blob);
  run.came("image");
  if (chosen === null) at("overlay").src = picture;
  if (before) URL.revokeObjectURL(before);
  redraw();
}

async function ask(what, said) {
  try {
    const answered = await fetch(what, { method: "POST", headers });
    const { done, message } = await answered.json();
    say((done && !said && message) || `${said ?? what}: ${message || (done ? "done" : "refused")}`, !done);
  } catch {
    say(`${said ?? what}: nobody answers; use the switch at the pusher`, true);
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
    const began = performance.now(), whole = began >= wholeAt;
    clearTimeout(waiting);
    if (whole) run.arrange();
    else waiting = setTimeout(redraw, wholeAt - began);
    story = run.present();
    for (const [kind, is] of [["over", connection === "over"], ["live", connection !== "over"]]) document.body.classList.toggle(kind, is);
    drawHeader();
    drawNow();
    const moment = shown(), compared = momentOf(pinned);
    drawCamera(moment, compared);
    at("map").classList.toggle("old", !moment && Math.max(run.age("pose"), run.age("pusher")) > 1);
    if (isLaid()) at("map").setAttribute("tabindex", "0"); // its keys move the object
    else at("map").removeAttribute("tabindex");
    at("map").still = Boolean(held); // under a pointer that holds the object
    drawMap(at("map"), moment ? { object: story.object, pose: moment.pose } : story, moment ? run.moments.slice(moment.index - moment.place + 1, moment.index + 1) : []);
    const ofRun = whole || !drawn.length ? [run.version, at("line").clientWidth, connection, story.estimate] : drawn.slice(0, 4);
    const now = [...ofRun, moment, compared];
    const changed = now.findIndex((one, index) => one !== drawn[index]);
    if (changed >= 0 && changed < 4) drawAll();
    if (changed >= 0) drawMoment(moment, compared);
    const took = performance.now() - began;
    if (whole && took > FRAME_MS) wholeAt = Math.max(wholeAt, began + REST * took);
    drawn = now;
    drawPusher(at("drawing"), story.object?.outline ?? [], moment ? {} : story);
    drawCard(run, story);
    drawNodes();
    drawEnd();
    if (story.object || connection !== "connecting") document.body.classList.remove("waiting");
  });
}

// What changes only with the observations: in a long run it must not be drawn again for each moment
function drawAll() {
  if (!told) keepPictures();
  at("time").hidden = connection === "over" && !run.moments.length;
  toLine = drawLine(at("line"), run, lastIndex());
  drawTable();
}

// What changes with the moment that is shown, too
function drawMoment(moment, compared) {
  const outline = story.object?.outline ?? [], mine = story.object?.name, estimate = run.estimateAt(moment);
  const own = (one) => (one?.object === mine ? one : undefined);
  drawTime(moment, compared);
  drawNumbers(estimate);
  drawObject(at("drawing"), outline, own(estimate), own(compared && run.estimateAt(compared)), moment ? run.moments.slice(0, moment.index + 1) : run.moments, moment);
  drawFriction(at("friction_chart"), estimate);
  const predicted = moment ?? run.moments.at(-1);
  drawPrediction(at("prediction_drawing"), outline, predicted);
  at("prediction_caption").textContent = !predicted ? "" : !predicted.predicted ? "Nothing was predicted: it is the first push" :
    `Predicted from the pushes before: ${plain(predicted.off, 1)}° off, of velocity and turn together. Both are drawn longer than they were.`;
}

function drawHeader() {
  at("object").textContent = story.object?.name ?? "pushfric";
  at("cell").textContent = story.cell ?? "";
  const live = connection === "live";
  const age = Math.round((performance.now() - newsAt) / 1e3);
  const lost = `no connection for ${age} s, trying again … Stop works`;
  const quiet = age < 3 ? "" : `no news for ${age} s`;
  const said = { connecting: "connecting …", live: quiet, lost, ended: "the run has ended", refused: "", over: "" };
  write("connection", said[connection]);
  at("connection").className = connection === "lost" || (live && quiet) ? "lost" : "";
  document.title = story.object ? `${story.object.name} – pushfric` : "pushfric";
  const pushes = live && (known(story["node/actuator"]) || known(story.fault)); // a view that starts again hears the fault at once
  at("stop").disabled = live && !pushes; // never for want of a connection: a request may still arrive
  at("reset").disabled = !(pushes && ["hold", "alarm"].includes(story.pusher?.mode));
  const phase = live ? story.plan?.phase : undefined;
  at("repeat").disabled = phase !== "choosing";
  at("skip").disabled = !["placing", "pushing", "waiting", "choosing"].includes(phase);
  at("end").disabled = !phase || ["finished", "silent"].includes(phase);
}

function drawNow() {
  const { plan, fault, estimate } = story;
  let prompt = story.reading?.[0] || plan?.message || (connection === "over" ? "A recorded run" : estimate ? "Estimating from the observations as they come" : "Waiting for the run …");
  if (connection === "refused") prompt = "This page needs its token: open the address that was printed when the run began. Stop works without it.";
  if (fault === "stopped" && plan?.phase !== "finished") prompt = "The pusher is stopped: press Reset to let it move again";
  if (switches().emergency_stop?.endsWith("is pressed")) prompt = "The emergency stop is pressed: release it below the camera's image, then press Reset";
  if (write("prompt", prompt[0].toUpperCase() + prompt.slice(1)) && (plan?.phase !== "pushing" || fault === "stopped")) ring();
  const way = wayToPlace(story);
  at("place").textContent = !way ? "" : plan.in_place ? "✓ It lies in place" : `Lay it onto the dashed outline: ${inWords(...way)} to go`;
  at("place").classList.toggle("there", Boolean(plan?.in_place));
  at("result").hidden = !(story.report && plan?.phase === "finished");
  write("report", story.report ?? "");
  at("result_page").hidden = !report;
  write("result_is", report ? "What only its end can tell follows below. All of it is in" : "The result to hand on will be in");
  write("again", `./pushfric view ${(story.report ?? "").replace(/\/[^/]*$/, "")}`);
  const alarm = plan?.phase === "alarm" ? story["node/actuator"]?.message : undefined; // what went wrong, and what to do about it
  write("purpose", story.reading?.[1] ?? (plan && plan.phase !== "finished" ? alarm ?? plan.purpose : ""));
  at("details").hidden = !plan?.details;
  write("technical", plan?.details ?? "");
  at("now").className = connection === "live" && plan?.phase !== "silent" ? plan?.phase ?? "" : connection === "over" ? "finished" : "lost";
  at("now").classList.toggle("unusable", estimate?.belief.verdict.use === false);
  at("progress").parentElement.hidden = !plan;
  if (plan) {
    at("progress").max = Math.max(1, plan.count);
    at("progress").value = plan.phase === "finished" ? plan.count : plan.push % Math.max(1, plan.count);
    at("count").textContent = `${plan.completed} of ${counted(plan.count, "push").replace(/pushs$/, "pushes")} done${plan.aborted ? `, ${plan.aborted} aborted` : ""}${plan.skipped ? `, ${plan.skipped} skipped` : ""}`;
  }
  document.querySelector(".numbers").classList.toggle("old", story.outdated);
  if (story.outdated) {
    at("trust").textContent = "The estimator does not report: the estimate is what it said last.";
    return;
  }
  const verdict = estimate?.belief.verdict;
  at("trust").textContent = !verdict ? "" : verdict.use ? "✓ The estimate may be used." : `✗ Do not use the estimate yet: ${textOf(verdict.reasons)}`;
  if (verdict?.notes.length) at("trust").textContent += ` To be put right: ${textOf(verdict.notes)}.`;
  if (known(estimate?.belief.change)) at("trust").textContent += ` The object seems to be another one since push ${run.numberOf(estimate.belief.change.since_push)}.`;
}

function drawTime(moment, compared) {
  at("time").classList.toggle("past", chosen !== null);
  const last = lastIndex(), slider = at("moment");
  drawCursors(at("line"), run, toLine, moment, compared);
  slider.max = last;
  slider.value = moment ? moment.index : last;
  const name = moment ? nameOf(moment) : "now", events = happened(moment);
  slider.setAttribute("aria-valuetext", [name, ...events].join("; "));
  write("moment_name", name);
  write("happened", events.length ? `Before this: ${events.join("; ")}` : "");
  at("to_now").hidden = connection === "over";
  at("to_now").disabled = chosen === null;
  at("earlier").disabled = (moment?.index ?? last) === 0;
  at("later").disabled = !moment || (connection === "over" && moment.index === last);
  at("compare").disabled = !run.moments.length;
  at("compare").ariaPressed = String(pinned !== null);
  at("compare").textContent = pinned === null ? "Compare" : "Compare no more";
  at("comparison").hidden = !compared;
  if (compared) drawComparison(compared, moment);
}

const lastIndex = () => run.moments.length - (connection === "over" ? 1 : 0); // of the slider: in a live run it is now
const nameOf = ({ row, place, t }) => `push ${run.numberOf(row.push)}, observation ${place} of ${row.moments.length}${t ? `, ${t.toFixed(1)} s` : ""}`;
const happened = (moment) => run.events.filter(({ at: before }) => before === (moment ? moment.index : run.moments.length)).map(({ text }) => text);

function drawComparison(compared, moment) {
  const [one, other] = [run.estimateAt(compared), run.estimateAt(moment)];
  const short = (one) => (one ? `push ${run.numberOf(one.push)}, ${one.place} of ${one.row.moments.length}` : "now");
  at("pinned_name").textContent = short(compared);
  at("shown_name").textContent = short(moment);
  const offNow = moment ?? run.moments.at(-1);
  const rows = [
    ["p_CF x [mm]", 2, (estimate) => 1e3 * number(believed(estimate)?.[0])],
    ["p_CF y [mm]", 2, (estimate) => 1e3 * number(believed(estimate)?.[1])],
    ["p_CF within [mm]", 2, (estimate) => 1e3 * number(estimate?.belief.radius)],
    ["μ_c, or its lower bound", 3, (estimate) => number(estimate?.belief.mu_c?.value ?? estimate?.belief.mu_c?.interval[0])],
    ["fit error / observation [mm]", 3, (estimate) => (1e3 * number(estimate?.objective)) / estimate?.data_points],
    ["prediction off by [°]", 1, (_, { off }) => number(off)],
  ];
  at("comparison").tBodies[0].replaceChildren(...rows.map(([name, digits, value]) => {
    const [before, after] = [value(one, compared), value(other, offNow)], line = document.createElement("tr"), head = worded("th", name);
    head.scope = "row";
    const change = plain(after - before, digits);
    line.append(head, ...[before, after].map((one) => worded("td", plain(one, digits))), worded("td", Number(change) > 0 ? `+${change}` : change));
    return line;
  }));
}

function choose(index) {
  chosen = run.moments[index]?.n ?? null;
  wholeAt = Math.max(wholeAt, performance.now() + CALM_MS);
  if (chosen === null && picture) at("overlay").src = picture;
  redraw();
}

// To the last observation of the push before or after
function leap(way) {
  const ends = run.moments.filter((moment) => moment.place === moment.row.moments.length).map(({ index }) => index);
  const from = shown()?.index ?? run.moments.length;
  const to = way < 0 ? ends.findLast((index) => index < from) : ends.find((index) => index > from);
  choose(to ?? (way < 0 ? 0 : run.moments.length));
}

function drawNumbers(estimate) {
  const [x, y] = believed(estimate) ?? [];
  unit("center", estimate ? `${mm(x)}, ${mm(y)}` : "–", "mm");
  at("confidence").textContent = known(estimate?.belief.radius) ? `off by at most ${mm(estimate.belief.radius)} mm, with 90 %` : "";
  const mu = estimate?.belief.mu_c;
  at("mu").textContent = friction(estimate);
  at("mu_kind").textContent = !mu ? "" : known(mu.value) ? `${plain(mu.interval[0], 3)} to ${plain(mu.interval[1], 3)} with 90 %, from ${mu.kind}` : "a lower bound, with 90 %";
  unit("fit", estimate ? mm(estimate.objective, 3) : "–", "mm");
  at("certified").textContent = estimate ? `${estimate.status}; certified to ${Number((number(estimate.gap) * 1e3).toPrecision(1))} mm` : "";
  unit("points", estimate ? `${estimate.data_points}` : "–", estimate?.data_points === 1 ? "observation" : "observations");
  at("pushes").textContent = estimate ? `of ${estimate.pushes} ${estimate.pushes === 1 ? "push" : "pushes"}` : "";
}

function textOf(reasons) {
  return reasons.map((reason) => reason.text).join("; ");
}

// Text that is read out: only if it changes; returns whether it did
function write(id, text) {
  const changed = at(id).textContent !== text;
  if (changed) at(id).textContent = text;
  return changed;
}

let sound = null; // where prompts are heard, if that is wanted
function ring() {
  if (!sound) return;
  const tone = new OscillatorNode(sound, { frequency: 660 });
  tone.connect(new GainNode(sound, { gain: 0.2 })).connect(sound.destination);
  tone.start();
  tone.stop(sound.currentTime + 0.25);
}

function unit(id, text, what) {
  const name = document.createElement("span");
  name.className = "unit";
  name.textContent = ` ${what}`;
  at(id).replaceChildren(text, ...(text === "–" ? [] : [name]));
}

const addressOf = ({ key, src }) => src ?? run.story[`src/${key}`] ?? `${key}?token=${encodeURIComponent(token)}`;

// Load the pictures before they are asked for: when the run ends, nobody serves them any more
let keeping = false;
async function keepPictures() {
  if (keeping) return;
  keeping = true;
  try {
    for (let next; (next = run.pictures.find(({ src }) => !src)); ) {
      const answered = await fetch(addressOf(next));
      next.src = answered.ok ? URL.createObjectURL(await answered.blob()) : addressOf(next);
    }
  } catch {
    // the connection is lost: the next news begins again
  }
  keeping = false;
}

// What the simulated cell says of each; nothing if there is none
const switches = () => (connection === "live" && story["node/simulated_cell"]?.values) || {};

function drawCamera(moment, compared) {
  const over = connection === "over" || connection === "ended" || (story.plan?.phase === "finished" && run.isGone("node/tracker"));
  const now = !moment && !over, tracker = now ? story["node/tracker"] : undefined;
  const live = now && picture && !run.isGone("image");
  const kept = now ? undefined : run.pictureAt(moment), address = live ? picture : kept && addressOf(kept);
  at("camera").hidden = connection === "over" && !run.pictures.length;
  if (address && at("overlay").getAttribute("src") !== address && !live) at("overlay").src = address;
  at("overlay").hidden = !address;
  at("overlay").classList.toggle("old", Boolean(live) && run.age("image") > 1);
  at("no_image").hidden = Boolean(address);
  const then = compared && run.pictureAt(compared);
  at("pinned_frame").hidden = !then;
  if (then && at("pinned_image").getAttribute("src") !== addressOf(then)) at("pinned_image").src = addressOf(then);
  const unseen = tracker && tracker.level !== "ok";
  let said = !tracker ? "" : unseen ? `✗ ${tracker.level === "stale" ? "The tracker " : ""}${tracker.message}` : `✓ The object is ${tracker.message}, ${tracker.values["residual [px]"] ?? "–"} px from its outline`;
  if (moment) said = kept ? `Taken ${plain(Math.abs(kept.t - moment.t), 1)} s ${kept.t > moment.t ? "after" : "before"} this moment` : "";
  if (then) said += `${said && "; "}right: the moment compared with`;
  write("seen", said);
  at("seen").classList.toggle("problem", Boolean(unseen));
  const turned = switches();
  for (const id of ["switches", "hand"]) {
    at(id).hidden &&= !turned.lamp; // once it is there it keeps its place: nothing below moves when the run ends
    at(id).style.visibility = turned.lamp ? "" : "hidden";
  }
  for (const button of SWITCHES) button.ariaPressed = String(/(off|unplugged|is pressed)$/.test(turned[button.id]));
}

const lines = new Map(); // of the table, by push

function drawTable() {
  const rows = run.pushes;
  at("no_rows").hidden = rows.length > 0;
  for (const [push, line] of lines) {
    if (run.push(push)) continue;
    line.remove();
    lines.delete(push);
  }
  rows.forEach((row, index) => {
    let line = lines.get(row.push);
    if (!line) {
      line = document.createElement("tr");
      line.dataset.push = row.push;
      for (const label of ["push", "observations", "p_CF x [mm]", "p_CF y [mm]", "μ_c", "fit error [mm]", "verdict", ""]) {
        const cell = line.insertCell();
        if (label) cell.dataset.label = label;
      }
      const button = document.createElement("button");
      button.addEventListener("click", () => {
        const now = run.push(row.push), what = now.excluded || rejectionOf(now) ? "keep" : "exclude";
        ask(`${what}/${row.push}`, `${what} push ${run.numberOf(row.push)}`);
      });
      line.lastChild.append(button);
      at("rows").insertBefore(line, at("rows").children[index] ?? null);
      lines.set(row.push, line);
    }
    const { after } = row, [verdict, bad] = judged(row);
    const texts = [run.numberOf(row.push), row.moments.length, mm(believed(after)?.[0]), mm(believed(after)?.[1]), friction(after), mm(after?.objective, 3), verdict];
    const out = row.excluded || Boolean(rejectionOf(row)), button = line.lastChild.firstChild;
    const now = [...texts, out, connection].join();
    if (line.now === now) return; // to ask a thousand lines what they show takes longer than a frame
    line.now = now;
    texts.forEach((text, column) => { line.cells[column].textContent = text; });
    line.cells[6].className = bad ? "bad" : "";
    line.className = out ? "out" : "";
    button.textContent = out ? "Keep" : "Exclude";
    button.ariaLabel = `${button.textContent} push ${run.numberOf(row.push)}`;
    button.disabled = connection !== "live" || !row.moments.length;
    button.hidden = connection === "over";
  });
}

// Why the estimator leaves a push out by itself, as the last estimate says; undefined if it does not
function rejectionOf(row) {
  return row.excluded ? undefined : story.estimate?.belief.rejected.find((one) => one.push === row.push);
}

function judged(row) {
  if (row.excluded) return [row.aborted ? "aborted, left out" : "excluded", row.aborted];
  const rejected = rejectionOf(row);
  if (rejected) return [`✗ left out: ${rejected.reason.text}`, true];
  if (row.aborted) return ["✗ aborted", true];
  if (!row.moments.length) return ["no observation yet", false];
  return ["✓ counts", false];
}

function drawNodes() {
  const sums = story["node/estimator"]?.values ?? {};
  const kinds = ["poses", "pusher states", "wrenches", "observations", "pushes"].filter((kind) => sums[kind]);
  at("ledger").textContent = kinds.map((kind) => `${kind}: ${sums[kind]}`).join("; ");
  const signs = { ok: "✓", warning: "!", error: "✗", stale: "?" };
  const list = at("nodes");
  at("health").hidden = connection === "over"; // a bag tells of no node
  for (const name of run.nodes) {
    const { level, message, values } = story[name];
    let details = list.querySelector(`[data-node="${CSS.escape(name)}"]`);
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
      details.querySelector("dl").replaceChildren(...Object.entries(values).flatMap(([key, value]) => [worded("dt", key), worded("dd", value)]));
    }
  }
  for (const kept of [...list.children]) if (!story[kept.dataset.node]) kept.remove();
}

// What only the end of a run can tell
let ended = null;
function drawEnd() {
  const { doubts, files, data, tables, made } = story;
  if (!tables || ended === tables) return;
  ended = tables;
  at("doubts").replaceChildren(...doubts.map((doubt) => worded("p", `✗ ${doubt}`)));
  const links = Object.entries(files).map(([download, text]) => [download, { download, href: URL.createObjectURL(new Blob([text])) }]);
  if (data) links.push(["recorded data", { href: data }]);
  const buttons = links.flatMap(([name, where]) => [Object.assign(worded("a", name), { className: "button", ...where }), " "]);
  at("downloads").lastElementChild.replaceChildren(...buttons, ...(connection === "over" ? [at("result_page")] : []));
  at("made").textContent = made;
  at("downloads").hidden = at("made").hidden = false;
  for (const [id, { text, heads, rows, bold = [] }] of Object.entries(tables)) {
    const section = at(id), table = document.createElement("table"), body = table.createTBody();
    for (const row of heads ? [heads, ...rows] : []) {
      const cells = row.map((one) => worded(row === heads && one ? "th" : "td", one));
      if (row.length === 1) Object.assign(cells[0], { className: "under", colSpan: heads.length });
      if (bold.includes(row[0])) cells.at(-1).className = "better";
      body.insertRow().append(...cells);
    }
    section.replaceChildren(section.firstElementChild, ...(text ? [worded("p", text)] : []), Object.assign(document.createElement("div"), { className: "wide", tabIndex: 0 }));
    section.lastElementChild.append(table);
    section.hidden = false;
  }
}

function worded(tag, text) {
  const element = document.createElement(tag);
  element.textContent = text;
  return element;
}

// A simulated object is laid by hand: dragged, turned by its handle, or moved by keys

const isLaid = () => connection === "live" && chosen === null && Boolean(story["node/simulated_cell"] && story.pose);
let held = null; // what a pointer holds: whether it turns, the object's pose, and how far from its middle it was taken
let laid = { pose: null, at: -Infinity }, laying = false; // where it was laid last, and whether that is on its way

async function lay(pose) {
  laid = { pose, at: performance.now() };
  if (laying) return;
  laying = true;
  for (let sent; sent !== laid.pose; ) {
    sent = laid.pose;
    const [x, y, theta] = sent, turn = Math.atan2(Math.sin(theta), Math.cos(theta));
    try {
      const answered = await fetch(`lay/${[1e4 * x, 1e4 * y, (1800 / Math.PI) * turn].map(Math.round).join("/")}`, { method: "POST", headers });
      await answered.text(); // an answer that is not read keeps its connection, of which there are six
    } catch {
      break; // the connection is lost, and said to be
    }
  }
  laying = false;
}

function onTable(event) {
  const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(at("map").getScreenCTM().inverse());
  return at("map").toTable([x, y]);
}

at("map").addEventListener("pointerdown", (event) => {
  const there = document.elementsFromPoint(event.clientX, event.clientY).map((one) => one.classList); // an arrow may lie over it
  const has = (kind) => there.some((classes) => classes.contains(kind));
  if (!isLaid() || !(has("outline") || has("handle"))) return;
  event.preventDefault();
  at("map").setPointerCapture(event.pointerId);
  const [x, y] = onTable(event);
  held = { turns: has("handle"), pose: story.pose, grip: [x - story.pose[0], y - story.pose[1]] };
});
at("map").addEventListener("pointermove", (event) => {
  if (!held) return;
  const [x, y] = onTable(event), [x0, y0, theta] = held.pose;
  lay(held.turns ? [x0, y0, Math.atan2(y - y0, x - x0)] : [x - held.grip[0], y - held.grip[1], theta]);
});
for (const kind of ["pointerup", "pointercancel"]) {
  at("map").addEventListener(kind, () => {
    held = null;
    redraw(); // the map takes its new size now, not when the next pointer is about to take hold
  });
}
at("map").addEventListener("keydown", (event) => {
  const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
  if (!way || !isLaid()) return;
  event.preventDefault();
  const [x, y, theta] = performance.now() - laid.at < 1000 ? laid.pose : story.pose; // what is seen lags behind
  lay(event.shiftKey ? [x, y, theta - (way[0] - way[1]) * 0.05] : [x + 0.002 * way[0], y + 0.002 * way[1], theta]);
});

at("moment").addEventListener("input", ({ target }) => choose(Number(target.value)));
at("moment").addEventListener("keydown", (event) => {
  if (event.key !== "PageUp" && event.key !== "PageDown") return;
  event.preventDefault();
  leap(event.key === "PageUp" ? -1 : 1);
});
for (const kind of ["pointerdown", "pointermove"]) {
  at("line").addEventListener(kind, (event) => {
    if (!event.buttons || !toLine) return;
    const x = event.clientX - at("line").getBoundingClientRect().left, [left, right] = [0, run.moments.length].map(toLine);
    choose(Math.max(0, Math.round(((x - left) / (right - left)) * run.moments.length)));
  });
}
at("earlier").addEventListener("click", () => leap(-1));
at("later").addEventListener("click", () => leap(1));
at("to_now").addEventListener("click", () => choose(Infinity));
at("compare").addEventListener("click", () => {
  pinned = pinned === null ? (shown() ?? run.moments.at(-1)).n : null;
  redraw();
});
at("sound").addEventListener("click", () => {
  sound?.close();
  sound = sound ? null : new AudioContext();
  at("sound").ariaPressed = String(sound !== null);
  ring();
});
addEventListener("resize", redraw);
addEventListener("beforeprint", () => {
  if (!run.moments.length) return;
  toLine = drawLine(at("line"), run, lastIndex(), PAPER); // so that its text is not made small
  drawCursors(at("line"), run, toLine, shown(), momentOf(pinned));
});
addEventListener("afterprint", () => { drawn = []; redraw(); });
listenForGuess(() => story, redraw);
for (const button of document.querySelectorAll(".buttons button")) button.addEventListener("click", () => ask(button.id));
for (const button of SWITCHES) button.addEventListener("click", () => ask(button.id, button.textContent.replace(/ \w+$/, ""))); // without "off" or "pressed"
document.addEventListener("keydown", (event) => {
  if (event.code !== "Space" || at("stop").disabled || connection === "over") return; // whatever has the focus
  event.preventDefault();
  if (!event.repeat) ask("stop");
});
document.addEventListener("keyup", (event) => {
  if (event.code === "Space" && !at("stop").disabled && connection !== "over") event.preventDefault(); // a button acts when the key is let go
});
at("nodes").addEventListener("toggle", redraw, true);
const told = at("story");
if (told) {
  connection = "over";
  run.take({ all: JSON.parse(told.textContent) });
  story = run.story;
  redraw();
} else {
  setInterval(redraw, 500); // what is shown grows old without news
  connect();
}
