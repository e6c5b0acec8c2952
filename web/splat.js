// A cloud of Gaussians that hangs on a mesh, drawn by Spark: the rules of docs/formats-splat.md in Spark's own shader.
// Of the harmonics only the first is drawn.

import * as THREE from "three";
import { Field } from "./field.js";
import { readTensors } from "./modes.js";

const Y0 = 0.28209479177387814; // the first harmonic
const WIDTH = 2048; // of the textures below

/** The body of a `.animated-splat.safetensors`. */
export function readSplat(buffer) {
  const { tensors, shape, metadata } = readTensors(buffer);
  return { ...tensors, G: shape.means[0], N: shape.vertices[0], K: shape.coefficients[1], harmonics: shape.sh[1], frames: Number(metadata.num_frames) };
}

export class SplatView {
  /** `poses` and `bent` are the tree's uniforms, `carriers` four bones and weights of each vertex. */
  static async make(stage, splat, carriers, uniforms) {
    const spark = await import("spark");
    const view = new SplatView();
    view.stage = stage;
    view.field = fieldOf(splat);
    view.uniforms = uniforms;
    view.textures = texturesOf(splat, carriers);
    const packed = new spark.PackedSplats({ maxSplats: splat.G });
    const [at, scales, turn, colour] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Quaternion(), new THREE.Color()];
    for (let g = 0; g < splat.G; g++) {
      at.fromArray(splat.means, 3 * g);
      scales.fromArray(splat.scales, 3 * g);
      turn.set(splat.quaternions[4 * g + 1], splat.quaternions[4 * g + 2], splat.quaternions[4 * g + 3], splat.quaternions[4 * g]).normalize();
      colour.setRGB(...[0, 1, 2].map((c) => Math.min(Math.max(0.5 + Y0 * splat.sh[3 * g * splat.harmonics + c], 0), 1)));
      packed.pushSplat(at, scales, turn, splat.opacity[g], colour);
    }
    view.renderer = stage.sparkRenderer ??= new spark.SparkRenderer({ renderer: stage.renderer });
    stage.scene.add(view.renderer);
    view.values = view._values(spark.dyno);
    view.mesh = new spark.SplatMesh({ packedSplats: packed, objectModifier: modifier(spark.dyno, view.values) });
    stage.scene.add(view.mesh);
    await view.mesh.initialized;
    return view;
  }

  _values({ dynoSampler2D, dynoFloat }) {
    return {
      moved: dynoSampler2D(this.field.texture), poses: dynoSampler2D(this.uniforms.poses.value), bent: dynoFloat(0),
      corners: dynoSampler2D(this.textures.corners), rest: dynoSampler2D(this.textures.rest), bones: dynoSampler2D(this.textures.bones),
    };
  }

  get visible() { return this.mesh.visible; }
  set visible(value) { this.mesh.visible = value; }

  /** After the field's coordinates or the poses have changed. */
  evaluate(renderer, q, turn) {
    this.field.evaluate(renderer, q, turn);
    this.values.bent.value = this.uniforms.bent.value;
    this.values.poses.value = this.uniforms.poses.value;
    this.mesh.updateVersion();
  }

  dispose() {
    this.stage.scene.remove(this.mesh, this.renderer);
    this.mesh.dispose();
    this.field.dispose();
    for (const texture of Object.values(this.textures)) texture.dispose();
  }
}

/** Float16 coefficients as 16-bit steps a bin, weighted as the spectrum's sum wants them. */
function fieldOf({ coefficients, N, K, frames }) {
  const scale = new Float32Array(K), shapes = new Int16Array(coefficients.length);
  const bin = (i) => Math.floor(i / 6) % K;
  coefficients.forEach((value, i) => { scale[bin(i)] = Math.max(scale[bin(i)], Math.abs(value)); });
  coefficients.forEach((value, i) => { shapes[i] = Math.round((32767 * value) / Math.max(scale[bin(i)], 1e-12)); });
  const weighted = scale.map((most, k) => (Math.max(most, 1e-12) / 32767) * (k === 0 || 2 * k === frames ? 1 : 2));
  return new Field(shapes, weighted, N);
}

