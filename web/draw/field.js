// Displacement of many points at once, on the GPU: u = Re Σ_k φ_k q_k for every point, into a texture that shaders read.

import * as THREE from "three";
import { GUST, still } from "./gust.js";
import { Pass } from "./pass.js";

export const WIDTH = 2048; // of both textures: every WebGL 2 has it

// φ is 16-bit steps, three texels (x, y, z) of real and imaginary part a bin, in the order of the file
const SHAPES = /* glsl */ `
precision highp isampler2D;
uniform isampler2D shapes;
ivec2 step3(int point, int k, int c) {
  int at = (point * BINS + k) * 3 + c;
  return texelFetch(shapes, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0).xy;
}`;
const SUM = /* glsl */ `
uniform highp sampler2D q; // by bin and copy, times metres a step: a forest of tall trees has too many for uniforms
uniform vec2 turn[COPIES]; // cosine and sine: the wind's direction against the one the motion was made for
vec3 motionOf(int point, int copy) {
  vec3 sum = vec3(0.0);
  for (int k = 0; k < BINS; k++) {
    vec2 now = texelFetch(q, ivec2(k, copy), 0).xy;
    for (int c = 0; c < 3; c++) {
      vec2 phi = vec2(step3(point, k, c));
      sum[c] += phi.x * now.x - phi.y * now.y;
    }
  }
  vec2 t = turn[copy];
  return vec3(t.x * sum.x - t.y * sum.y, t.y * sum.x + t.x * sum.y, sum.z);
}`;

const fragmentOf = (motion) => /* glsl */ `${SHAPES}
uniform int shown;         // the bin whose size goes to alpha; -1 for none
uniform float shownScale;
#ifdef HAS_PLACES
uniform highp sampler2D places; // by point: place at rest, and what a motion keeps there
vec4 placeOf(int point) { return texelFetch(places, ivec2(point % ${WIDTH}, point / ${WIDTH}), 0); }
#else
vec4 placeOf(int point) { return vec4(0.0); }
#endif
${GUST}
${motion}
void main() {
  int copy = int(gl_FragCoord.y) / ROWS;
  int point = (int(gl_FragCoord.y) - copy * ROWS) * ${WIDTH} + int(gl_FragCoord.x);
  if (point >= POINTS) discard;
  float size = 0.0;
  if (shown >= 0) {
    for (int c = 0; c < 3; c++) { vec2 phi = vec2(step3(point, shown, c)); size += dot(phi, phi); }
    size = sqrt(size) * shownScale;
  }
  gl_FragColor = vec4(gustAt(placeOf(point).xy) * motionOf(point, copy), size);
}`;

export class Field {
  /**
   * Shapes [P, K, 3, 2] in steps of `scale` [K] metres, or the texture of a field that has them. `places` is a texture of
   * the points at rest, without which a gust reaches all of them at once.
   */
  constructor(shapes, scale, P, copies = 1, { motion = SUM, uniforms = {}, places = null } = {}) {
    const K = scale.length;
    Object.assign(this, { K, scale, P, places });
    this.rows = Math.ceil(P / WIDTH); // of one copy
    this.borrowed = shapes.isTexture;
    this.shapes = this.borrowed ? shapes : shapesTexture(shapes, P * K * 3);
    this.q = coordinatesTexture(K, copies);
    this.turn = Array.from({ length: copies }, () => new THREE.Vector2(1, 0));
    this.pass = new Pass({
      width: WIDTH,
      height: copies * this.rows,
      fragmentShader: fragmentOf(motion),
      defines: { BINS: K, POINTS: P, COPIES: copies, ROWS: this.rows, ...(places && { HAS_PLACES: 1 }) },
      uniforms: {
        shapes: { value: this.shapes },
        q: { value: this.q },
        turn: { value: this.turn },
        shown: { value: -1 },
        shownScale: { value: 1 },
        places: { value: places },
        gust: { value: new THREE.Vector4() },
        gustCalm: { value: 1 },
        ...uniforms,
      },
    });
  }

  /** The same points several times, one below the other. */
  copied(copies) {
    return new Field(this.shapes, this.scale, this.P, copies);
  }

  get target() {
    return this.pass.target;
  }

  get texture() {
    return this.target.texture;
  }

  /** The share of bin k's largest swing is written to alpha; null for none. */
  show(k, largest = 1) {
    const { uniforms } = this.pass.material;
    uniforms.shown.value = k ?? -1;
    uniforms.shownScale.value = k === null ? 0 : this.scale[k] / largest;
  }

