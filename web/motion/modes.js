// A tree's motion as numbers: the file of /v1/spectra/{id}/modes, evaluated as docs/interaction.md says.

import { readTensors } from "./tensors.js";
import { dot, length, rowOf, scaled } from "./vectors.js";

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

/** Voxels, and the joints of what is pulled. */
export class Modes {
  constructor(buffer) {
    const { tensors, metadata } = readTensors(buffer);
    Object.assign(this, tensors);
    [this.V, this.K, this.J] = [this.coords.length / 3, this.frequencies_hz.length, this.joint_parent.length];
    this.voxelSize = JSON.parse(metadata.voxel_size_m);
    this.origin = JSON.parse(metadata.origin_m);
    this.centres = Float32Array.from(this.coords, (step, i) => this.origin[i % 3] + (step + 0.5) * this.voxelSize);
    this.joint_of_voxel = this.bone_of_voxel.map((b) => this.joint_of_bone[b]);
  }

  jointAt(j) {
    return rowOf(this.joint_place_m, j);
  }

  /** Joints from a voxel's own towards the root, without the ground. */
  chain(voxel) {
    const rows = [];
    for (let j = this.joint_of_voxel[voxel]; this.joint_parent[j] >= 0; j = this.joint_parent[j]) rows.push(j);
    return rows;
  }

  /** Bends κ of all joints [J, 3], the sum over the groups `{ seed, bend: [[x, y, z]…] }`, from the joint of voxel `seed` on. */
  bends(groups) {
    const bends = new Float64Array(3 * this.J);
    for (const { seed, bend } of groups) {
      let j = this.joint_of_voxel[seed];
      for (const turn of bend) {
        for (let i = 0; i < 3; i++) bends[3 * j + i] += turn[i];
        j = this.joint_parent[j];
      }
    }
    return bends;
  }

  /** Of each joint 12 numbers, rows of [R | t]: a point x that the joint carries goes to R x + t. */
  poses(groups, out = new Float32Array(12 * this.J)) {
    const bends = this.bends(groups);
    for (let j = 0; j < this.J; j++) {
      // parents come before children
      const above = this.joint_parent[j];
      const bend = rowOf(bends, j);
      if (above < 0) out.set(STILL, 12 * j);
      else if (dot(bend, bend) === 0) out.copyWithin(12 * j, 12 * above, 12 * above + 12);
      else {
        const joint = this.jointAt(j);
        const place = carried(out, above, joint);
        const rotation = turned(bend);
        for (let i = 0; i < 3; i++) {
          const at = 12 * above + 4 * i;
          const row = [0, 1, 2].map((c) =>
            dot(
              out.subarray(at, at + 3),
              [0, 1, 2].map((n) => rotation[n][c]),
            ),
          );
          out.set([...row, place[i] - dot(row, joint)], 12 * j + 4 * i);
        }
      }
    }
    return out;
  }
}

const STILL = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];

/** A point under one joint's pose. */
export const carried = (poses, j, x) => [0, 1, 2].map((i) => row(poses, j, i, x));

const row = (poses, j, i, x) => {
  const at = 12 * j + 4 * i;
  return poses[at] * x[0] + poses[at + 1] * x[1] + poses[at + 2] * x[2] + poses[at + 3];
};

/** exp[v]×, three rows: Rodrigues. */
export function turned(v) {
  const angle = Math.max(length(v), 1e-12);
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const [x, y, z] = scaled(v, 1 / angle);
  return [
    [c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s],
    [y * x * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s],
    [z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)],
  ];
}