function texturesOf(splat, carriers) {
  const corners = new Float32Array(8 * splat.G);
  for (let g = 0; g < splat.G; g++) {
    const face = splat.face_of[g];
    if (face < 0) continue; // stays still: its fourth number is 0
    for (let c = 0; c < 3; c++) {
      corners[8 * g + c] = splat.triangles[3 * face + c];
      corners[8 * g + 4 + c] = splat.weights[3 * g + c];
    }
    corners[8 * g + 3] = 1;
  }
  const rest = new Float32Array(4 * splat.N);
  for (let v = 0; v < splat.N; v++) rest.set(splat.vertices.subarray(3 * v, 3 * v + 3), 4 * v);
  return { corners: texture(corners), rest: texture(rest), bones: texture(carriers) };
}

function texture(values) {
  const rows = Math.max(1, Math.ceil(values.length / 4 / WIDTH)), padded = new Float32Array(4 * WIDTH * rows);
  padded.set(values);
  const made = new THREE.DataTexture(padded, WIDTH, rows, THREE.RGBAFormat, THREE.FloatType);
  made.needsUpdate = true;
  return made;
}

const GLSL = /* glsl */ `
vec4 treeTexel(sampler2D held, int i) { return texelFetch(held, ivec2(i % ${WIDTH}, i / ${WIDTH}), 0); }
vec3 treeVertex(int v, vec3 at, sampler2D moved, sampler2D poses, float bent, sampler2D bones) {
  vec3 x = at + treeTexel(moved, v).xyz;
  if (bent < 0.5) return x;
  vec4 row = treeTexel(bones, 2 * v), weight = treeTexel(bones, 2 * v + 1);
  vec3 sum = vec3(0.0);
  for (int i = 0; i < 4; i++) {
    int bone = int(row[i] + 0.5);
    ivec2 p = ivec2(3 * (bone % 256), bone / 256);
    vec4 h = vec4(x, 1.0);
    sum += weight[i] * vec3(dot(texelFetch(poses, p, 0), h), dot(texelFetch(poses, p + ivec2(1, 0), 0), h), dot(texelFetch(poses, p + ivec2(2, 0), 0), h));
  }
  return sum;
}
// edge, in-plane normal to it, face normal
mat3 treeFrame(vec3 a, vec3 b, vec3 c) {
  vec3 e = normalize(b - a), n = normalize(cross(b - a, c - a));
  return mat3(e, cross(n, e), n);
}
vec4 treeTurn(mat3 m) { // rotation to quaternion x, y, z, w
  vec4 s = 1.0 + vec4(m[0][0] - m[1][1] - m[2][2], m[1][1] - m[0][0] - m[2][2], m[2][2] - m[0][0] - m[1][1], m[0][0] + m[1][1] + m[2][2]);
  if (s.w >= max(s.x, max(s.y, s.z))) return normalize(vec4(m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0], s.w));
  if (s.x >= max(s.y, s.z)) return normalize(vec4(s.x, m[0][1] + m[1][0], m[2][0] + m[0][2], m[1][2] - m[2][1]));
  if (s.y >= s.z) return normalize(vec4(m[0][1] + m[1][0], s.y, m[1][2] + m[2][1], m[2][0] - m[0][2]));
  return normalize(vec4(m[2][0] + m[0][2], m[1][2] + m[2][1], s.z, m[0][1] - m[1][0]));
}
Gsplat treeDeform(Gsplat g, sampler2D moved, sampler2D poses, float bent, sampler2D corners, sampler2D rest, sampler2D bones) {
  vec4 corner = treeTexel(corners, 2 * g.index);
  if (corner.w < 0.5) return g;
  vec3 weight = treeTexel(corners, 2 * g.index + 1).xyz;
  vec3 v[3], w[3];
  for (int i = 0; i < 3; i++) {
    int at = int(corner[i] + 0.5);
    v[i] = treeTexel(rest, at).xyz;
    w[i] = treeVertex(at, v[i], moved, poses, bent, bones);
  }
  mat3 T = treeFrame(v[0], v[1], v[2]), S = treeFrame(w[0], w[1], w[2]);
  // in the planes of the faces: corner 1 is (l, 0), corner 2 is (x, y)
  float l = length(v[1] - v[0]), x = dot(v[2] - v[0], T[0]), y = dot(v[2] - v[0], T[1]);
  float m = length(w[1] - w[0]), p = dot(w[2] - w[0], S[0]), q = dot(w[2] - w[0], S[1]);
  mat2 F = mat2(m / l, 0.0, (p - m * x / l) / y, q / y);
  float angle = atan(F[0][1] - F[1][0], F[0][0] + F[1][1]);
  float c = cos(angle), s = sin(angle);
  mat3 R = S * mat3(c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0) * transpose(T);
  mat3 D = S * mat3(F[0][0], F[0][1], 0.0, F[1][0], F[1][1], 0.0, 0.0, 0.0, 1.0) * transpose(T);
  vec3 from = weight.x * v[0] + weight.y * v[1] + weight.z * v[2], to = weight.x * w[0] + weight.y * w[1] + weight.z * w[2];
  g.center = to + R * (g.center - from);
  for (int i = 0; i < 3; i++) {
    vec3 axis = vec3(0.0);
    axis[i] = 1.0;
    g.scales[i] *= clamp(length(D * quatVec(g.quaternion, axis)), 0.25, 4.0);
  }
  g.quaternion = quatQuat(treeTurn(R), g.quaternion);
  return g;
}`;

