// Displacement of a mesh whose bones turn in the wind: branches bend however strong it is. docs/engines.md has the equations.

import * as THREE from "three";
import { coordinatesTexture, Field, MODES, setCoordinates, shapesTexture, TURN, voxelFieldOf, WIDTH } from "./field.js";
import { Pass } from "./pass.js";

// of each bone two texels: foot and parent, direction to its end
const BONES = /* glsl */ `
uniform highp sampler2D bones;
uniform highp sampler2D halfTurns; // by bone: axis times the sine of half the angle
vec4 boneTexel(int b, int i) { int at = 2 * b + i; return texelFetch(bones, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0); }
vec3 halfTurnOf(int b, int copy) { return texelFetch(halfTurns, ivec2(b % ${WIDTH}, b / ${WIDTH} + copy * BONE_ROWS), 0).xyz; }
vec3 turned(vec3 v, vec3 arm) { return arm + 2.0 * cross(v, cross(v, arm) + sqrt(1.0 - dot(v, v)) * arm); }`;

const MAIN = /* glsl */ `
void main() {
  int copy = int(gl_FragCoord.y) / BONE_ROWS;
  int b = (int(gl_FragCoord.y) - copy * BONE_ROWS) * ${WIDTH} + int(gl_FragCoord.x);
  if (b >= NUM_BONES) discard;
  gl_FragColor = vec4(resultOf(b, copy), 1.0);
}`;

const TURNS = /* glsl */ `${MODES}
${BONES}
${TURN}
vec3 resultOf(int b, int copy) {
  vec3 theta = modesOf(b, copy), direction = boneTexel(b, 1).xyz;
  theta = cross(direction, turnedWithWind(cross(theta, direction), copy)) + dot(theta, direction) * direction;
  float c = inversesqrt(1.0 + dot(theta, theta)); // cosine of the angle, atan |theta|
  return theta * c * inversesqrt(2.0 + 2.0 * c);
}
${MAIN}`;

const FEET = /* glsl */ `${BONES}
vec3 resultOf(int b, int copy) {
  vec3 moved = vec3(0.0);
  vec4 foot = boneTexel(b, 0);
  for (int i = 0; i < MOST_ANCESTORS && foot.w >= 0.0; i++) {
    int parent = int(foot.w + 0.5);
    vec4 above = boneTexel(parent, 0);
    vec3 arm = foot.xyz - above.xyz;
    moved += turned(halfTurnOf(parent, copy), arm) - arm;
    foot = above;
  }
  return moved;
}
${MAIN}`;

// of each vertex one texel: its place, and its bone plus half the parent's share
const MOTION = /* glsl */ `${BONES}
uniform highp sampler2D feet;
uniform highp sampler2D places;
vec3 motionOf(int point, int copy) {
  vec4 place = texelFetch(places, ivec2(point % ${WIDTH}, point / ${WIDTH}), 0);
  int b = int(place.w);
  vec4 foot = boneTexel(b, 0);
  vec3 arm = place.xyz - foot.xyz;
  float share = 2.0 * fract(place.w);
  vec3 v = halfTurnOf(b, copy);
  if (share > 0.0) v = mix(v, halfTurnOf(int(foot.w + 0.5), copy), share);
  vec3 moved = texelFetch(feet, ivec2(b % ${WIDTH}, b / ${WIDTH} + copy * BONE_ROWS), 0).xyz;
  return moved + turned(v, arm) - arm;
}`;

