// Evaluate a tree's modes yourself: the reference for clients, in JavaScript (browser or node), without dependencies.

const OUTWARD = 32;

export class Modes {
  constructor(buffer) { // the body of GET /v1/spectra/{id}/modes, an ArrayBuffer
    const size = Number(new DataView(buffer).getBigUint64(0, true));
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, size)));
    const kinds = { I16: Int16Array, I32: Int32Array, F32: Float32Array };
    for (const [name, entry] of Object.entries(header)) {
      if (name !== "__metadata__") this[name] = new kinds[entry.dtype](buffer.slice(...entry.data_offsets.map((o) => 8 + size + o)));
    }
  }

  // Plain superposition, [V × 3]: q and weights are one array a group, q [K × 2], weights [V] in [0, 1].
  voxels(q, weights) { return superposed(this.shapes, this.scale_m, q, weights); }

  // How the bones take part in a group of this locality: weights [B]; ends [B] of those that carry the place; hangs [B], those beyond.
  reach(seedVoxel, falloff_m) {
    const [parent, foot] = [this.bone_parent, this.bone_foot_m], B = parent.length, cost = new Float64Array(B).fill(Infinity), ends = [], hangs = [];
    const seed = this.bone_of_voxel[seedVoxel];
    ends[seed] = plus(at(foot, seed), at(this.bone_reach_m, seed));
    for (let b = seed, way = 0; b >= 0; b = parent[b]) {
      cost[b] = way;
      way += (b === seed ? 0.5 : 1) * Math.hypot(...minus(ends[b], at(foot, b)));
      if (parent[b] >= 0) ends[parent[b]] = at(foot, b);
    }
    for (let b = 1; b < B; b++) { // parents come before children
      const a = parent[b];
      if (ends[b]) continue;
      hangs[b] = a === seed || Boolean(hangs[a]);
      cost[b] = hangs[b] ? cost[a] : a > 0 ? cost[a] + OUTWARD * Math.hypot(...at(this.bone_reach_m, b)) : Infinity;
    }
    return { weights: cost.map((c) => Math.exp(-((c / falloff_m) ** 2))), ends, hangs };
  }

  // How far each bone turns [B × 3]: q and reaches are one a group; a group without a reach (null) moves the whole tree.
  theta(q, reaches) {
    const [parent, foot] = [this.bone_parent, this.bone_foot_m], B = parent.length, total = new Float64Array(3 * B);
    q.forEach((qg, g) => {
      const own = superposed(this.bone_turns, this.bone_scale_rad, [qg], [new Float64Array(B).fill(1)]), turn = Float64Array.from(own), shift = new Float64Array(3 * B);
      for (let b = 1; b < B && reaches[g]; b++) {
        const { weights: w, ends, hangs } = reaches[g], a = parent[b];
        shift.set(plus(at(shift, a), cross(at(own, a), minus(at(foot, b), at(foot, a)))), 3 * b);
        if (ends[b]) {
          const arm = minus(ends[b], at(foot, b)), gain = (w[b] - w[a]) / Math.max(arm[0] ** 2 + arm[1] ** 2 + arm[2] ** 2, 1e-12);
          turn.set(plus(at(own, b).map((x) => w[b] * x), cross(arm, at(shift, b)).map((x) => gain * x)), 3 * b);
        } else if (!hangs[b]) turn.set(plus(at(turn, a), minus(at(own, b), at(own, a)).map((x) => w[b] * x)), 3 * b);
      }
      for (let i = 3; i < 3 * B; i++) total[i] += turn[i];
    });
    return total;
  }

  // A group's bend [[x, y, z] …], given from its place's joint towards the root, for all joints [J × 3].
  bends(seedVoxel, bend) {
    const every = new Float64Array(3 * this.joint_parent.length);
    let j = this.joint_of_bone[this.bone_of_voxel[seedVoxel]];
    for (const turn of bend) { every.set(turn, 3 * j); j = this.joint_parent[j]; }
    return every;
  }

  // { rotation [B × 9], place [B × 3] }; a point x of bone b goes to R (x - foot) + place. bends [J × 3] is the sum of
  // the groups' bends: each turns its joint and everything beyond it.
  poses(theta, bends) {
    const [parent, foot, above, joint] = [this.bone_parent, this.bone_foot_m, this.joint_parent, this.joint_place_m];
    const rotation = new Float64Array(3 * foot.length), place = Float64Array.from(foot), frame = [IDENTITY], there = [at(joint, 0)];
    for (let j = 1; j < above.length; j++) {
      there[j] = plus(there[above[j]], times(frame[above[j]], minus(at(joint, j), at(joint, above[j]))));
      frame[j] = product(frame[above[j]], turned(at(bends, j)));
    }
    for (let b = 0; b < parent.length; b++) { // parents come before children
      const t = at(theta, b), size = Math.max(Math.hypot(...t), 1e-12), a = parent[b];
      rotation.set(turned(t.map((x) => (x * Math.atan(size)) / size)), 9 * b);
      if (a >= 0) place.set(plus(at(place, a), times(rotation.subarray(9 * a, 9 * a + 9), minus(at(foot, b), at(foot, a)))), 3 * b);
    }
    for (let b = 0; b < parent.length; b++) {
      const j = this.joint_of_bone[b];
      place.set(plus(there[j], times(frame[j], minus(at(place, b), at(joint, j)))), 3 * b);
      rotation.set(product(frame[j], rotation.subarray(9 * b, 9 * b + 9)), 9 * b);
    }
    return { rotation, place };
  }
}

function superposed(shapes, scale, q, weights) { // Σ_g w_g Re Σ_k φ_k q_{g,k}
  const K = scale.length, u = new Float64Array(shapes.length / (2 * K));
  q.forEach((qg, g) => {
    for (let n = 0; n < u.length / 3; n++) for (let k = 1; k < K; k++) for (let c = 0; c < 3; c++) {
      const i = 2 * ((n * K + k) * 3 + c);
      u[3 * n + c] += weights[g][n] * scale[k] * (shapes[i] * qg[2 * k] - shapes[i + 1] * qg[2 * k + 1]);
    }
  });
  return u;
}

const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];
const at = (values, n) => [values[3 * n], values[3 * n + 1], values[3 * n + 2]];
const plus = (a, b) => a.map((x, i) => x + b[i]);
const minus = (a, b) => a.map((x, i) => x - b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const times = (m, v) => [0, 1, 2].map((i) => m[3 * i] * v[0] + m[3 * i + 1] * v[1] + m[3 * i + 2] * v[2]);

const product = (a, b) => Array.from(IDENTITY, (_, n) => {
  const [i, j] = [3 * Math.floor(n / 3), n % 3];
  return a[i] * b[j] + a[i + 1] * b[3 + j] + a[i + 2] * b[6 + j];
});

function turned([x, y, z]) { // Rodrigues
  const angle = Math.max(Math.hypot(x, y, z), 1e-12), [c, s] = [Math.cos(angle), Math.sin(angle)];
  [x, y, z] = [x / angle, y / angle, z / angle];
  return [c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s, y * x * (1 - c) + z * s, c + y * y * (1 - c),
    y * z * (1 - c) - x * s, z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)];
}
