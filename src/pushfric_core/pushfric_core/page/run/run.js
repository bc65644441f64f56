// The run that the page shows, made of its story; story.py lists the keys.
const KINDS = ["moment", "push", "event", "picture"];

// What passes, and how often it comes at least [s]
const PERIODS = { node: 1, pose: 0.5, pusher: 0.5, image: 0.5 };
const GONE = 3; // what is older than this many of its periods is not shown
const SILENT = { level: "stale", message: "does not report", values: {} };
const periodOf = (key) => PERIODS[key.split("/", 1)[0]];

export class Run {
  story = {}; // but for the parts of these kinds, of which a long run has thousands
  #parts = new Map(); // by their keys
  #stale = false; // some of them are not arranged yet
  moments = []; // the observations, each with its push and what was known after it
  pushes = []; // each with its moments
  events = [];
  pictures = [];
  version = 0; // of these four
  #came = new Map(); // when what passes did [ms]

  /** Note that something that passes has come, some time ago [s]. */
  came(key, ago = 0) {
    this.#came.set(key, performance.now() - 1e3 * ago);
  }

  /** The age of something that passes, in its periods: it fades from 1 on, and goes at `GONE`. */
  age(key) {
    return this.#came.has(key) ? (performance.now() - this.#came.get(key)) / (1e3 * periodOf(key)) : 0;
  }

  isGone(key) {
    return this.age(key) >= GONE;
  }

  /** The keys of the nodes that have ever reported, in order. */
  get nodes() {
    return [...this.#came.keys()].filter((key) => key.startsWith("node/") && key in this.story).sort();
  }

  /** The story without what is too old to be so now: what passes, and what a node said that does not report any more. */
  present() {
    const story = { ...this.story };
    for (const key of this.#came.keys()) {
      if (!this.isGone(key)) continue;
      if (key.startsWith("node/")) story[key] = SILENT;
      else story[key] = undefined;
    }
    const silent = (node) => story[`node/${node}`] === SILENT && story.plan?.phase !== "finished";
    if (silent("experiment") && story.plan) story.plan = { ...story.plan, phase: "silent", message: "The experiment does not report", in_place: false, purpose: "", details: "" };
    if (silent("actuator")) story.fault = undefined;
    story.outdated = silent("estimator");
    return story;
  }

  /** Take the whole story, or some of it. */
  take({ all, some }) {
    if (all) {
      this.story = {};
      this.#parts.clear();
      this.#stale = true;
    }
    for (const [key, value] of Object.entries(all ?? some)) {
      if (KINDS.includes(key.split("/", 1)[0])) {
        this.#stale = true;
        if (value === null) this.#parts.delete(key);
        else this.#parts.set(key, value);
      } else if (value === null) delete this.story[key];
      else this.story[key] = value;
      if (periodOf(key) && key !== "image") this.came(key, (all ?? some).ages?.[key]);
    }
  }

  /** A push, as it was last told of; undefined if it is forgotten. */
  push(number) {
    return this.#parts.get(`push/${number}`);
  }

  /** The number of a push: its place in the plan, and whether it was repeated, or else its id; push_plan.number_of says the same. */
  numberOf(push) {
    const count = this.story.plan?.count;
    return count ? `${push % count + 1}${push >= count ? " (again)" : ""}` : `${push}`;
  }

  /** The estimate after a moment; without one, or at the end of a run that is over, the last estimate. */
  estimateAt(moment) {
    if (!moment || (this.story.recorded && moment === this.moments.at(-1))) return this.story.estimate;
    return moment.known && { ...moment.known, support_points: this.story[`support/${moment.known.object}`] ?? [] };
  }

  /** The picture that is nearest in time to a moment; without one, the newest. */
  pictureAt(moment) {
    const away = (picture) => Math.abs(picture.t - moment.t);
    return moment ? this.pictures.reduce((best, one) => (best && away(best) <= away(one) ? best : one), undefined) : this.pictures.at(-1);
  }

  /** Let moments, pushes, events and pictures be all that have come: of a long run, that takes longer than a frame. */
  arrange() {
    if (!this.#stale) return;
    this.#stale = false;
    const found = Object.fromEntries(KINDS.map((kind) => [kind, []]));
    for (const [key, value] of this.#parts) {
      const [kind, n] = key.split("/", 2);
      found[kind].push(Object.assign(value, { key, n: Number(n) }));
    }
    const [moments, pushes, events, pictures] = KINDS.map((kind) => found[kind].sort((a, b) => a.n - b.n));
    const count = this.story.plan?.count || Infinity; // a push that is repeated follows its first try
    pushes.sort((a, b) => (a.n % count) - (b.n % count) || a.n - b.n);
    const rows = new Map(pushes.map((push) => [push.n, Object.assign(push, { moments: [], after: null })]));
    let known = null;
    this.moments = moments.filter((moment) => rows.has(moment.push));
    this.moments.forEach((moment, index) => {
      const row = rows.get(moment.push);
      known = moment.after ?? known;
      row.after = moment.after ?? row.after;
      Object.assign(moment, { index, known, row, place: row.moments.push(moment) });
    });
    Object.assign(this, { pushes, events, pictures, version: this.version + 1 });
  }
}
