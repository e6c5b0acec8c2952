// A place that stays under the pointer: a last small bend of its joints, on top of what the service answers.
//
// The service's answer is some milliseconds old and knows nothing of the wind on this page. The bends κ of the joints
// between the place and the root that make up for it are those of least energy: `equilibrium` of dynamictree/modal/pull.py says how, and
// tests/modal/pulls.json holds answers that both must give.

import { turned } from "./modes.js";
import { cross, dot, length, minus, plus, rowOf, scaled } from "./vectors.js";

const ROUNDS = 12; // a frame; the next frame goes on from there
const LARGEST_BEND = 0.5;
const TOLERANCE = 1e-8;
const [STEP_RAD, SETTLED] = [0.5, 3e-4];
const DAMPING = { first: 0.1, least: 1e-9, most: 1e8, sure: 1e-2 };
const [ACCEPT, REFUSE] = [0.25, 6]; // factors of the damping
const LET_GO_S = 0.08; // once nothing is pinned, the place goes like a critically damped spring of this time
const GONE = 3e-3; // of the way

export class Pin {
  /** Of a place as of motion/grip.js. */
  constructor(modes, grip) {
    const { voxel } = grip;
    Object.assign(this, { modes, grip, voxel });
    this.chain = modes.chain(voxel);
    this.group = { seed: voxel, bend: this.chain.map(() => [0, 0, 0]) };
  }

  /** Bend so that `point`, where the wind has it, is carried to `target`; `groups` are those of the service. */
  hold(groups, point, target) {
    this.target = target;
    this._bend(groups, point, 1);
  }

  /** After the turn that ends with the release: at first slowly to where the groups alone have it; whether some is left. */
  fade(groups, point, seconds) {
    this.released = this.released === undefined ? 0 : this.released + seconds;
    const share = (1 + this.released / LET_GO_S) * Math.exp(-this.released / LET_GO_S);
    if (this.target) this._bend(groups, point, share);
    return Boolean(this.target) && share > GONE;
  }

  _bend(groups, point, share) {
    const { chain, group, modes } = this;
    if (!chain.length) return;
    const bends = modes.bends(groups);
    const base = chain.map((j) => rowOf(bends, j));
    const segments = segmentsOf(modes, this.grip, chain, point);
    const aim = minus(this.target, point);
    const alone = equilibrium(segments, aim, { base, bend: chain.map(() => [0, 0, 0]), rounds: 0 }).reached;
    group.bend = equilibrium(segments, plus(alone, scaled(minus(aim, alone), share)), { base, bend: group.bend }).bend;
  }
}

/** What a chain's joints carry of a point: `{ segments, give }`, as `grip_at` of pull.py. */
export function segmentsOf(modes, { joints, weights }, chain, point) {
  const segments = chain.map(() => [0, 0, 0]);
  const carried = chain.map(() => 0); // share of the point beyond each joint
  joints.forEach((joint, i) => {
    let own = joint;
    while (own > 0 && !chain.includes(own)) own = modes.joint_parent[own];
    if (own <= 0) return;
    const at = chain.indexOf(own);
    segments[at] = plus(segments[at], scaled(minus(point, modes.jointAt(own)), weights[i]));
    for (let n = at; n < chain.length; n++) carried[n] += weights[i];
  });
  const step = (n) => minus(n ? modes.jointAt(chain[n - 1]) : point, modes.jointAt(chain[n]));
  for (let n = 1; n < chain.length; n++) segments[n] = plus(segments[n], scaled(step(n), carried[n - 1]));
  return { segments, give: chain.map((j, n) => modes.joint_give[j] * length(step(n))) };
}

/** `{ bend, reached }` of least energy that hold the point at `target` [m from rest]; `base` are bends under them. */
export function equilibrium({ segments, give }, target, { bend, base = null, rounds = ROUNDS }) {
  let arm = [0, 0, 0];
  const size = segments.reduce((sum, s, i) => {
    arm = plus(arm, s);
    return sum + 2 * give[i] * dot(arm, arm);
  }, 0);
  const problem = { segments, give, base, tolerance: TOLERANCE * size, target };
  let now = linear(problem, bend);
  if (!(problem.tolerance > 0)) return now;
  let damping = DAMPING.first;
  for (let round = 0; round < rounds && damping <= DAMPING.most; round++) {
    const tried = linear(problem, stepped(problem, now, damping));
    if (tried.cost < now.cost) {
      const last = length(minus(tried.reached, now.reached)) < SETTLED * length(target) && damping < DAMPING.sure;
      now = tried;
      damping = Math.max(damping * ACCEPT, DAMPING.least);
      if (last) break;
    } else damping *= REFUSE;
  }
  return now;
}

