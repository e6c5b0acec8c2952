// Evaluate a tree's modes yourself: the reference for clients, in JavaScript (browser or node), without dependencies.

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
  voxels(q, weights) { return this.superposed(this.shapes, q, weights); }

  // A group's bend [[x, y, z] …], given from its grip's bone towards the root, for all bones [B × 3].
  bends(seedVoxel, bend) {
    const every = new Float64Array(3 * this.bone_parent.length);
    let b = this.bone_of_voxel[seedVoxel];
    for (const turn of bend) { every.set(turn, 3 * b); b = this.bone_parent[b]; }
    return every;
  }

  // The warp: { rotation [B × 9], place [B × 3] }; a point x of bone b goes to R (x - joint) + place.
  // bends [B × 3] is the sum of the groups' bends: each turns its bone and everything beyond it.
  poses(q, weights, bends = new Float64Array(3 * this.bone_parent.length)) {
    const [parent, joint, reach] = [this.bone_parent, this.bone_joint_m, this.bone_reach_m], B = parent.length;
    const count = new Float64Array(B), perBone = weights.map(() => new Float64Array(B));
    this.bone_of_voxel.forEach((b, v) => { count[b] += 1; weights.forEach((w, g) => { perBone[g][b] += w[v]; }); });
    perBone.forEach((w) => w.forEach((_, b) => { w[b] /= count[b]; }));
    const moved = this.superposed(this.bone_shapes, q, perBone), rotation = new Float64Array(9 * B), place = new Float64Array(3 * B), frame = new Float64Array(9 * B);
    for (let b = 0; b < B; b++) { // parents come before children
      const a = parent[b] < 0 ? b : parent[b], r = reach.subarray(3 * b, 3 * b + 3);
      const d = [0, 1, 2].map((c) => (moved[3 * b + c] - moved[3 * a + c]) / this.bone_lever_m2[b]);
      const bend = turned(...bends.subarray(3 * b, 3 * b + 3));
      frame.set(parent[b] < 0 ? bend : product(frame.subarray(9 * a, 9 * a + 9), bend), 9 * b);
      const turn = turned(r[1] * d[2] - r[2] * d[1], r[2] * d[0] - r[0] * d[2], r[0] * d[1] - r[1] * d[0]);
      rotation.set(product(frame.subarray(9 * b, 9 * b + 9), turn), 9 * b);
      for (let i = 0; i < 3; i++) {
        const along = [0, 1, 2].map((j) => rotation[9 * a + 3 * i + j] * (joint[3 * b + j] - joint[3 * a + j]));
        place[3 * b + i] = parent[b] < 0 ? joint[3 * b + i] : place[3 * a + i] + along[0] + along[1] + along[2];
      }
    }
    return { rotation, place };
  }

  superposed(shapes, q, weights) { // Σ_g w_g Re Σ_k φ_k q_{g,k}
    const K = this.scale_m.length, u = new Float64Array(shapes.length / (2 * K));
    q.forEach((qg, g) => {
      for (let n = 0; n < u.length / 3; n++) for (let k = 1; k < K; k++) for (let c = 0; c < 3; c++) {
        const at = 2 * ((n * K + k) * 3 + c);
        u[3 * n + c] += weights[g][n] * this.scale_m[k] * (shapes[at] * qg[2 * k] - shapes[at + 1] * qg[2 * k + 1]);
      }
    });
    return u;
  }
}

const product = (a, b) => Array.from(a, (_, n) => {
  const [i, j] = [3 * Math.floor(n / 3), n % 3];
  return a[i] * b[j] + a[i + 1] * b[3 + j] + a[i + 2] * b[6 + j];
});

function turned(x, y, z) { // Rodrigues
  const angle = Math.max(Math.hypot(x, y, z), 1e-12), [c, s] = [Math.cos(angle), Math.sin(angle)];
  [x, y, z] = [x / angle, y / angle, z / angle];
  return [c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s, y * x * (1 - c) + z * s, c + y * y * (1 - c),
    y * z * (1 - c) - x * s, z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)];
}