  /** See Gust.after. */
  blow({ gust, calm } = still()) {
    const { uniforms } = this.pass.material;
    uniforms.gust.value.set(...gust);
    uniforms.gustCalm.value = calm;
  }

  /** Coordinates [2K] and the wind's turn [rad] to displacements. */
  evaluate(renderer, q, angle = 0) {
    this.evaluateAll(renderer, [{ q, turn: angle }]);
  }

  /** The same of each copy. */
  evaluateAll(renderer, motions) {
    setCoordinates(this.q, this.scale, motions);
    motions.forEach(({ turn }, copy) => {
      this.turn[copy].set(Math.cos(turn), Math.sin(turn));
    });
    this.pass.render(renderer);
  }

  dispose() {
    if (!this.borrowed) this.shapes.dispose();
    this.q.dispose();
    this.places?.dispose();
    this.pass.dispose();
  }
}

/** Room for the coordinates of K bins of each copy. */
function coordinatesTexture(K, copies) {
  return new THREE.DataTexture(new Float32Array(2 * K * copies), K, copies, THREE.RGFormat, THREE.FloatType);
}

/** Coordinates of each copy, times what a step of the shapes is. */
function setCoordinates(texture, scale, motions) {
  motions.forEach(({ q }, copy) => {
    const row = texture.image.data.subarray(q.length * copy);
    for (let i = 0; i < q.length; i++) row[i] = q[i] * scale[i >> 1];
  });
  texture.needsUpdate = true;
}

export const voxelFieldOf = ({ shapes, scale_m: scale, V, centres }) =>
  Object.assign(new Field(shapes, scale, V, 1, { places: placesTexture(centres) }), { byVoxel: true });

/** Places [P, 3] as a texture; `fourth(row)` goes to alpha. */
export function placesTexture(places, fourth = (_row) => 0) {
  const P = places.length / 3;
  const texels = new Float32Array(4 * WIDTH * Math.ceil(P / WIDTH));
  for (let row = 0; row < P; row++) {
    texels.set(places.subarray(3 * row, 3 * row + 3), 4 * row);
    texels[4 * row + 3] = fourth(row);
  }
  const texture = new THREE.DataTexture(texels, WIDTH, texels.length / 4 / WIDTH, THREE.RGBAFormat, THREE.FloatType);
  texture.needsUpdate = true;
  return texture;
}

export function shapesTexture(shapes, texels) {
  const rows = Math.ceil(texels / WIDTH);
  const padded = new Int16Array(2 * WIDTH * rows);
  padded.set(shapes);
  const texture = new THREE.DataTexture(padded, WIDTH, rows, THREE.RGIntegerFormat, THREE.ShortType);
  texture.internalFormat = "RG16I";
  texture.needsUpdate = true;
  return texture;
}

// ---- what a vertex shader needs to stand where the field and the bones carry it

export const DISPLACE = /* glsl */ `
uniform highp sampler2D moved;    // by point: displacement, share of the shown mode
uniform highp sampler2D poses;    // three texels a bone: rows of [R | t]
uniform int bent;                 // 1 where something is pushed
#ifdef USE_INSTANCING
uniform int copyRows;             // texels below each other of one copy
vec4 movedAt(int point) { return texelFetch(moved, ivec2(point % ${WIDTH}, point / ${WIDTH} + gl_InstanceID * copyRows), 0); }
#else
vec4 movedAt(int point) { return texelFetch(moved, ivec2(point % ${WIDTH}, point / ${WIDTH}), 0); }
#endif
mat4 poseOf(int bone) {
  ivec2 at = ivec2(3 * (bone % 256), bone / 256);
  return transpose(mat4(texelFetch(poses, at, 0), texelFetch(poses, at + ivec2(1, 0), 0), texelFetch(poses, at + ivec2(2, 0), 0), vec4(0.0, 0.0, 0.0, 1.0)));
}`;

/** Poses of bones in a texture, 256 a row. */
export class PoseTexture {
  constructor(B) {
    this.rows = Math.ceil(B / 256);
    this.values = new Float32Array(256 * 12 * this.rows);
    this.texture = new THREE.DataTexture(this.values, 768, this.rows, THREE.RGBAFormat, THREE.FloatType);
    this.texture.needsUpdate = true;
  }

  set(poses) {
    this.values.set(poses);
    this.texture.needsUpdate = true;
  }

  dispose() {
    this.texture.dispose();
  }
}

/** Zero displacement, until there are modes. */
export function zeroTexture() {
  const texture = new THREE.DataTexture(new Float32Array(4), 1, 1, THREE.RGBAFormat, THREE.FloatType);
  texture.needsUpdate = true;
  return texture;
}
