// A place that stays under the pointer: a last small bend of its joints, on top of what the service answers.
//
// The service's answer is some milliseconds old and knows nothing of the wind on this page. The bends κ of the joints
// between the place and the root that make up for it are those of least energy, Σ |κ_b|² / g_b, as in
// dynamictree/modal/pull.py; each round solves a 3 × 3 system for the force λ that holds the place.

import { carriedPoint } from "./grip.js";
import { carried } from "./modes.js";
import { cross, dot, length, minus, plus, scaled } from "./vectors.js";

const ROUNDS = 4;
const STEP_RAD = 0.3;
const MOST_RAD = 1;
const TOLERANCE = 1e-4; // of the compliance: a direction in which nothing gives way is not followed
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
  }

  /** Bend so that `point`, where the wind has it, is carried to `target`; `groups` are those of the service. */
  hold(groups, point, target) {
    const { modes, chain, give, group, grip } = this;
    if (!chain.length) return;
    for (let round = 0; round < ROUNDS; round++) {
      modes.poses([...groups, group], this.poses);
      const at = carriedPoint(this.poses, grip, point);
      const gap = minus(target, at);
      if (length(gap) < 0.01 * modes.voxelSize) return;
      const arms = chain.map((b, i) => this._arm(b, this.under[i], point));
      const old = group.bend.map((k, i) => modes.inFrame(this._parent(i), k));
      const aim = old.reduce((sum, turn, i) => plus(sum, cross(turn, arms[i])), gap);
      const force = solved(compliance(arms, give), aim);
      const wanted = arms.map((arm, i) => modes.fromFrame(this._parent(i), scaled(cross(arm, force), give[i])));
      this._approach(wanted);
    }
  }

  /** How the point moves where the joint of bone b turns: Σ w (x − joint), over the bones that turn with it. */
  _arm(b, weights, point) {
    const joint = carried(this.poses, b, jointOf(this.modes, b));
    return this.grip.bones.reduce(
      (sum, bone, i) => {
        return weights[i] ? plus(sum, scaled(minus(carried(this.poses, bone, point), joint), weights[i])) : sum;
      },
      [0, 0, 0],
    );
  }

  _parent(i) {
    return this.modes.bone_parent[this.chain[i]];
  }

  _approach(wanted) {
    const steps = wanted.map((k, i) => minus(k, this.group.bend[i]));
    const share = Math.min(1, STEP_RAD / Math.max(...steps.map(length), 1e-9));
    this.group.bend = this.group.bend.map((k, i) => {
      const next = plus(k, scaled(steps[i], share));
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

const jointOf = (modes, b) => modes.bone_joint_m.subarray(3 * b, 3 * b + 3);

/** Σ g (|d|² I − d dᵀ), with a small share of its trace added: displacement of the place over the force there. */
function compliance(arms, give) {
  const rows = [0, 1, 2].map((i) =>
    [0, 1, 2].map((j) => arms.reduce((sum, d, n) => sum + give[n] * ((i === j ? dot(d, d) : 0) - d[i] * d[j]), 0)),
  );
  const small = TOLERANCE * (rows[0][0] + rows[1][1] + rows[2][2]) + 1e-30;
  return rows.map((row, i) => row.map((value, j) => value + (i === j ? small : 0)));
}

/** Cramer's rule for a symmetric matrix. */
function solved([a, b, c], right) {
  const bc = cross(b, c);
  const det = dot(a, bc);
  return [dot(right, bc) / det, dot(right, cross(c, a)) / det, dot(right, cross(a, b)) / det];
}
