// The run that the page shows, made of its story; story.py lists the keys.
const KINDS = ["moment", "push", "event", "picture"];

export class Run {
  story = {};
  moments = []; // the observations, each with its push and what was known after it
  pushes = []; // each with its moments
  events = [];
  pictures = [];
  version = 0; // of these four

  /** Take the whole story, or some of it. */
  take({ all, some }) {
    if (all) this.story = {};
    const told = Object.entries(all ?? some);
    for (const [key, value] of told) {
      if (value === null) delete this.story[key];
      else this.story[key] = value;
    }
    if (all || told.some(([key]) => KINDS.includes(key.split("/", 1)[0]))) this.#arrange();
  }

  /** The number of a push: its place in the plan, and whether it was repeated; push_plan.number_of says the same. */
  numberOf(push) {
    const count = this.story.plan?.count;
    return count ? `${push % count + 1}${push >= count ? " (again)" : ""}` : `${push + 1}`;
  }

  /** The estimate after a moment; without one, the present estimate. */
  estimateAt(moment) {
    if (!moment) return this.story.estimate;
    return moment.known && { ...moment.known, support_points: this.story[`support/${moment.known.object}`] ?? [] };
  }

  /** The picture that is nearest in time to a moment; without one, the newest. */
  pictureAt(moment) {
    const away = (picture) => Math.abs(picture.t - moment.t);
    return moment ? this.pictures.reduce((best, one) => (best && away(best) <= away(one) ? best : one), undefined) : this.pictures.at(-1);
  }

  #arrange() {
    const [moments, pushes, events, pictures] = KINDS.map((kind) => this.#numbered(`${kind}/`));
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

  #numbered(prefix) {
    const found = Object.entries(this.story).filter(([key]) => key.startsWith(prefix));
    return found.map(([key, value]) => Object.assign(value, { key, n: Number(key.slice(prefix.length)) })).sort((a, b) => a.n - b.n);
  }
}
