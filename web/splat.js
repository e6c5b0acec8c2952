// A cloud of Gaussians that hangs on a mesh, drawn by Spark: the rules of docs/formats-splat.md in Spark's own shader.

import * as THREE from "three";
import { Field } from "./field.js";
import { readTensors } from "./modes.js";

const WIDTH = 2048; // of the textures below

// Y_h of a direction d, with the signs of Kerbl et al. 2023, as dynamictree/gaussian/harmonics.py has them
const HARMONICS = [
  "0.28209479",
  "-0.48860251 * d.y",
  "0.48860251 * d.z",
  "-0.48860251 * d.x",
  "1.09254843 * d.x * d.y",
  "-1.09254843 * d.y * d.z",
  "0.31539157 * (2.0 * s.z - s.x - s.y)",
  "-1.09254843 * d.x * d.z",
  "0.54627422 * (s.x - s.y)",
  "-0.59004359 * d.y * (3.0 * s.x - s.y)",
  "2.89061144 * d.x * d.y * d.z",
  "-0.45704580 * d.y * (4.0 * s.z - s.x - s.y)",
  "0.37317633 * d.z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y)",
  "-0.45704580 * d.x * (4.0 * s.z - s.x - s.y)",
  "1.44530572 * d.z * (s.x - s.y)",
  "-0.59004359 * d.x * (s.x - 3.0 * s.y)",
];

/** The body of a `.animated-splat.safetensors`; its harmonics stay the half floats that a texture takes. */
export function readSplat(buffer) {
  const { tensors, shape, metadata } = readTensors(buffer, { halves: ["sh"] });
  return {
    ...tensors,
    G: shape.means[0],
    N: shape.vertices[0],
    K: shape.coefficients[1],
    harmonics: shape.sh[1],
    frames: Number(metadata.num_frames),
  };
}

export class SplatView {
  /** `poses` and `bent` are the tree's uniforms, `carriers` four bones and weights of each vertex. */
  static async make(stage, splat, carriers, uniforms) {
    const spark = await import("spark");
    const view = new SplatView();
    view.stage = stage;
    view.field = fieldOf(splat);
    view.uniforms = uniforms;
    view.harmonics = harmonicsThatFit(splat, stage.renderer.capabilities.maxTextureSize);
    view.textures = texturesOf(splat, carriers, view.harmonics);
    const cloud = new spark.ExtSplats({ maxSplats: splat.G }); // places in single precision: half would be 8 mm at 10 m
    const [at, scales, turn, grey] = [
      new THREE.Vector3(),
      new THREE.Vector3(),
      new THREE.Quaternion(),
      new THREE.Color(0.5, 0.5, 0.5),
    ];
    for (let g = 0; g < splat.G; g++) {
      at.fromArray(splat.means, 3 * g);
      scales.fromArray(splat.scales, 3 * g);
      turn
        .set(
          splat.quaternions[4 * g + 1],
          splat.quaternions[4 * g + 2],
          splat.quaternions[4 * g + 3],
          splat.quaternions[4 * g],
        )
        .normalize();
      cloud.pushSplat(at, scales, turn, splat.opacity[g], grey);
    }
    cloud.updateTextures();
    const redraw = () => {
      stage.stale = true;
    }; // sorting takes longer than a frame
    view.renderer = stage.sparkRenderer ??= new spark.SparkRenderer({
      renderer: stage.renderer,
      accumExtSplats: true,
      onDirty: redraw,
    });
    stage.scene.add(view.renderer);
    view.values = view._values(spark.dyno);
    view.mesh = new spark.SplatMesh({
      extSplats: cloud,
      objectModifier: modifier(spark.dyno, view.values, view.harmonics),
    });
    stage.scene.add(view.mesh);
    await view.mesh.initialized;
    return view;
  }

  _values({ dynoSampler2D, dynoFloat, dynoVec3 }) {
    return {
      moved: dynoSampler2D(this.field.texture),
      poses: dynoSampler2D(this.uniforms.poses.value),
      bent: dynoFloat(0),
      corners: dynoSampler2D(this.textures.corners),
      rest: dynoSampler2D(this.textures.rest),
      bones: dynoSampler2D(this.textures.bones),
      sh: dynoSampler2D(this.textures.sh),
      eye: dynoVec3(new THREE.Vector3()),
    };
  }

  /** Whether there is something to see: the first sorting has ended. */
  get drawn() {
    return this.renderer.activeSplats > 0;
  }
  get visible() {
    return this.mesh.visible;
  }
  set visible(value) {
    this.mesh.visible = value;
  }

  /** Before each draw. What has not changed is not sorted anew, so that a still picture comes to rest. */
  evaluate(renderer, q, turn) {
    const { position } = this.stage.camera;
    const now = [turn, ...position, ...q].join();
    if (now === this.before && !this.uniforms.bent.value && !this.values.bent.value) return;
    this.before = now;
    this.field.evaluate(renderer, q, turn);
    this.values.eye.value.copy(position);
    this.values.bent.value = this.uniforms.bent.value;
    this.values.poses.value = this.uniforms.poses.value;
    this.mesh.updateVersion();
  }

  dispose() {
    this.stage.scene.remove(this.mesh, this.renderer);
    this.renderer.activeSplats = 0;
    this.mesh.dispose();
    this.field.dispose();
    for (const texture of Object.values(this.textures)) texture.dispose();
  }
}

