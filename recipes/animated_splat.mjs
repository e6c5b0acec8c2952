// Play a *.animated-splat.safetensors in any engine, without dependencies: docs/formats-splat.md has the equations.

const KINDS = { F32: Float32Array, I32: Int32Array, F16: Uint16Array, U8: Uint8Array };
const [FLAP_RAD, TWIST_RAD] = [0.22, 0.35]; // of a leaf in a strong wind

export class AnimatedSplat {
  /** `buffer` is the file's ArrayBuffer. Its G Gaussians are in metres, +Z up. */
  constructor(buffer) {
    const size = Number(new DataView(buffer).getBigUint64(0, true));
    const { __metadata__: metadata, ...entries } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, size)));
    for (const [name, { dtype, data_offsets }] of Object.entries(entries)) {
      const stored = new KINDS[dtype](buffer.slice(...data_offsets.map((offset) => 8 + size + offset)));
      this[name] = dtype === "F16" ? Float32Array.from(stored, half) : stored;
    }
    this.count = this.face_of.length;
    this.bins = entries.coefficients.shape[1];
    this.numFrames = Number(metadata.num_frames);
    this.seconds = this.numFrames / Number(metadata.fps); // of the loop
    this.degreeSize = entries.sh.shape[1];
    this.rest = this.means.slice();
    this.leaves = Array.from(this.leaf_vertex ?? [], () => []); // the Gaussians of each
    this.leaf_of?.forEach((leaf, g) => leaf >= 0 && this.leaves[leaf].push(g));
    this._hang();
  }

  /** Colour of a Gaussian seen from anywhere, red, green, blue in display space: harmonics of degree 0. */
  colour(g) {
    return [0, 1, 2].map((c) => Math.max(0, 0.5 + 0.28209479 * this.sh[3 * this.degreeSize * g + c]));
  }

  /** The box of all Gaussians at rest: its middle, and half its size. */
  get box() {
    const [low, high] = [Array(3).fill(Infinity), Array(3).fill(-Infinity)];
    this.rest.forEach((x, i) => {
      low[i % 3] = Math.min(low[i % 3], x);
      high[i % 3] = Math.max(high[i % 3], x);
    });
    return { middle: low.map((x, c) => (x + high[c]) / 2), half: low.map((x, c) => (high[c] - x) / 2) };
  }

  /** Gaussians at a phase of the loop in [0, 1): `means` [3G], `quaternions` w, x, y, z [4G], `scales` [3G]; used again. */
  at(phase) {
    this._displace(phase);
    const { triangles, places, turns, stretches, quats, frames, weights, arms, axes, means, turned, scales, sizes } = this;
    for (let f = 0; f < triangles.length / 3; f++) this._turn(f);
    for (let g = 0; g < this.count; g++) {
      const f = this.face_of[g];
      if (f < 0) continue; // it stays still
      for (let i = 0; i < 3; i++) {
        let [at, size] = [0, 0];
        for (let j = 0; j < 3; j++) {
          at += weights[3 * g + j] * places[3 * triangles[3 * f + j] + i] + turns[9 * f + 3 * i + j] * arms[3 * g + j];
          const row = 9 * f + 3 * j;
          const x = stretches[row] * axes[9 * g + 3 * i] + stretches[row + 1] * axes[9 * g + 3 * i + 1];
          size += (x + stretches[row + 2] * axes[9 * g + 3 * i + 2]) ** 2;
        }
        means[3 * g + i] = at;
        sizes[3 * g + i] = scales[3 * g + i] * Math.min(Math.max(Math.sqrt(size), 0.25), 4);
      }
      const [w, x, y, z] = [quats[4 * f], quats[4 * f + 1], quats[4 * f + 2], quats[4 * f + 3]];
      const [a, b, c, d] = [frames[4 * g], frames[4 * g + 1], frames[4 * g + 2], frames[4 * g + 3]];
      turned[4 * g] = w * a - x * b - y * c - z * d;
      turned[4 * g + 1] = w * b + x * a + y * d - z * c;
      turned[4 * g + 2] = w * c - x * d + y * a + z * b;
      turned[4 * g + 3] = w * d + x * c - y * b + z * a;
    }
    this.leaf_vertex?.forEach((_, leaf) => this._flutter(leaf, phase));
    return { means, quaternions: turned, scales: sizes };
  }

  /** A leaf's Gaussians turn about a vertex, by the sum of its tones and the angle atan |θ|. */
  _flutter(leaf, phase) {
    const { means, turned, leaf_size: sizes, flutter_tones: tones } = this;
    const wave = (at, row) => tones[at] && Math.cos(2 * Math.PI * (tones[at] * phase + tones[at + row] / 256));
    const [flap, twist] = [1, 2].map((row) => [0, 3, 6, 9].reduce((sum, tone) => sum + wave(12 * leaf + tone, row), 0));
    const axis = (of) => of.subarray(3 * leaf, 3 * leaf + 3);
    const [a, d] = [axis(this.flutter_axis), axis(this.turn_direction)];
    const theta = [0, 1, 2].map((i) => Math.SQRT1_2 * sizes[leaf] * (FLAP_RAD * flap * a[i] + TWIST_RAD * twist * d[i]));
    const c = 1 / Math.sqrt(1 + dot(theta, theta));
    const [w, s] = [Math.sqrt((1 + c) / 2), c / Math.sqrt(2 + 2 * c)];
    const [x, y, z] = theta.map((part) => s * part);
    const m = matrix([w, x, y, z]);
    const foot = this.places.subarray(3 * this.leaf_vertex[leaf], 3 * this.leaf_vertex[leaf] + 3);
    for (const g of this.leaves[leaf]) {
      const arm = [0, 1, 2].map((i) => means[3 * g + i] - foot[i]);
      for (let i = 0; i < 3; i++) means[3 * g + i] = foot[i] + dot(m.slice(3 * i, 3 * i + 3), arm);
      const [e, f, h, k] = turned.subarray(4 * g, 4 * g + 4);
      const product = [w * e - x * f - y * h - z * k, w * f + x * e + y * k - z * h];
      turned.set([...product, w * h - x * k + y * e + z * f, w * k + x * h - y * f + z * e], 4 * g);
    }
  }

  /** What does not change: frames of the faces at rest, and where each Gaussian is from its place on its face. */
  _hang() {
    const { count, vertices, quaternions, weights } = this;
    const numFaces = this.triangles.length / 3;
    this.places = vertices.slice();
    this.sizes = this.scales.slice();
    this.flat = Array.from({ length: numFaces }, (_, f) => frameOf(this.places, this.triangles, f));
    [this.turns, this.stretches, this.quats] = [9, 9, 4].map((width) => new Float64Array(width * numFaces));
    [this.arms, this.axes] = [new Float32Array(3 * count), new Float32Array(9 * count)];
    for (let g = 0; g < count; g++) {
      const own = quaternions.subarray(4 * g, 4 * g + 4);
      own.set(own.map((x) => x / Math.hypot(...own)));
      const m = matrix(own);
      this.axes.set([m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]], 9 * g); // its columns
      const f = this.face_of[g];
      const corner = (j, i) => vertices[3 * this.triangles[3 * f + j] + i];
      const on = (i) => [0, 1, 2].reduce((sum, j) => sum + weights[3 * g + j] * corner(j, i), 0);
      if (f >= 0) for (let i = 0; i < 3; i++) this.arms[3 * g + i] = this.rest[3 * g + i] - on(i);
    }
    [this.frames, this.turned] = [quaternions, quaternions.slice()];
  }

  _displace(phase) {
    const { bins, numFrames, coefficients, vertices, places } = this;
    const waves = new Float64Array(2 * bins);
    for (let k = 0; k < bins; k++) {
      const weight = k === 0 || k === numFrames / 2 ? 1 : 2;
      waves[2 * k] = weight * Math.cos(2 * Math.PI * k * phase);
      waves[2 * k + 1] = weight * Math.sin(2 * Math.PI * k * phase);
    }
    for (let v = 0; v < vertices.length; v += 3) {
      for (let c = 0; c < 3; c++) {
        let moved = 0;
        for (let k = 0, at = 2 * (v * bins + c); k < bins; k++, at += 6)
          moved += coefficients[at] * waves[2 * k] - coefficients[at + 1] * waves[2 * k + 1];
        places[v + c] = vertices[v + c] + moved;
      }
    }
  }

  /** How a face has turned and stretched: F = R S in the plane of its corners, its normal as it was. */
  _turn(f) {
    const [before, now] = [this.flat[f], frameOf(this.places, this.triangles, f)];
    const [one, high] = [now.length / before.length, now.y / before.y];
    const shear = (now.x - one * before.x) / before.y;
    const size = Math.hypot(one + high, shear); // of the plane's own rotation: corner 1 stays on the first axis
    const [c, s] = size > 1e-6 ? [(one + high) / size, -shear / size] : [1, 0];
    between(now, [c, -s, s, c], before, this.turns, 9 * f);
    between(now, [one, shear, 0, high], before, this.stretches, 9 * f);
    this.quats.set(quaternion(...this.turns.subarray(9 * f, 9 * f + 9)), 4 * f);
  }
}

