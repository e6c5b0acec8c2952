// Strokes on photos that say what is the plant, as `scribbles` of a job: numbers only.

const APART = 0.004; // of the photo's width and height: points that are nearer say nothing new
const MOST_POINTS = 1000; // of a stroke, as the service takes them
export const MOST_STROKES = 200;

export class StrokeList {
  /** Begins with the `scribbles` of an earlier job. */
  constructor(scribbles = []) {
    this.all = scribbles.map((stroke) => ({ ...stroke, points: stroke.points.map((point) => [...point]) }));
  }

  get isFull() {
    return this.all.length >= MOST_STROKES;
  }

  on(photo) {
    return this.all.filter((stroke) => stroke.photo === photo);
  }

  /** Points are shares of the photo's width and height, from left and top. */
  begin(photo, plant, point) {
    if (!this.isFull) this.all.push({ photo, plant, points: [inside(point)] });
  }

  extend(point) {
    const { points } = this.all.at(-1);
    const [x, y] = inside(point);
    const [before, above] = points.at(-1);
    if (Math.hypot(x - before, y - above) < APART) return;
    points.push([x, y]);
    if (points.length > MOST_POINTS) this.all.at(-1).points = points.filter((_, i) => i % 2 === 0);
  }

  /** Take back the last stroke on a photo. */
  undo(photo) {
    const last = this.all.findLastIndex((stroke) => stroke.photo === photo);
    if (last >= 0) this.all.splice(last, 1);
  }

  /** Parameters of a job that cuts out the plant; without strokes it takes what stands in the middle. */
  get params() {
    return this.all.length ? { scribbles: this.all, only_plant: false } : { scribbles: null, only_plant: true };
  }
}

const inside = (point) => point.map((share) => Math.round(1e4 * Math.min(Math.max(share, 0), 1)) / 1e4);
