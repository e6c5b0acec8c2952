// A tree's motion as numbers: the file of /v1/spectra/{id}/modes, evaluated as docs/interaction.md says.

import { readTensors } from "./tensors.js";

/** Of the shipped model: a crown yields, so the wind's force grows with U^1.4, not U² (Vogel). */
const DRAG_EXPONENT = 1.4;

/** How much stronger the sway of a wind is than that of another [m/s both]. */
export const windGain = (speed, reference) => (Math.max(speed, 0) / Math.max(reference, 0.1)) ** DRAG_EXPONENT;

/** Coordinates of the wind's own loop: the lean, and q_k = e^{2πik·phase}. Real and imaginary part of K bins. */
export function windCoordinates(K, phase, gain = 1) {
  const q = new Float32Array(2 * K);
  for (let k = 0; k < K; k++) {
    q[2 * k] = gain * Math.cos(2 * Math.PI * k * phase);
    q[2 * k + 1] = gain * Math.sin(2 * Math.PI * k * phase);
  }
  return q;
}

/** Voxels and bones. `lean` is put into bin 0 of `shapes`, whose place is empty in the file. */
export class Modes {
  constructor(buffer) {
    const { tensors, metadata } = readTensors(buffer);
    Object.assign(this, tensors);
    [this.V, this.K, this.B] = [this.coords.length / 3, this.scale_m.length, this.bone_parent.length];
    this.voxelSize = JSON.parse(metadata.voxel_size_m);
    const origin = JSON.parse(metadata.origin_m);
    this.centres = Float32Array.from(this.coords, (step, i) => origin[i % 3] + (step + 0.5) * this.voxelSize);
    this._putLean();
  }

  _putLean() {
    const steps = 32767;
    const largest = this.lean_m.reduce((most, value) => Math.max(most, Math.abs(value)), 1e-9);
    this.scale_m[0] = largest / steps;
    for (let v = 0; v < this.V; v++)
      for (let c = 0; c < 3; c++) {
        this.shapes[2 * (v * this.K * 3 + c)] = Math.round((this.lean_m[3 * v + c] / largest) * steps);
      }
  }

  /** Displacement of one voxel under the wind [m]. */
  voxelAt(v, q) {
    const u = [0, 0, 0];
    for (let k = 0; k < this.K; k++)
      for (let c = 0; c < 3; c++) {
        const at = 2 * ((v * this.K + k) * 3 + c);
        u[c] += this.scale_m[k] * (this.shapes[at] * q[2 * k] - this.shapes[at + 1] * q[2 * k + 1]);
      }
    return u;
  }

  /** Mean weight of each bone's voxels in a group, once a group. */
  boneWeights(weights) {
    const sum = new Float32Array(this.B);
    const count = new Float32Array(this.B);
    this.bone_of_voxel.forEach((b, v) => {
      sum[b] += weights[v];
      count[b] += 1;
    });
    return sum.map((value, b) => value / Math.max(count[b], 1));
  }

  /** The warp: 12 numbers a bone, rows of [R | t]; a point x goes to R x + t. Groups: `{ q: [[re, im]…], perBone }`. */
  poses(groups, out = new Float32Array(12 * this.B)) {
    const moved = this._boneMoves(groups);
    for (let b = 0; b < this.B; b++) {
      // parents come before children
      const root = this.bone_parent[b] < 0;
      const a = root ? b : this.bone_parent[b];
      const d = [0, 1, 2].map((c) => (moved[3 * b + c] - moved[3 * a + c]) / this.bone_lever_m2[b]);
      const r = this.bone_reach_m.subarray(3 * b, 3 * b + 3);
      const joint = this.bone_joint_m.subarray(3 * b, 3 * b + 3);
      const R = turned(r[1] * d[2] - r[2] * d[1], r[2] * d[0] - r[0] * d[2], r[0] * d[1] - r[1] * d[0]);
      // the joint is a point of the parent, and goes where the parent carries it
      const place = root ? joint : [0, 1, 2].map((i) => row(out, a, i, joint));
      for (let i = 0; i < 3; i++) {
        out.set([R[3 * i], R[3 * i + 1], R[3 * i + 2]], 12 * b + 4 * i);
        out[12 * b + 4 * i + 3] = place[i] - R[3 * i] * joint[0] - R[3 * i + 1] * joint[1] - R[3 * i + 2] * joint[2];
      }
    }
    return out;
  }

  _boneMoves(groups) {
    const moved = new Float32Array(3 * this.B);
    const K = this.K;
    for (const { q, perBone } of groups)
      for (let b = 0; b < this.B; b++) {
        if (perBone[b] < 1e-4) continue;
        for (let k = 1; k < K; k++) {
          const [re, im] = q[k];
          const scale = perBone[b] * this.scale_m[k];
          for (let c = 0; c < 3; c++) {
            const at = 2 * ((b * K + k) * 3 + c);
            moved[3 * b + c] += scale * (this.bone_shapes[at] * re - this.bone_shapes[at + 1] * im);
          }
        }
      }
    return moved;
  }
}

/** A point under one bone's pose. */
export const carried = (poses, b, x) => [0, 1, 2].map((i) => row(poses, b, i, x));

const row = (poses, b, i, x) => {
  const at = 12 * b + 4 * i;
  return poses[at] * x[0] + poses[at + 1] * x[1] + poses[at + 2] * x[2] + poses[at + 3];
};

function turned(x, y, z) {
  // Rodrigues
  const angle = Math.max(Math.hypot(x, y, z), 1e-12);
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  [x, y, z] = [x / angle, y / angle, z / angle];
  return [
    c + x * x * (1 - c),
    x * y * (1 - c) - z * s,
    x * z * (1 - c) + y * s,
    y * x * (1 - c) + z * s,
    c + y * y * (1 - c),
    y * z * (1 - c) - x * s,
    z * x * (1 - c) - y * s,
    z * y * (1 - c) + x * s,
    c + z * z * (1 - c),
  ];
}
