// The deformation of Gaussians in Spark's own shader: the rules of docs/formats-splat.md.

import { WIDTH } from "./field.js";

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

/** Half floats of a Gaussian, in whole texels of four. */
export const halvesOf = (harmonics) => 4 * Math.ceil((3 * harmonics) / 4);

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
vec4 treeTexel(sampler2D texels, int i) { return texelFetch(texels, ivec2(i % ${WIDTH}, i / ${WIDTH}), 0); }
vec3 treePosed(sampler2D poses, float joint, vec4 x) {
  int at = 3 * int(joint + 0.5);
  return vec3(dot(treeTexel(poses, at), x), dot(treeTexel(poses, at + 1), x), dot(treeTexel(poses, at + 2), x));
}
vec3 treeVertex(int v, vec3 at, sampler2D moved, sampler2D poses, float bent, sampler2D joints) {
  vec4 x = vec4(at + treeTexel(moved, v).xyz, 1.0), of = treeTexel(joints, v);
  return bent < 0.5 ? x.xyz : mix(treePosed(poses, of.x, x), treePosed(poses, of.y, x), of.z);
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
Gsplat treeDeform(Gsplat g, sampler2D moved, sampler2D poses, sampler2D corners, sampler2D rest, sampler2D joints, sampler2D leaves, sampler2D sh, float bent, vec3 eye) {
  vec4 corner = treeTexel(corners, 2 * g.index);
  if (corner.w < 0.5) {
    g.rgba.rgb = treeColour(sh, g.index, g.center, mat3(1.0), eye);
    return g;
  }
  vec4 weight = treeTexel(corners, 2 * g.index + 1); // and one more than its leaf
  vec3 v[3], w[3];
  for (int i = 0; i < 3; i++) {
    int at = int(corner[i] + 0.5);
    v[i] = treeTexel(rest, at).xyz;
    w[i] = treeVertex(at, v[i], moved, poses, bent, joints);
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
  if (weight.w > 0.5) { // a leaf turns about a vertex
    vec4 leaf = treeTexel(leaves, int(weight.w - 0.5)), turned = vec4(leaf.xyz, sqrt(1.0 - dot(leaf.xyz, leaf.xyz)));
    int at = int(leaf.w + 0.5);
    vec3 foot = treeVertex(at, treeTexel(rest, at).xyz, moved, poses, bent, joints);
    g.center = foot + quatVec(turned, g.center - foot);
    g.quaternion = quatQuat(turned, g.quaternion);
    for (int i = 0; i < 3; i++) R[i] = quatVec(turned, R[i]);
  }
  g.rgba.rgb = treeColour(sh, g.index, g.center, R, eye);
  return g;
}`;

const TEXTURES = ["moved", "poses", "corners", "rest", "joints", "leaves", "sh"];
const INPUTS = { ...Object.fromEntries(TEXTURES.map((name) => [name, "sampler2D"])), bent: "float", eye: "vec3" };

export function modifier({ Dyno, Gsplat, dynoBlock }, values, harmonics) {
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
