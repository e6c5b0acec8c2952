// Displacement of many points at once, on the GPU: u = Re Σ_k φ_k q_k for every point, into a texture that shaders read.

import * as THREE from "three";

const WIDTH = 2048; // of both textures: every WebGL 2 has it

const VERTEX = "void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }";

// φ is 16-bit steps, three texels (x, y, z) of real and imaginary part a bin, in the order of the file
const FRAGMENT = /* glsl */ `
precision highp isampler2D;
uniform isampler2D shapes;
uniform vec2 q[BINS];      // times metres a step
uniform vec2 turn;         // cosine and sine: the wind's direction against the one the motion was made for
uniform int shown;         // the bin whose size goes to alpha; -1 for none
uniform float shownScale;
ivec2 step3(int point, int k, int c) {
  int at = (point * BINS + k) * 3 + c;
  return texelFetch(shapes, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0).xy;
}
void main() {
  int point = int(gl_FragCoord.y) * ${WIDTH} + int(gl_FragCoord.x);
  if (point >= POINTS) discard;
  vec3 u = vec3(0.0);
  for (int k = 0; k < BINS; k++) for (int c = 0; c < 3; c++) {
    vec2 phi = vec2(step3(point, k, c));
    u[c] += phi.x * q[k].x - phi.y * q[k].y;
  }
  float size = 0.0;
  if (shown >= 0) {
    for (int c = 0; c < 3; c++) { vec2 phi = vec2(step3(point, shown, c)); size += dot(phi, phi); }
    size = sqrt(size) * shownScale;
  }
  gl_FragColor = vec4(turn.x * u.x - turn.y * u.y, turn.y * u.x + turn.x * u.y, u.z, size);
}`;

export class Field {
  /** Shapes [P, K, 3, 2] in steps of `scale` [K] metres. */
  constructor(shapes, scale, P) {
    const K = scale.length;
    this.K = K;
    this.scale = scale;
    const rows = Math.ceil((P * K * 3) / WIDTH);
    const padded = new Int16Array(2 * WIDTH * rows);
    padded.set(shapes);
    this.shapes = new THREE.DataTexture(padded, WIDTH, rows, THREE.RGIntegerFormat, THREE.ShortType);
    this.shapes.internalFormat = "RG16I";
    this.shapes.needsUpdate = true;
    this.target = new THREE.WebGLRenderTarget(WIDTH, Math.ceil(P / WIDTH), {
      type: THREE.FloatType,
      minFilter: THREE.NearestFilter,
      magFilter: THREE.NearestFilter,
      depthBuffer: false,
      generateMipmaps: false,
    });
    this.q = Array.from({ length: K }, () => new THREE.Vector2());
    this.material = new THREE.ShaderMaterial({
      defines: { BINS: K, POINTS: P },
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: {
        shapes: { value: this.shapes },
        q: { value: this.q },
        turn: { value: new THREE.Vector2(1, 0) },
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
    for (let k = 0; k < this.K; k++) this.q[k].set(q[2 * k] * this.scale[k], q[2 * k + 1] * this.scale[k]);
    this.material.uniforms.turn.value.set(Math.cos(angle), Math.sin(angle));
    const before = renderer.getRenderTarget();
    renderer.setRenderTarget(this.target);
    renderer.render(this.scene, this.camera);
    renderer.setRenderTarget(before);
  }

  dispose() {
    this.shapes.dispose();
    this.target.dispose();
    this.material.dispose();
    this.scene.children[0].geometry.dispose();
  }
}

// ---- what a vertex shader needs to stand where the field and the bones carry it

export const DISPLACE = /* glsl */ `
uniform highp sampler2D moved;    // by point: displacement, share of the shown mode
uniform highp sampler2D poses;    // three texels a bone: rows of [R | t]
uniform float bent;               // 1 where something is pushed
vec4 movedAt(int point) { return texelFetch(moved, ivec2(point % ${WIDTH}, point / ${WIDTH}), 0); }
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