/** The problem around a bend: where the point is, how it moves with each bend, and what it costs. */
function linear({ segments, give, base, tolerance, target }, bend) {
  const frames = [IDENTITY]; // of what carries each joint, from the root
  const arms = [];
  let reached = [0, 0, 0];
  for (let n = segments.length - 1; n >= 0; n--) {
    const frame = product(frames[0], turned(base ? plus(bend[n], base[n]) : bend[n]));
    arms.unshift(applied(frame, segments[n]));
    reached = plus(reached, minus(arms[0], segments[n]));
    frames.unshift(frame);
  }
  let arm = [0, 0, 0];
  const rows = bend.map((k, n) => {
    arm = plus(arm, arms[n]);
    const total = base ? plus(k, base[n]) : k;
    return IDENTITY.map((axis) => leftJacobianOf(total, appliedInverse(frames[n + 1], cross(arm, axis))));
  });
  const gap = minus(target, reached);
  const folded = bend.map((k) => dot(k, k) / LARGEST_BEND ** 2);
  const energy = bend.reduce((sum, k, n) => (give[n] > 0 ? sum + (dot(k, k) * (1 + folded[n] / 2)) / give[n] : sum), 0);
  const soft = give.map((g, n) => g / (1 + folded[n]));
  return { bend, reached, rows, gap, soft, cost: dot(gap, gap) / tolerance + energy };
}

/** The bend after a step to the least cost of the linear problem plus `damping` times the energy of the step. */
function stepped({ tolerance }, { bend, rows, gap, soft }, damping) {
  const share = 1 / (1 + damping);
  const give = soft.map((g) => share * g);
  const aim = rows.reduce((sum, three, n) => plus(sum, scaled(applied(three, bend[n]), share)), gap);
  const force = solved(compliance(rows, give, tolerance), aim);
  const steps = rows.map((three, n) =>
    plus(scaled(applied(transposed(three), force), give[n]), scaled(bend[n], -share)),
  );
  const taken = Math.min(1, STEP_RAD / Math.max(...steps.map(length), 1e-12));
  return bend.map((k, n) => plus(k, scaled(steps[n], taken)));
}

const IDENTITY = [0, 1, 2].map((i) => [0, 1, 2].map((j) => Number(i === j)));

const applied = (rows, v) => rows.map((row) => dot(row, v));
const transposed = (rows) => rows.map((_, j) => rows.map((row) => row[j]));
const appliedInverse = (rows, v) => applied(transposed(rows), v);
const product = (a, b) => a.map((row) => applied(transposed(b), row));

/** A row times the left Jacobian of exp[v]×. */
function leftJacobianOf(v, row) {
  const a = length(v);
  const [d, e] =
    a > 1e-3 ? [(1 - Math.cos(a)) / a ** 2, (a - Math.sin(a)) / a ** 3] : [0.5 - a ** 2 / 24, 1 / 6 - a ** 2 / 120];
  return plus(row, plus(scaled(cross(row, v), d), scaled(cross(cross(row, v), v), e)));
}

/** Σ g J Jᵀ + ε I: displacement of the place over the force there. */
function compliance(arms, give, tolerance) {
  return [0, 1, 2].map((i) =>
    [0, 1, 2].map((j) => arms.reduce((sum, rows, n) => sum + give[n] * dot(rows[i], rows[j]), i === j ? tolerance : 0)),
  );
}

/** Cramer's rule for a symmetric matrix. */
function solved(rows, right) {
  const [a, b, c] = rows;
  const bc = cross(b, c);
  const det = dot(a, bc);
  return [dot(right, bc) / det, dot(right, cross(c, a)) / det, dot(right, cross(a, b)) / det];
}
