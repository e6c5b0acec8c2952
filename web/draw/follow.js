// Materials whose vertices follow the displacement field and the bones: one shader, two kinds of geometry.

import * as THREE from "three";
import { replaced } from "./chunks.js";
import { DISPLACE } from "./field.js";

/**
 * How a geometry answers three questions: where the displacement of this point is (`fieldOfPoint`), which pose carries
 * it (`poseOfPoint`), and where it is at rest (`restPoint`).
 */
const KINDS = {
  /** Each vertex has its own displacement; what is pushed carries it by two joints and the share of the second. */
  surface: /* glsl */ `
attribute float still, share;
attribute vec3 joints;
varying float vShare, vStill;
vec3 fieldOfPoint(highp sampler2D field) { vShare = share; vStill = still; return movedAt(field, gl_VertexID); }
mat4 poseOfPoint(highp sampler2D rows) {
  return (1.0 - joints.z) * poseOf(rows, int(joints.x + 0.5)) + joints.z * poseOf(rows, int(joints.y + 0.5));
}
vec3 restPoint() { return position; }`,

  /** A box with the motion of a vertex and the pose of a bone. */
  cubes: /* glsl */ `
attribute vec3 centre; attribute vec2 carrier;
vec3 fieldOfPoint(highp sampler2D field) { return movedAt(field, int(carrier.x + 0.5)); }
mat4 poseOfPoint(highp sampler2D rows) { return poseOf(rows, int(carrier.y + 0.5)); }
vec3 restPoint() { return centre + position; }`,
};

const FOLLOW = /* glsl */ `
vec3 turned; // normal of the point that was followed last
vec3 follow(vec3 normal, highp sampler2D field, highp sampler2D rows, int bent) {
  vec3 at = restPoint() + fieldOfPoint(field);
  turned = normal;
  for (int i = 0; i < bent; i++) { // software skips a loop, not a branch
    mat4 pose = poseOfPoint(rows);
    at = (pose * vec4(at, 1.0)).xyz;
    turned = mat3(pose) * normal;
  }
  return at;
}`;

const NOW = "moved, poses, bent";

// a shadow is looked up where the point was when the map was drawn: an older map darkens no crown that has left it
const LOOKED_UP = "transformed = follow(vec3(0.0), castMoved, castPoses, castBent);\n$&";

// a colour map that reads in order: dark where nothing moves, through blue and green to a light yellow
const RAMP = /* glsl */ `
vec3 ramp(float s) {
  s = clamp(s, 0.0, 1.0);
  vec3 a = vec3(0.10, 0.11, 0.24), b = vec3(0.08, 0.38, 0.55), c = vec3(0.22, 0.66, 0.47), d = vec3(0.99, 0.88, 0.30);
  return s < 0.33 ? mix(a, b, s / 0.33) : s < 0.66 ? mix(b, c, (s - 0.33) / 0.33) : mix(c, d, (s - 0.66) / 0.34);
}`;

// normals of foliage look outward on both sides
const OUTWARD = /* glsl */ `
float faceDirection = 1.0; vec3 normal = normalize(vNormal); vec3 nonPerturbedNormal = normal;`;

/** What is added to the colour of a kind. */
const COLOURS = {
  surface: `
for (int i = 0; i < coloured; i++) diffuseColor.rgb = mix(ramp(vShare), vec3(0.5), vStill);`,
  cubes: `
diffuseColor.rgb = mix(vec3(0.22, 0.42, 0.30), vec3(0.62, 0.74, 0.55), 0.5 + 0.5 * normalize(vNormal).y);`,
};
const COLOURED = { surface: `uniform int coloured; varying float vShare, vStill;\n${RAMP}`, cubes: "" };

/** Uniforms at rest: displacements and poses of now, and those with which the shadow map was drawn. */
export function uniformsAt(still) {
  const textures = ["moved", "castMoved", "poses", "castPoses"].map((name) => [name, { value: still }]);
  const numbers = ["bent", "castBent", "coloured"].map((name) => [name, { value: 0 }]);
  return Object.fromEntries([...textures, ...numbers]);
}

/** Make a material's vertices follow; `uniforms` are the tree's. `kind` is a key of KINDS. */
export function makeFollow(material, uniforms, kind) {
  const lit = material.isMeshLambertMaterial;
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, uniforms);
    shader.vertexShader = replaced(shader.vertexShader, {
      common: `$&\n${DISPLACE}\n${KINDS[kind]}\n${FOLLOW}`,
      ...(lit && { beginnormal_vertex: `vec3 followed = follow(normal, ${NOW}), objectNormal = turned;` }),
      begin_vertex: `vec3 transformed = ${lit ? "followed" : `follow(vec3(0.0), ${NOW})`};`,
      ...(lit && { worldpos_vertex: LOOKED_UP }),
    });
    if (!lit) return; // a shadow has no colour
    shader.fragmentShader = replaced(shader.fragmentShader, {
      common: `$&\n${COLOURED[kind]}`,
      color_fragment: `$&${COLOURS[kind]}`,
      normal_fragment_begin: OUTWARD,
    });
  };
  material.customProgramCacheKey = () => `follow-${material.type}-${kind}`;
  return material;
}

const PLAIN = { base_color: [0.5, 0.5, 0.5, 1], alpha_cutoff: null };

/** One material for each of the surface's, and the one that the sun's shadow map is drawn with. */
export function surfaceMaterials(surface, uniforms) {
  const all = surface.materials.length ? surface.materials : [PLAIN];
  const lit = all.map(({ base_color: [r, g, b], alpha_cutoff: cutoff }, index) => {
    const material = new THREE.MeshLambertMaterial({
      color: new THREE.Color(r, g, b),
      map: surface.textures[index] ?? null,
      vertexColors: true,
      alphaTest: cutoff ?? 0,
      side: THREE.DoubleSide,
      shadowSide: THREE.DoubleSide,
    });
    return makeFollow(material, uniforms, "surface");
  });
  const cut = all.findIndex(({ alpha_cutoff: cutoff }, index) => cutoff !== null && surface.textures[index]);
  const depth = new THREE.MeshDepthMaterial({
    side: THREE.DoubleSide,
    map: cut < 0 ? null : surface.textures[cut],
    alphaTest: cut < 0 ? 0 : all[cut].alpha_cutoff,
  });
  return { lit: lit.length === 1 ? lit[0] : lit, depth: makeFollow(depth, uniforms, "surface") };
}

/** The tree at rest, to be laid over the one that moves: its outline filled once, however many leaves lie behind each other. */
export function ghostOf(geometry) {
  const once = { stencilWrite: true, stencilFunc: THREE.NotEqualStencilFunc, stencilRef: 1 };
  const faint = { transparent: true, opacity: 0.3, depthWrite: false, side: THREE.DoubleSide };
  const material = new THREE.MeshBasicMaterial({ ...faint, ...once, stencilZPass: THREE.ReplaceStencilOp });
  const ghost = new THREE.Mesh(geometry, material);
  ghost.visible = false;
  return ghost;
}
