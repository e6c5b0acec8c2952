// Materials whose vertices follow the displacement field and the bones: one shader, three kinds of geometry.

import * as THREE from "three";
import { CARDS, setCards } from "./cards.js";
import { replaced } from "./chunks.js";
import { DISPLACE } from "./field.js";

/** Weighted mean of the four bones of a vertex. */
const BONES = /* glsl */ `
attribute float still;
float stillness() { return still; }
attribute vec4 boneRows; attribute vec4 boneWeights;
mat4 poseOfPoint() {
  mat4 pose = mat4(0.0);
  float carried = 0.0; // 0 for what is no plant
  for (int i = 0; i < 4 * bent; i++) { // software skips a loop, not a branch
    pose += boneWeights[i] * poseOf(int(boneRows[i] + 0.5));
    carried += boneWeights[i];
  }
  return pose + mat4(1.0 - carried);
}
vec3 restPoint() { restNormal = normal; return position; }`;

/**
 * How a geometry answers three questions: where the displacement of this point is (`fieldOfPoint`), which pose carries
 * it (`poseOfPoint`), and where it is at rest (`restPoint`, which sets `restNormal`).
 */
const KINDS = {
  /** Each vertex has its own displacement. */
  bones: `${BONES}
vec4 fieldOfPoint() { return movedAt(gl_VertexID); }`,

  /** The same, those of a leaf card one together. */
  vertices: `${BONES}
${CARDS}
vec4 fieldOfPoint() { vec4 own = movedAt(gl_VertexID); return vec4(cardMoved(own.xyz), own.w); }`,

  /** A vertex has the weighted mean of its four nearest voxels. */
  nearVoxels: `${BONES}
attribute vec4 tieRows; attribute vec4 tieWeights;
vec4 fieldOfPoint() {
  vec4 sum = vec4(0.0);
  for (int i = 0; i < 4; i++) sum += tieWeights[i] * movedAt(int(tieRows[i]));
  return sum;
}`,

  /** Three quads a voxel, those that face the camera; a vertex is (axis, ±1, ±1). */
  cubes: /* glsl */ `
uniform highp sampler2D voxels; // by voxel: centre, bone
uniform float halfSize;
float stillness() { return 0.0; }
int voxelOfPoint() { return int(voxelRow + 0.5); }
vec4 voxelTexel() { int v = voxelOfPoint(); return texelFetch(voxels, ivec2(v % 2048, v / 2048), 0); }
vec4 fieldOfPoint() { return movedAt(voxelOfPoint()); }
mat4 poseOfPoint() { return bent == 0 ? mat4(1.0) : poseOf(int(voxelTexel().w + 0.5)); }
vec3 restPoint() {
  vec3 centre = voxelTexel().xyz;
  vec3 toEye = isOrthographic ? vec3(viewMatrix[0][2], viewMatrix[1][2], viewMatrix[2][2]) : cameraPosition - centre;
  int axis = int(position.x + 0.5);
  restNormal = vec3(0.0);
  restNormal[axis] = toEye[axis] < 0.0 ? -1.0 : 1.0;
  vec3 corner = restNormal;
  corner[(axis + 1) % 3] = position.y;
  corner[(axis + 2) % 3] = position.z;
  return centre + halfSize * corner;
}`,
};

const FOLLOW = /* glsl */ `
varying float vShare;
varying float vStill;
mat4 pose;
vec3 follow() {
  vec3 rest = restPoint();
  vec4 field = fieldOfPoint();
  vShare = field.w;
  vStill = stillness();
  pose = poseOfPoint();
  return (pose * vec4(rest + field.xyz, 1.0)).xyz;
}`;

// a colour map that reads in order: dark where nothing moves, through blue and green to a light yellow
const RAMP = /* glsl */ `
vec3 ramp(float s) {
  s = clamp(s, 0.0, 1.0);
  vec3 a = vec3(0.10, 0.11, 0.24), b = vec3(0.08, 0.38, 0.55), c = vec3(0.22, 0.66, 0.47), d = vec3(0.99, 0.88, 0.30);
  return s < 0.33 ? mix(a, b, s / 0.33) : s < 0.66 ? mix(b, c, (s - 0.33) / 0.33) : mix(c, d, (s - 0.66) / 0.34);
}`;

