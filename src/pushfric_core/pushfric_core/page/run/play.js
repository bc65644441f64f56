// The game of a simulated cell: cards that teach, each turned over when the run shows that it is done.
import { believed, made } from "./drawings.js";

const UNTIL_GUESSED = 3; // pushes
const isBad = ({ excluded, aborted }) => excluded || aborted;
const said = (story) => story["node/simulated_cell"]?.values ?? {};
const away = (guess, center) => (1e3 * Math.hypot(guess[0] - center[0], guess[1] - center[1])).toFixed(1);

let card = 0, guess = null, guessed = false, before = 0; // bad pushes before the card

// Title, what to do, and whether it is done
const CARDS = [
  ["Place", () => "The object lies beside its place. On the table's map, drag it onto the dashed outline and turn it by its ring. Keys: arrows move it, Shift and arrows turn it.",
    ({ plan }) => plan?.in_place || plan?.phase === "pushing"],
  ["Push", () => "Hands off: once it lies still, the pusher comes by itself. Each image gives a pose, each motion an observation.",
    ({ plan }) => plan?.completed >= 1],
  ["Stop", () => "Place it again. While the pusher moves, stop it: the space bar, or the red Stop button. This works even if the page has lost the cell.",
    ({ fault }) => fault === "stopped"],
  ["Go on", () => "Nothing moves before a person has looked. Press Reset, then Repeat, and place the object once more.",
    ({ fault, plan }) => fault !== "stopped" && plan?.phase === "placing"],
  ["Darkness", () => "While it waits to be placed, switch the lamp off, below the camera's image. See what the page still claims.",
    (story) => said(story).lamp?.endsWith("off")],
  ["Light", () => "No tick and no distance are left: what is not seen is not claimed. Switch the lamp on again.",
    (story) => said(story).lamp?.endsWith("on") && story["node/tracker"]?.level === "ok"],
  ["Guess", ({ plan }) => (plan?.completed < UNTIL_GUESSED ? `Place and push on: ${plan.completed} of ${UNTIL_GUESSED} pushes. Watch which way the object turns: a push along a line through p_CF does not turn it.` :
    "Where is p_CF, the point on which friction seems to act? Click into the drawing of the object (keys: arrows, when it has the focus), then press My guess."), () => guessed],
  ["Cheat", ({ estimate }) => `${result(estimate)} Now spoil one push: while the pusher moves, drag the object some centimetres aside (keys: an arrow, again and again). Then place and push on: it may take six pushes to tell.`,
    (story, { pushes }) => pushes.filter(isBad).length + (story.estimate?.belief.rejected.length ?? 0) > before],
  ["Found", () => "The spoilt push is found: the table of pushes says why, and it is left out. Repeat or skip it, and go on with the pushes that are left, or press End: the result comes in any case.",
    ({ plan }) => plan?.phase === "finished"],
  ["Result", ({ estimate }) => `${result(estimate)} The line of the run leads back to any moment; the report is yours to hand on.`, () => false],
];

function result(estimate) {
  const center = believed(estimate), radius = estimate?.belief.radius;
  return center && guess ? `You guessed p_CF ${away(guess, center)} mm from where pushfric says that it is${radius ? `, to within ${(1e3 * radius).toFixed(1)} mm` : ""}.` : "";
}

const mayGuess = ({ plan }) => CARDS[card][0] === "Guess" && plan?.completed >= UNTIL_GUESSED;

/** Show the card that is due, and hide p_CF until it is guessed. */
export function drawCard(run, story) {
  document.getElementById("lesson").hidden = !story.played;
  document.body.classList.toggle("guessing", Boolean(story.played) && !guessed);
  if (!story.played) return;
  for (; CARDS[card][2](story, run); card += 1) before = run.pushes.filter(isBad).length + (story.estimate?.belief.rejected.length ?? 0);
  const [title, text] = CARDS[card], words = `${card + 1} of ${CARDS.length}: ${title}. ${text(story)}`, shown = document.getElementById("card");
  if (shown.textContent !== words) shown.textContent = words;
  document.getElementById("guess").hidden = !mayGuess(story);
  document.getElementById("guess").disabled = !guess;
  const svg = document.getElementById("drawing");
  if (mayGuess(story)) svg.setAttribute("tabindex", "0");
  else svg.removeAttribute("tabindex");
  svg.querySelector(".guess")?.remove();
  if (guess && svg.toScreen) {
    const [u, v] = svg.toScreen(guess);
    svg.append(made("path", { class: "guess", d: `M${u - 9} ${v - 9}l18 18m-18 0l18 -18` }));
  }
}

/** Let a visitor point at p_CF; `redraw` shows it. */
export function listenForGuess(story, redraw) {
  const svg = document.getElementById("drawing");
  const take = (point) => { guess = point; redraw(); };
  svg.addEventListener("click", (event) => {
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    if (mayGuess(story())) take(svg.toObject([x, y]));
  });
  svg.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!way || !mayGuess(story())) return;
    event.preventDefault();
    take((guess ?? [0, 0]).map((value, axis) => value + 0.001 * way[axis]));
  });
  document.getElementById("guess").addEventListener("click", () => { guessed = true; redraw(); });
}
