// The states of the page, and the events that lead from one to the next. What the page shows follows from them.

const ALWAYS = { upload: "uploading", open: "queued", leave: "welcome", failed: "failed" };

export const TRANSITIONS = {
  welcome: { upload: "uploading", open: "queued", leave: "welcome" },
  uploading: { ...ALWAYS, accepted: "queued" },
  queued: { ...ALWAYS, accepted: "queued", started: "running", moving: "moving" },
  running: { ...ALWAYS, accepted: "queued", waiting: "queued", started: "running", moving: "moving" },
  moving: { ...ALWAYS, moving: "moving" },
  failed: { ...ALWAYS },
};

/** One state, and the facts that belong to it: name, files, asset, job, share, away, problem. */
export class Machine {
  /** `onChange(state, facts, before)` is called after each event and each update. */
  constructor(onChange = (_state, _facts, _before) => {}) {
    this.state = "welcome";
    this.facts = {};
    this.onChange = onChange;
  }

  /** Take a transition. Events that begin something anew forget the facts of before. */
  send(event, facts = {}) {
    const next = TRANSITIONS[this.state][event];
    if (!next) throw new Error(`the page is ${this.state}; ${event} leads nowhere`);
    const before = this.state;
    const fresh = event === "upload" || event === "open" || event === "leave";
    this.state = next;
    this.facts = fresh ? facts : { ...this.facts, ...facts };
    this.onChange(this.state, this.facts, before);
  }

  /** Change facts within a state. */
  update(facts) {
    Object.assign(this.facts, facts);
    this.onChange(this.state, this.facts, this.state);
  }
}