// normals of foliage look outward on both sides
const OUTWARD = /* glsl */ `
float faceDirection = 1.0; vec3 normal = normalize(vNormal); vec3 nonPerturbedNormal = normal;
#ifdef USE_NORMALMAP_TANGENTSPACE
  mat3 tbn = getTangentFrame(-vViewPosition, normal, vNormalMapUv);
#endif`;

const COLOURS = {
  cubes: "diffuseColor.rgb = mix(vec3(0.22, 0.42, 0.30), vec3(0.62, 0.74, 0.55), 0.5 + 0.5 * normalize(vNormal).y);",
};

/** Make a material's vertices follow; `uniforms` are the tree's. `kind` is a key of KINDS. */
export function makeFollow(material, uniforms, kind) {
  const lit = material.isMeshLambertMaterial || material.isMeshStandardMaterial;
  const declared = kind === "cubes" ? "attribute float voxelRow;" : "";
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, uniforms);
    shader.vertexShader = replaced(shader.vertexShader, {
      common: `$&\n${declared}\nvec3 restNormal;\n${DISPLACE}\n${KINDS[kind]}\n${FOLLOW}`,
      ...(lit && { beginnormal_vertex: "vec3 followed = follow();\nvec3 objectNormal = mat3(pose) * restNormal;" }),
      begin_vertex: `vec3 transformed = ${lit ? "followed" : "follow()"};`,
    });
    if (!lit) return; // a shadow has no colour
    shader.fragmentShader = replaced(shader.fragmentShader, {
      common: `$&\nuniform float coloured; varying float vShare, vStill;\n${RAMP}`,
      color_fragment: `$&\n${COLOURS[kind] ?? ""}
if (coloured > 0.5) diffuseColor.rgb = mix(ramp(vShare), vec3(0.5), vStill);`,
      normal_fragment_begin: OUTWARD,
    });
  };
  material.customProgramCacheKey = () => `follow-${material.type}-${kind}`;
  return material;
}

const PLAIN = { base_color: [0.5, 0.5, 0.5, 1], alpha_cutoff: null };

/** One material for each of the surface's, and the one that the sun's shadow map is drawn with. */
export function surfaceMaterials(surface, uniforms) {
  const kind = surface.tie_rows ? "nearVoxels" : surface.turn_parent ? "bones" : "vertices";
  if (surface.shapes && !surface.turn_parent) uniforms.restAt = { value: (surface.restAt ??= setCards(surface)) };
  const all = surface.materials.length ? surface.materials : [PLAIN];
  const lit = all.map(({ base_color: [r, g, b], alpha_cutoff: cutoff }, index) => {
    const shiny = surface.looks?.[index];
    const Kind = shiny ? THREE.MeshStandardMaterial : THREE.MeshLambertMaterial;
    const material = new Kind({
      ...shiny,
      color: new THREE.Color(r, g, b),
      map: (surface.materials.length && surface.textures[index]) || null, // other textures lie behind those of materials
      vertexColors: true,
      alphaTest: cutoff ?? 0,
      side: THREE.DoubleSide,
      shadowSide: THREE.DoubleSide,
    });
    return makeFollow(material, uniforms, kind);
  });
  const cut = all.findIndex(({ alpha_cutoff: cutoff }, index) => cutoff !== null && surface.textures[index]);
  const depth = new THREE.MeshDepthMaterial({
    side: THREE.DoubleSide,
    map: cut < 0 ? null : surface.textures[cut],
    alphaTest: cut < 0 ? 0 : all[cut].alpha_cutoff,
  });
  return { lit: lit.length === 1 ? lit[0] : lit, depth: makeFollow(depth, uniforms, kind) };
}

/** The tree at rest, to be laid over the one that moves: its outline filled once, however many leaves lie behind each other. */
export function ghostOf(geometry) {
  const once = {
    stencilWrite: true,
    stencilFunc: THREE.NotEqualStencilFunc,
    stencilRef: 1,
    stencilZPass: THREE.ReplaceStencilOp,
  };
  const faint = { transparent: true, opacity: 0.3, depthWrite: false, side: THREE.DoubleSide };
  const ghost = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ ...faint, ...once }));
  ghost.visible = false;
  return ghost;
}