/** Float16 coefficients as 16-bit steps a bin, weighted as the spectrum's sum wants them. */
function fieldOf({ coefficients, N, K, frames }) {
  const scale = new Float32Array(K);
  const shapes = new Int16Array(coefficients.length);
  const bin = (i) => Math.floor(i / 6) % K;
  coefficients.forEach((value, i) => {
    scale[bin(i)] = Math.max(scale[bin(i)], Math.abs(value));
  });
  coefficients.forEach((value, i) => {
    shapes[i] = Math.round((32767 * value) / Math.max(scale[bin(i)], 1e-12));
  });
  const weighted = scale.map((most, k) => (Math.max(most, 1e-12) / 32767) * (k === 0 || 2 * k === frames ? 1 : 2));
  return new Field(shapes, weighted, N);
}

/** Half floats of a Gaussian, in whole texels of four. */
const halvesOf = (harmonics) => 4 * Math.ceil((3 * harmonics) / 4);

/** As many degrees as one texture holds: all four up to some millions of Gaussians. */
function harmonicsThatFit({ G, harmonics }, largest) {
  const fits = (count) => Math.ceil((G * halvesOf(count)) / 4 / WIDTH) <= largest;
  return [16, 9, 4].find((count) => count <= harmonics && fits(count)) ?? 1;
}

function harmonicsTexture({ G, harmonics, sh }, count) {
  const width = halvesOf(count);
  const padded = new Uint16Array(4 * WIDTH * Math.ceil((G * width) / 4 / WIDTH));
  for (let g = 0; g < G; g++) padded.set(sh.subarray(3 * g * harmonics, 3 * (g * harmonics + count)), g * width);
  return asTexture(padded, THREE.HalfFloatType);
}

function texturesOf(splat, carriers, harmonics) {
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
  return {
    corners: texture(corners),
    rest: texture(rest),
    bones: texture(carriers),
    sh: harmonicsTexture(splat, harmonics),
  };
}

function texture(values) {
  const padded = new Float32Array(4 * WIDTH * Math.max(1, Math.ceil(values.length / 4 / WIDTH)));
  padded.set(values);
  return asTexture(padded, THREE.FloatType);
}

function asTexture(padded, type) {
  const made = new THREE.DataTexture(padded, WIDTH, padded.length / 4 / WIDTH, THREE.RGBAFormat, type);
  made.needsUpdate = true;
  return made;
}

/** Of a Gaussian that stands at `at` and has turned by R: 0.5 + Σ sh Y(Rᵀ d), d the direction from the eye. */
function colourShader(harmonics) {
  const half = (i) => `t[${i >> 2}].${"xyzw"[i & 3]}`;
  const texels = halvesOf(harmonics) / 4;
  const terms = HARMONICS.slice(0, harmonics).map(
    (y, h) => `c += (${y}) * vec3(${half(3 * h)}, ${half(3 * h + 1)}, ${half(3 * h + 2)});`,
  );
  return /* glsl */ `
vec3 treeColour(sampler2D sh, int g, vec3 at, mat3 R, vec3 eye) {
  vec4 t[${texels}];
  for (int i = 0; i < ${texels}; i++) t[i] = treeTexel(sh, ${texels} * g + i);
  vec3 d = transpose(R) * normalize(at - eye), s = d * d, c = vec3(0.5);
  ${terms.join("\n  ")}
  return max(c, 0.0);
}`;
}

const GLSL = (harmonics) => /* glsl */ `
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
${colourShader(harmonics)}
Gsplat treeDeform(Gsplat g, sampler2D moved, sampler2D poses, float bent, sampler2D corners, sampler2D rest, sampler2D bones, sampler2D sh, vec3 eye) {
  vec4 corner = treeTexel(corners, 2 * g.index);
  if (corner.w < 0.5) {
    g.rgba.rgb = treeColour(sh, g.index, g.center, mat3(1.0), eye);
    return g;
  }
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
  vec2 turn = vec2(F[0][0] + F[1][1], F[0][1] - F[1][0]); // no angle: some drivers' atan gives pi for (-0, 2)
  float c = 1.0, s = 0.0, size = length(turn);
  if (size > 1e-6) { c = turn.x / size; s = turn.y / size; }
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
  g.rgba.rgb = treeColour(sh, g.index, g.center, R, eye);
  return g;
}`;

const INPUTS = {
  moved: "sampler2D",
  poses: "sampler2D",
  bent: "float",
  corners: "sampler2D",
  rest: "sampler2D",
  bones: "sampler2D",
  sh: "sampler2D",
  eye: "vec3",
};

function modifier({ Dyno, Gsplat, dynoBlock }, values, harmonics) {
  const names = ["gsplat", ...Object.keys(INPUTS)];
  const shader = GLSL(harmonics);
  const deform = new Dyno({
    inTypes: { gsplat: Gsplat, ...INPUTS },
    outTypes: { gsplat: Gsplat },
    globals: () => [shader],
    statements: ({ inputs, outputs }) => [
      `${outputs.gsplat} = treeDeform(${names.map((name) => inputs[name]).join(", ")});`,
    ],
  });
  return dynoBlock({ gsplat: Gsplat }, { gsplat: Gsplat }, ({ gsplat }) => ({
    gsplat: deform.apply({ gsplat, ...values }).gsplat,
  }));
}

/** Four bones and four weights of each vertex: those of the same place on the surface, else the nearest voxel's bone. */
export function carriersOf(splat, surface, modes) {
  const at = new Map();
  const carriers = new Float32Array(8 * splat.N);
  const key = (x, v) => `${x[3 * v]} ${x[3 * v + 1]} ${x[3 * v + 2]}`;
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
  let best = 0;
  let least = Infinity;
  for (let v = 0; v < V; v++) {
    const far =
      (centres[3 * v] - point[0]) ** 2 + (centres[3 * v + 1] - point[1]) ** 2 + (centres[3 * v + 2] - point[2]) ** 2;
    if (far < least) [best, least] = [v, far];
  }
  return best;
}
