// A place that stays under the pointer: a last small bend of its joints, on top of what the service answers.
//
// The service's answer is some milliseconds old and knows nothing of the wind on this page. The bends κ of the joints
// between the place and the root that make up for it are those of least energy: `equilibrium` of dynamictree/modal/pull.py says how, and
// tests/modal/pulls.json holds answers that both must give.

import { turned } from "./modes.js";
import { cross, dot, length, minus, plus, rowOf, scaled } from "./vectors.js";

const ROUNDS = 12; // a frame; the next frame goes on from there
const MAX_BEND_RAD = 0.4;
const [TOLERANCE, RIGID] = [3e-7, 1e-14];
const [MAX_STEP_RAD, CONVERGED_RAD, MIN_STEP_RAD] = [0.5, 1e-3, 1e-6];
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
  const compliance = segments.reduce((sum, s, i) => {
    arm = plus(arm, s);
    return sum + 2 * give[i] * dot(arm, arm);
  }, 0);
  const least = RIGID * give.reduce((sum, g) => sum + g, 0);
  const rod = { segments, give: give.map((g) => Math.max(g, least)), base, target, tolerance: TOLERANCE * compliance };
  let now = stance(rod, bend);
  if (!(compliance > 0)) return now;
  let [force, price, longest] = [[0, 0, 0], 0, MAX_STEP_RAD];
  for (let round = 0; round < rounds && longest >= MIN_STEP_RAD; round++) {
    const { force: next, step } = newtonStep(rod, now, force);
    [force, price] = [next, Math.max(price, 1.5 * length(next))];
    const size = Math.max(...step.map(length));
    const share = Math.min(1, longest / Math.max(size, MIN_STEP_RAD));
    const bends = now.bend.map((k, n) => plus(k, scaled(step[n], share)));
    const tried = stance(rod, bends);
    if (tried.energy - now.energy > price * (length(now.gap) - length(tried.gap))) {
      longest = 0.3 * Math.min(longest, size);
      continue;
    }
    now = tried;
    if (size <= Math.min(longest, CONVERGED_RAD)) break;
    longest = Math.min(MAX_STEP_RAD, 2 * longest);
  }
  return now;
}

/** A bend: where it brings the point, the turned segments, what carries each, the moment in each joint, the energy. */
function stance({ segments, give, base, target }, bend) {
  let [frame, reached, energy] = [IDENTITY, [0, 0, 0], 0];
  const [arms, before, moments, stiffness] = [[], [], [], []];
  const total = bend.map((k, n) => (base ? plus(k, base[n]) : k));
  for (let n = segments.length - 1; n >= 0; n--) {
    const square = dot(bend[n], bend[n]);
    const folded = (square / MAX_BEND_RAD ** 2) ** 2;
    energy += (square * (1 + folded / 3)) / give[n] / 2;
    stiffness[n] = (1 + 5 * folded) / give[n];
    moments[n] = applied(frame, ofTurn(scaled(total[n], -1), scaled(bend[n], (1 + folded) / give[n])));
    before[n] = frame;
    frame = product(frame, turned(total[n]));
    arms[n] = applied(frame, segments[n]);
    reached = plus(reached, minus(arms[n], segments[n]));
  }
  return { bend, total, reached, gap: minus(target, reached), arms, before, moments, stiffness, energy };
}

/** The force at the point, and the step of each bend; `force` is that of the round before. */
function newtonStep({ tolerance }, { total, gap, arms, before, moments, stiffness }, force) {
  const tension = []; // what stiffens the segments up to this one in space
  const turns = arms.map((arm, n) => [
    ...IDENTITY.map((axis) => cross(arm, axis)), // for a force along each axis
    minus(moments[n], moments[n - 1] ?? [0, 0, 0]),
  ]);
  for (const [n, arm] of arms.entries()) {
    tension[n] = Math.max(dot(arm, force), 0);
    if (!n) continue;
    const share = stiffness[n - 1] / (stiffness[n - 1] + tension[n - 1]);
    tension[n] += share * tension[n - 1];
    turns[n] = turns[n].map((turn, i) => plus(turn, scaled(turns[n - 1][i], share)));
  }
  let above = [0, 1, 2, 3].map(() => [0, 0, 0]);
  let moved = IDENTITY.map((axis) => scaled(axis, tolerance)).concat([gap]);
  for (let n = arms.length - 1; n >= 0; n--) {
    const share = 1 / (stiffness[n] + tension[n]);
    above = turns[n] = turns[n].map((turn, i) => scaled(plus(turn, scaled(above[i], stiffness[n])), share));
    moved = moved.map((sum, i) => plus(sum, cross(above[i], arms[n])));
  }
  const next = solved(moved.slice(0, 3), moved[3]);
  const turn = turns.map((four) => minus(applied(transposed(four.slice(0, 3)), next), four[3]));
  const apart = turn.map((own, n) => minus(own, turn[n + 1] ?? [0, 0, 0]));
  return { force: next, step: apart.map((own, n) => ofTurn(total[n], applied(transposed(before[n]), own))) };
}

const IDENTITY = [0, 1, 2].map((i) => [0, 1, 2].map((j) => Number(i === j)));

const applied = (rows, v) => rows.map((row) => dot(row, v));
const transposed = (rows) => rows[0].map((_, j) => rows.map((row) => row[j]));
const product = (a, b) => a.map((row) => applied(transposed(b), row));

/** How a bend grows under a small turn in its frame: the inverse of the left Jacobian of exp[v]×. */
function ofTurn(v, turn) {
  const again = cross(v, turn);
  return plus(minus(turn, scaled(again, 1 / 2)), scaled(cross(v, again), 1 / 12));
}

/** Cramer's rule for a symmetric matrix. */
function solved(rows, right) {
  const [a, b, c] = rows;
  const bc = cross(b, c);
  const det = dot(a, bc);
  return [dot(right, bc) / det, dot(right, cross(c, a)) / det, dot(right, cross(a, b)) / det];
}
