// A tree's motion as numbers: the file of /v1/spectra/{id}/modes, evaluated as docs/interaction.md says.

import { readTensors } from "./tensors.js";

/**
 * Coordinates of the wind's own loop: the lean, and q_k = e^{2πik·phase}. Real and imaginary part of K bins. `gains` are
 * those of the mean speed (`bandGains`), `gust` is a factor on all.
 */
export function windCoordinates(K, phase, gains = null, gust = 1) {
  const q = new Float32Array(2 * K);
  for (let k = 0; k < K; k++) {
    const size = gust * (gains?.[k] ?? 1);
    q[2 * k] = size * Math.cos(2 * Math.PI * k * phase);
    q[2 * k + 1] = size * Math.sin(2 * Math.PI * k * phase);
  }
  return q;
}

/** Voxels, and the bones of what is pushed. */
export class Modes {
  constructor(buffer) {
    const { tensors, metadata } = readTensors(buffer);
    Object.assign(this, tensors);
    [this.V, this.K, this.B] = [this.coords.length / 3, this.scale_m.length, this.bone_parent.length];
    this.voxelSize = JSON.parse(metadata.voxel_size_m);
    this.origin = JSON.parse(metadata.origin_m);
    this.centres = Float32Array.from(this.coords, (step, i) => this.origin[i % 3] + (step + 0.5) * this.voxelSize);
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

  /** Bones from a voxel's own towards the root, without the root. */
  chain(voxel) {
    const rows = [];
    for (let b = this.bone_of_voxel[voxel]; this.bone_parent[b] >= 0; b = this.bone_parent[b]) rows.push(b);
    return rows;
  }

  /** Whether a bone is `above` or hangs on it. */
  isUnder(bone, above) {
    let b = bone;
    while (b > above) b = this.bone_parent[b]; // parents come before children
    return b === above;
  }

  /** Number of voxels that each bone carries, its own included. */
  carriedVoxels() {
    const count = new Float64Array(this.B);
    for (const b of this.bone_of_voxel) count[b] += 1;
    for (let b = this.B - 1; b > 0; b--) count[this.bone_parent[b]] += count[b]; // parents come before children
    return count;
  }

  /** A vector of the world in a bone's frame A_b, as of the last `poses`. */
  inFrame(b, v) {
    return [0, 1, 2].map((j) => [0, 1, 2].reduce((sum, i) => sum + this.frames[9 * b + 3 * i + j] * v[i], 0));
  }

  /** Bends κ of all bones, the sum over the groups. */
  _bends(groups) {
    const bends = new Float64Array(3 * this.B);
    for (const { seed, bend } of groups) {
      let b = this.bone_of_voxel[seed];
      for (const turn of bend ?? []) {
        for (let i = 0; i < 3; i++) bends[3 * b + i] += turn[i];
        b = this.bone_parent[b];
      }
    }
    return bends;
  }

  /**
   * The warp: 12 numbers a bone, rows of [R | t]; a point x goes to R x + t. Groups: `{ q: [[re, im]…], perBone }`, and
   * of local bends `{ seed, bend: [[x, y, z]…] }`, from the bone of voxel `seed` towards the root.
   */
  poses(groups, out = new Float32Array(12 * this.B)) {
    const moved = this._boneMoves(groups);
    const bends = this._bends(groups);
    this.frames ??= new Float64Array(9 * this.B);
    const { frames } = this;
    for (let b = 0; b < this.B; b++) {
      // parents come before children
      const root = this.bone_parent[b] < 0;
      const a = root ? b : this.bone_parent[b];
      const d = [0, 1, 2].map((c) => (moved[3 * b + c] - moved[3 * a + c]) / this.bone_lever_m2[b]);
      const r = this.bone_reach_m.subarray(3 * b, 3 * b + 3);
      const joint = this.bone_joint_m.subarray(3 * b, 3 * b + 3);
      const own = turned(r[1] * d[2] - r[2] * d[1], r[2] * d[0] - r[0] * d[2], r[0] * d[1] - r[1] * d[0]);
      const bend = turned(bends[3 * b], bends[3 * b + 1], bends[3 * b + 2]);
      const frame = root ? bend : product(frames.subarray(9 * a, 9 * a + 9), bend);
      frames.set(frame, 9 * b);
      const R = product(frame, own);
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
    for (const { q, perBone } of groups.filter(({ q }) => q))
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

function product(a, b) {
  const c = new Array(9);
  for (let i = 0; i < 3; i++)
    for (let j = 0; j < 3; j++) c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
  return c;
}

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
