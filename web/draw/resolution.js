// Adaptive resolution: fewer pixels and rarer shadows while frames are slow, all of them once the picture is still.

const SLOW_MS = 40;
const FAST_MS = 18;
const STEP = 0.8;
export const LEAST = 0.5;
const LEAST_IN_SOFTWARE = 0.6; // of a mesh: its edges look like blocks with fewer
const SETTLE_MS = 250; // a picture that has not changed for so long is drawn in full
const PATIENCE = 6; // frames between two changes
const LONGEST_MS = 500; // a single frame counts as no more: the tab may have been in the background

export class Resolution {
  /** A still picture is drawn at `stillScale` of the pixel ratio; in `software` it begins with the fewest pixels. */
  constructor(stillScale = 1, software = false) {
    this.stillScale = stillScale;
    this.least = software ? LEAST_IN_SOFTWARE : LEAST;
    this.scale = software ? this.least : 1; // of the pixel ratio
    this.frame = this.mean = this.before = this.since = 0;
    this.paused = true;
    this.sharp = true; // the picture on the screen has all its pixels and its shadow
  }

  /** Call once per drawn frame; whether the shadow map is to be drawn anew. */
  next(now) {
    const elapsed = now - this.before;
    this.before = now;
    this.frame++;
    if (!this.paused) this._adapt(Math.min(elapsed, LONGEST_MS));
    this.paused = false;
    this.sharp = this.scale >= this.stillScale;
    return this.frame % this.shadowEvery === 0;
  }

  /** Call in a turn in which nothing is drawn: the time to the next frame says nothing of its cost. */
  pause() {
    this.paused = true;
  }

  /** Whether a picture that was drawn with fewer pixels is now to be drawn in full. */
  settles(now) {
    return !this.sharp && now - this.before > SETTLE_MS;
  }

  /** Frames between two updates of the shadow map. */
  get shadowEvery() {
    return this.scale > 0.9 ? 1 : 2;
  }

  _adapt(elapsed) {
    this.mean = this.mean ? 0.7 * this.mean + 0.3 * elapsed : elapsed;
    if (this.frame - this.since < PATIENCE) return;
    const before = this.scale;
    if (this.mean > SLOW_MS) this.scale = Math.max(this.scale * STEP, this.least);
    else if (this.mean < FAST_MS) this.scale = Math.min(this.scale / STEP, 1);
    if (this.scale !== before) this.since = this.frame;
  }
}