function modifier({ Dyno, Gsplat, dynoBlock }, values) {
  const names = ["moved", "poses", "bent", "corners", "rest", "bones"];
  const inTypes = { gsplat: Gsplat, ...Object.fromEntries(names.map((name) => [name, name === "bent" ? "float" : "sampler2D"])) };
  const deform = new Dyno({
    inTypes, outTypes: { gsplat: Gsplat }, globals: () => [GLSL],
    statements: ({ inputs, outputs }) => [`${outputs.gsplat} = treeDeform(${["gsplat", ...names].map((name) => inputs[name]).join(", ")});`],
  });
  return dynoBlock({ gsplat: Gsplat }, { gsplat: Gsplat }, ({ gsplat }) => ({ gsplat: deform.apply({ gsplat, ...values }).gsplat }));
}

/** Four bones and four weights of each vertex: those of the same place on the surface, else the nearest voxel's bone. */
export function carriersOf(splat, surface, modes) {
  const at = new Map(), carriers = new Float32Array(8 * splat.N), key = (x, v) => `${x[3 * v]} ${x[3 * v + 1]} ${x[3 * v + 2]}`;
  for (let v = 0; v < surface.N; v++) at.set(key(surface.vertices, v), v);
  for (let v = 0; v < splat.N; v++) {
    const same = at.get(key(splat.vertices, v));
    if (same === undefined) {
      carriers[8 * v] = modes.bone_of_voxel[nearest(splat.vertices.subarray(3 * v, 3 * v + 3), modes)];
      carriers[8 * v + 4] = 1;
    } else {
      for (let i = 0; i < 4; i++) {
        carriers[8 * v + i] = surface.bone_rows[4 * same + i];
        carriers[8 * v + 4 + i] = surface.bone_weights[4 * same + i] / 255;
      }
    }
  }
  return carriers;
}

function nearest(point, { centres, V }) {
  let best = 0, least = Infinity;
  for (let v = 0; v < V; v++) {
    const far = (centres[3 * v] - point[0]) ** 2 + (centres[3 * v + 1] - point[1]) ** 2 + (centres[3 * v + 2] - point[2]) ** 2;
    if (far < least) [best, least] = [v, far];
  }
  return best;
}