export class BoneField extends Field {
  /** Of the contents of a surface file, or of the field that has its textures. */
  constructor(surface, copies = 1, textures = null) {
    const own = textures ?? texturesOf(surface);
    const { scale_m, turn_scale_rad, turn_parent, N } = surface;
    const [K, B] = [scale_m.length, turn_parent.length];
    const rows = Math.ceil(B / WIDTH);
    const size = { width: WIDTH, height: copies * rows };
    const defines = {
      BINS: K,
      NUM_BONES: B,
      BONE_ROWS: rows,
      COPIES: copies,
      MOST_ANCESTORS: mostAncestors(turn_parent),
    };
    const q = coordinatesTexture(K, copies);
    const turns = new Pass({ ...size, defines, fragmentShader: TURNS, uniforms: {} });
    const feet = new Pass({ ...size, defines, fragmentShader: FEET, uniforms: {} });
    const [bones, halfTurns] = [{ value: own.bones }, { value: turns.target.texture }];
    const read = { bones, halfTurns, feet: { value: feet.target.texture }, places: { value: own.places } };
    super(own.shapes, scale_m, N, copies, { motion: MOTION.replaceAll("BONE_ROWS", rows), uniforms: read });
    Object.assign(turns.material.uniforms, {
      shapes: { value: own.turns },
      q: { value: q },
      bones,
      turn: { value: this.turn },
    });
    Object.assign(feet.material.uniforms, { bones, halfTurns });
    Object.assign(this, {
      surface,
      own,
      turnScale: turn_scale_rad,
      boneQ: q,
      turns,
      feet,
      isCopy: Boolean(textures),
    });
  }

  copied(copies) {
    return new BoneField(this.surface, copies, this.own);
  }

  evaluateAll(renderer, motions) {
    setCoordinates(this.boneQ, this.turnScale, motions);
    motions.forEach(({ turn }, copy) => {
      this.turn[copy].set(Math.cos(turn), Math.sin(turn));
    });
    this.turns.render(renderer);
    this.feet.render(renderer);
    super.evaluateAll(renderer, motions);
  }

  dispose() {
    super.dispose();
    const shared = this.isCopy ? [] : Object.values(this.own);
    for (const resource of [this.turns, this.feet, this.boneQ, ...shared]) resource.dispose();
  }
}

/** The field of a surface file's contents: of bones, of modes of the vertices, or of its Modes where the mesh is large. */
export function fieldOf(surface, modes) {
  const N = surface.vertices.length / 3;
  if (surface.turn_parent) return new BoneField({ ...surface, N });
  return surface.shapes ? new Field(surface.shapes, surface.scale_m, N) : voxelFieldOf(modes);
}

function texturesOf({ shapes, scale_m, N, vertices, turn_shapes, turn_parent, turn_foot_m, turn_direction, ...ties }) {
  const [K, B] = [scale_m.length, turn_parent.length];
  const bones = Array.from({ length: B }, (_, b) => [
    ...turn_foot_m.subarray(3 * b, 3 * b + 3),
    turn_parent[b],
    ...turn_direction.subarray(3 * b, 3 * b + 3),
    0,
  ]);
  const { turn_bone, turn_share } = ties;
  const places = Array.from({ length: N }, (_, v) => [
    ...vertices.subarray(3 * v, 3 * v + 3),
    turn_bone[v] + Math.min(turn_share[v] / 2, 0.499),
  ]);
  return {
    shapes: shapes ? shapesTexture(shapes, 3 * N * K) : shapesTexture([], 1), // only read where a bin's share is shown
    turns: shapesTexture(turn_shapes, 3 * B * K),
    bones: floats(bones.flat()),
    places: floats(places.flat()),
  };
}

function floats(values) {
  const padded = new Float32Array(4 * WIDTH * Math.ceil(values.length / 4 / WIDTH));
  padded.set(values);
  const texture = new THREE.DataTexture(padded, WIDTH, padded.length / 4 / WIDTH, THREE.RGBAFormat, THREE.FloatType);
  texture.needsUpdate = true;
  return texture;
}

/** The longest way from a bone to the ground; parents come before children. */
function mostAncestors(parent) {
  const depth = new Uint16Array(parent.length);
  for (let b = 1; b < parent.length; b++) depth[b] = depth[parent[b]] + 1;
  return depth.reduce((most, one) => Math.max(most, one), 0);
}
