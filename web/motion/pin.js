// A place that stays under the pointer: a last small bend of its joints, on top of what the service answers.
//
// The service's answer is some milliseconds old and knows nothing of the wind on this page. The bends κ of the joints
// between the place and the root that make up for it are those of least cost, |gap|² / ε + Σ |κ_b|² / g_b, as in
// dynamictree/modal/pull.py: Levenberg-Marquardt, in which each round solves a 3 × 3 system for the force λ that holds
// the place.

import { carriedPoint } from "./grip.js";
import { carried } from "./modes.js";
import { cross, dot, length, minus, plus, scaled } from "./vectors.js";

const ROUNDS = 12; // a frame; the next frame goes on from there
const STEP_RAD = 0.3;
const MOST_RAD = 1;
const TOLERANCE = 1e-6; // ε of the compliance: a direction in which nothing gives way is not followed
const DAMPING = { least: 1e-3, first: 1e-2, most: 1e4 };
const [ACCEPT, REFUSE] = [0.25, 6]; // factors of the damping
const LET_GO_S = 0.08; // once nothing is pinned, the bend goes like a critically damped spring of this time

export class Pin {
  /** Of a place as of motion/grip.js. */
  constructor(modes, grip) {
    const { voxel } = grip;
    Object.assign(this, { modes, grip, voxel });
    this.chain = modes.chain(voxel);
    const size = modes.carriedVoxels();
    const ends = [modes.centres.subarray(3 * voxel, 3 * voxel + 3), ...this.chain.map((b) => jointOf(modes, b))];
    this.give = this.chain.map((b, i) => length(minus(ends[i], jointOf(modes, b))) / size[b]);
    this.under = this.chain.map((b) => grip.weights.map((w, i) => (modes.isUnder(grip.bones[i], b) ? w : 0)));
    this.group = { seed: voxel, bend: this.chain.map(() => [0, 0, 0]) };
    this.poses = new Float32Array(12 * modes.B);
    this.damping = DAMPING.first;
  }

  /** Bend so that `point`, where the wind has it, is carried to `target`; `groups` are those of the service. */
  hold(groups, point, target) {
    const { chain, group } = this;
    if (!chain.length) return;
    let best = this._linear(groups, point, target);
    for (let round = 1; round < ROUNDS && length(best.gap) > 0.01 * this.modes.voxelSize; round++) {
      group.bend = this._stepped(best);
      const tried = this._linear(groups, point, target, best.tolerance);
      const better = tried.cost < best.cost;
      this.damping = clamp(this.damping * (better ? ACCEPT : REFUSE), DAMPING.least, DAMPING.most);
      if (better) best = tried;
    }
    group.bend = best.bend;
  }

  /** The problem around the bend of now: `arms[b]` are the three rows of ∂place/∂κ_b. */
  _linear(groups, point, target, tolerance) {
    const { modes, chain, give, group, grip } = this;
    modes.poses([...groups, group], this.poses);
    const gap = minus(target, carriedPoint(this.poses, grip, point));
    const arms = chain.map((b, i) => this._arms(b, this.under[i], point));
    const epsilon = tolerance ?? TOLERANCE * arms.reduce((sum, rows, i) => sum + give[i] * sumOfSquares(rows), 1e-30);
    const energy = group.bend.reduce((sum, k, i) => sum + (give[i] > 0 ? dot(k, k) / give[i] : 0), 0);
    return { gap, arms, bend: group.bend, tolerance: epsilon, cost: dot(gap, gap) / epsilon + energy };
  }

  /** How the point moves where the joint of bone b turns: the arm is Σ w (x − joint), over the bones that turn with it. */
  _arms(b, weights, point) {
    const { modes, poses, grip } = this;
    const joint = carried(poses, b, jointOf(modes, b));
    const arm = grip.bones.reduce(
      (sum, bone, i) => {
        return weights[i] ? plus(sum, scaled(minus(carried(poses, bone, point), joint), weights[i])) : sum;
      },
      [0, 0, 0],
    );
    return AXES.map((axis) => modes.inFrame(modes.bone_parent[b], cross(arm, axis)));
  }

  /** The bend after a step to the least cost of the linear problem plus `damping` times the energy of the step. */
  _stepped({ gap, arms, bend, tolerance }) {
    const share = 1 / (1 + this.damping);
    const soft = this.give.map((g) => share * g);
    const aim = arms.reduce((sum, rows, i) => plus(sum, scaled(applied(rows, bend[i]), share)), gap);
    const force = solved(compliance(arms, soft, tolerance), aim);
    const steps = arms.map((rows, i) =>
      plus(scaled(applied(transposed(rows), force), soft[i]), scaled(bend[i], -share)),
    );
    const taken = Math.min(1, STEP_RAD / Math.max(...steps.map(length), 1e-9));
    return bend.map((k, i) => {
      const next = plus(k, scaled(steps[i], taken));
      return scaled(next, Math.min(1, MOST_RAD / Math.max(length(next), 1e-9)));
    });
  }

  /** After the release: the bend goes, at first slowly, or the place would jump; whether some is left. */
  fade(seconds) {
    this.released ??= { seconds: 0, bend: this.group.bend };
    this.released.seconds += seconds;
    const times = this.released.seconds / LET_GO_S;
    this.group.bend = this.released.bend.map((k) => scaled(k, (1 + times) * Math.exp(-times)));
    return this.group.bend.some((k) => length(k) > 1e-4);
  }
}

const AXES = [0, 1, 2].map((i) => [0, 1, 2].map((j) => Number(i === j)));

const jointOf = (modes, b) => modes.bone_joint_m.subarray(3 * b, 3 * b + 3);
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const applied = (rows, v) => rows.map((row) => dot(row, v));
const transposed = (rows) => rows.map((_, j) => rows.map((row) => row[j]));
const sumOfSquares = (rows) => rows.reduce((sum, row) => sum + dot(row, row), 0);

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
