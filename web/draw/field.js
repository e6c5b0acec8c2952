// Displacement of many points at once, on the GPU: u = Re Σ_k φ_k q_k for every point, into a texture that shaders read.

import * as THREE from "three";

const WIDTH = 2048; // of both textures: every WebGL 2 has it

const VERTEX = "void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }";

// φ is 16-bit steps, three texels (x, y, z) of real and imaginary part a bin, in the order of the file
const FRAGMENT = /* glsl */ `
precision highp isampler2D;
uniform isampler2D shapes;
uniform highp sampler2D q; // by bin and copy, times metres a step: a forest of tall trees has too many for uniforms
uniform vec2 turn[COPIES];     // cosine and sine: the wind's direction against the one the motion was made for
uniform int shown;         // the bin whose size goes to alpha; -1 for none
uniform float shownScale;
ivec2 step3(int point, int k, int c) {
  int at = (point * BINS + k) * 3 + c;
  return texelFetch(shapes, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0).xy;
}
void main() {
  int copy = int(gl_FragCoord.y) / ROWS;
  int point = (int(gl_FragCoord.y) - copy * ROWS) * ${WIDTH} + int(gl_FragCoord.x);
  if (point >= POINTS) discard;
  vec3 u = vec3(0.0);
  for (int k = 0; k < BINS; k++) for (int c = 0; c < 3; c++) {
    vec2 phi = vec2(step3(point, k, c));
    vec2 now = texelFetch(q, ivec2(k, copy), 0).xy;
    u[c] += phi.x * now.x - phi.y * now.y;
  }
  float size = 0.0;
  if (shown >= 0) {
    for (int c = 0; c < 3; c++) { vec2 phi = vec2(step3(point, shown, c)); size += dot(phi, phi); }
    size = sqrt(size) * shownScale;
  }
  vec2 t = turn[copy];
  gl_FragColor = vec4(t.x * u.x - t.y * u.y, t.y * u.x + t.x * u.y, u.z, size);
}`;

export class Field {
  /** Shapes [P, K, 3, 2] in steps of `scale` [K] metres, or the texture of a field that has them. */
  constructor(shapes, scale, P, copies = 1) {
    const K = scale.length;
    Object.assign(this, { K, scale, P });
    this.rows = Math.ceil(P / WIDTH); // of one copy
    this.borrowed = shapes.isTexture;
    this.shapes = this.borrowed ? shapes : shapesTexture(shapes, P * K * 3);
    this.target = new THREE.WebGLRenderTarget(WIDTH, copies * this.rows, {
      type: THREE.FloatType,
      minFilter: THREE.NearestFilter,
      magFilter: THREE.NearestFilter,
      depthBuffer: false,
      generateMipmaps: false,
    });
    this.q = new THREE.DataTexture(new Float32Array(2 * K * copies), K, copies, THREE.RGFormat, THREE.FloatType);
    this.turn = Array.from({ length: copies }, () => new THREE.Vector2(1, 0));
    this.material = new THREE.ShaderMaterial({
      defines: { BINS: K, POINTS: P, COPIES: copies, ROWS: this.rows },
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: {
        shapes: { value: this.shapes },
        q: { value: this.q },
        turn: { value: this.turn },
        shown: { value: -1 },
        shownScale: { value: 1 },
      },
      blending: THREE.NoBlending,
      depthTest: false,
      depthWrite: false,
      toneMapped: false,
    });
    this.scene = new THREE.Scene();
    this.scene.add(new THREE.Mesh(new THREE.PlaneGeometry(2, 2), this.material));
    this.scene.children[0].frustumCulled = false;
    this.camera = new THREE.Camera();
  }

  /** The same points several times, one below the other. */
  copied(copies) {
    return new Field(this.shapes, this.scale, this.P, copies);
  }

  get texture() {
    return this.target.texture;
  }

  /** The share of bin k's largest swing is written to alpha; null for none. */
  show(k, largest = 1) {
    this.material.uniforms.shown.value = k ?? -1;
    this.material.uniforms.shownScale.value = k === null ? 0 : this.scale[k] / largest;
  }

  /** Coordinates [2K] and the wind's turn [rad] to displacements. */
  evaluate(renderer, q, angle = 0) {
    this.evaluateAll(renderer, [{ q, turn: angle }]);
  }

  /** The same of each copy. */
  evaluateAll(renderer, motions) {
    const { K, scale } = this;
    motions.forEach(({ q, turn }, copy) => {
      const row = this.q.image.data.subarray(2 * K * copy);
      for (let i = 0; i < 2 * K; i++) row[i] = q[i] * scale[i >> 1];
      this.turn[copy].set(Math.cos(turn), Math.sin(turn));
    });
    this.q.needsUpdate = true;
    const before = renderer.getRenderTarget();
    renderer.setRenderTarget(this.target);
    renderer.render(this.scene, this.camera);
    renderer.setRenderTarget(before);
  }

  dispose() {
    if (!this.borrowed) this.shapes.dispose();
    this.q.dispose();
    this.target.dispose();
    this.material.dispose();
    this.scene.children[0].geometry.dispose();
  }
}

/** The field of another motion of the same tree, of the contents of its surface file, or of its Modes where the mesh is large. */
export function fieldOf({ shapes, scale_m: scale, vertices }, modes) {
  return shapes ? new Field(shapes, scale, vertices.length / 3) : voxelFieldOf(modes);
}

export const voxelFieldOf = ({ shapes, scale_m: scale, V }) =>
  Object.assign(new Field(shapes, scale, V), { byVoxel: true });

function shapesTexture(shapes, texels) {
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