/** Edge 0 to 1, the normal to it in the plane, the face's normal; and corner 2 in them. */
function frameOf(places, triangles, f) {
  const [a, b, c] = [3 * triangles[3 * f], 3 * triangles[3 * f + 1], 3 * triangles[3 * f + 2]];
  const edge = [places[b] - places[a], places[b + 1] - places[a + 1], places[b + 2] - places[a + 2]];
  const other = [places[c] - places[a], places[c + 1] - places[a + 1], places[c + 2] - places[a + 2]];
  const length = Math.hypot(edge[0], edge[1], edge[2]);
  const e = [edge[0] / length, edge[1] / length, edge[2] / length];
  const n = cross(e, other);
  const area = Math.hypot(n[0], n[1], n[2]) || 1e-30;
  const normal = [n[0] / area, n[1] / area, n[2] / area];
  const across = cross(normal, e);
  return { axes: [e, across, normal], length, x: dot(e, other), y: dot(across, other) };
}

/** Rows of B M Aᵀ to `rows`: axes are the columns of B and A, M is [p q; r s] in the plane and leaves the normal. */
function between({ axes: [e, a, n] }, [p, q, r, s], { axes: [before, across, normal] }, rows, at) {
  for (let i = 0; i < 3; i++) {
    const [first, second] = [e[i] * p + a[i] * r, e[i] * q + a[i] * s];
    for (let j = 0; j < 3; j++) rows[at + 3 * i + j] = first * before[j] + second * across[j] + n[i] * normal[j];
  }
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

function matrix([w, x, y, z]) {
  const second = [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)];
  return [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), ...second, 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
}

/** Of a rotation's rows: w, x, y, z, divided by the largest of them. */
function quaternion(a, b, c, d, e, f, g, h, i) {
  const choices = [
    [1 + a + e + i, h - f, c - g, d - b],
    [h - f, 1 + a - e - i, b + d, c + g],
    [c - g, b + d, 1 - a + e - i, f + h],
    [d - b, c + g, f + h, 1 - a - e + i],
  ];
  const best = choices.reduce((most, row, n) => (row[n] > choices[most][most] ? n : most), 0);
  const size = Math.hypot(...choices[best]);
  return choices[best].map((x) => x / size);
}

/** IEEE 754 half precision to a number. */
function half(bits) {
  const [sign, exponent, fraction] = [bits & 0x8000 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -24 * fraction);
}
