// Displacement of all vertices at once, on the GPU: bones turn in the wind, into a texture that shaders read by vertex.
// Branches bend however strong it is. docs/engines.md has the equations.

import * as THREE from "three";
import { swingBones } from "../motion/swing.js";
import { GUST, still } from "./gust.js";
import { Pass } from "./pass.js";

export const WIDTH = 2048; // of every texture here: every WebGL 2 has it

const DISPLACEMENT = /* glsl */ `
uniform highp sampler2D places; // by vertex: place at rest, its bone plus half the parent's share
uniform highp sampler2D feet;   // by bone: place at rest, parent
uniform highp sampler2D swings; // by bone and copy two texels: half turn, how far the foot is moved
vec3 swingOf(int b, int i, int copy) {
  int at = 2 * b + i;
  return texelFetch(swings, ivec2(at % ${WIDTH}, at / ${WIDTH} + copy * BONE_ROWS), 0).xyz;
}
vec3 swung(vec3 v, vec3 arm) { return 2.0 * cross(v, cross(v, arm) + sqrt(1.0 - dot(v, v)) * arm); }
${GUST}
void main() {
  int copy = int(gl_FragCoord.y) / ROWS;
  int vertex = (int(gl_FragCoord.y) - copy * ROWS) * ${WIDTH} + int(gl_FragCoord.x);
  if (vertex >= VERTICES) discard;
  vec4 place = texelFetch(places, ivec2(vertex % ${WIDTH}, vertex / ${WIDTH}), 0);
  int b = int(place.w);
  vec4 foot = texelFetch(feet, ivec2(b % ${WIDTH}, b / ${WIDTH}), 0);
  vec3 arm = place.xyz - foot.xyz;
  float share = 2.0 * fract(place.w);
  vec3 moved = swung(swingOf(b, 0, copy), arm);
  if (share > 0.0) moved = mix(moved, swung(swingOf(int(foot.w + 0.5), 0, copy), arm), share);
  gl_FragColor = vec4(gustAt(place.xy) * (swingOf(b, 1, copy) + moved), 0.0);
}`;

export class Field {
  /** Of the contents of a surface file, `copies` times; a field of the same surface lends its textures `own`. */
  constructor(surface, copies = 1, own = null) {
    this.surface = surface;
    this.isCopy = Boolean(own);
    this.own = own ?? texturesOf(surface);
    this.rows = Math.ceil(surface.turn_bone.length / WIDTH); // of one copy
    const boneRows = Math.ceil((2 * surface.turn_parent.length) / WIDTH);
    this.swings = texture(new Float32Array(4 * WIDTH * boneRows * copies));
    this.pass = new Pass({
      width: WIDTH,
      height: copies * this.rows,
      fragmentShader: DISPLACEMENT,
      defines: { VERTICES: surface.turn_bone.length, ROWS: this.rows, BONE_ROWS: boneRows },
      uniforms: {
        places: { value: this.own.places },
        feet: { value: this.own.feet },
        swings: { value: this.swings },
        gust: { value: new THREE.Vector4() },
        gustCalm: { value: 1 },
      },
    });
    this.ofCopy = Array.from({ length: copies }, (_, i) => this.swings.image.data.subarray(4 * WIDTH * boneRows * i));
  }

  /** The same surface several times, one below the other. */
  copied(copies) {
    return new Field(this.surface, copies, this.own);
  }

  get target() {
    return this.pass.target;
  }

  get texture() {
    return this.target.texture;
  }

  /** See Gust.after. */
  blow({ gust, calm } = still()) {
    const { uniforms } = this.pass.material;
    uniforms.gust.value.set(...gust);
    uniforms.gustCalm.value = calm;
  }

  /** Take the motion of each copy, see `swingBones`. */
  swing(motions) {
    for (const [copy, motion] of motions.entries()) swingBones(this.surface, motion, this.ofCopy[copy]);
    this.swings.needsUpdate = true;
  }

  /** Write the displacements of now; those of the moment in which the shadow map was drawn last. */
  render(renderer, { moved, castMoved }) {
    this.pass.render(renderer, castMoved.value);
    moved.value = this.texture;
    if (renderer.shadowMap.needsUpdate) castMoved.value = moved.value;
  }

  dispose() {
    for (const resource of [this.swings, this.pass]) resource.dispose();
    if (!this.isCopy) for (const resource of Object.values(this.own)) resource.dispose();
  }
}

function texturesOf({ vertices, turn_parent, turn_foot_m, turn_bone, turn_share }) {
  return {
    feet: placesTexture(turn_foot_m, (b) => turn_parent[b]),
    places: placesTexture(vertices, (v) => turn_bone[v] + Math.min(turn_share[v] / 2, 0.499)),
  };
}

/** Places [P, 3] as a texture; `fourth(row)` goes to alpha. */
function placesTexture(places, fourth) {
  const P = places.length / 3;
  const texels = floats(4 * P);
  for (let row = 0; row < P; row++) {
    texels.set(places.subarray(3 * row, 3 * row + 3), 4 * row);
    texels[4 * row + 3] = fourth(row);
  }
  return texture(texels);
}

/** Room for so many numbers, in whole rows of a texture. */
export const floats = (count) => new Float32Array(4 * WIDTH * Math.max(1, Math.ceil(count / 4 / WIDTH)));

/** Whole rows of texels, of four floats each unless `type` says otherwise. */
export function texture(texels, type = /** @type {THREE.TextureDataType} */ (THREE.FloatType)) {
  const made = new THREE.DataTexture(texels, WIDTH, texels.length / 4 / WIDTH, THREE.RGBAFormat, type);
  made.needsUpdate = true;
  return made;
}

// ---- what a vertex shader needs to stand where the field and the bones carry it

export const DISPLACE = /* glsl */ `
uniform highp sampler2D moved, castMoved; // by vertex: displacement now, and when the shadow map was drawn
uniform highp sampler2D poses, castPoses; // three texels a bone: rows of [R | t]
uniform int bent, castBent;               // 1 where something is pushed
#ifdef USE_INSTANCING
uniform int copyRows;                     // texels below each other of one copy
int firstRow() { return gl_InstanceID * copyRows; }
#else
int firstRow() { return 0; }
#endif
vec3 movedAt(highp sampler2D field, int vertex) {
  return texelFetch(field, ivec2(vertex % ${WIDTH}, vertex / ${WIDTH} + firstRow()), 0).xyz;
}
vec4 poseRow(highp sampler2D rows, int at) { return texelFetch(rows, ivec2(at % ${WIDTH}, at / ${WIDTH}), 0); }
mat4 poseOf(highp sampler2D rows, int bone) {
  vec4 last = vec4(0.0, 0.0, 0.0, 1.0);
  return transpose(mat4(poseRow(rows, 3 * bone), poseRow(rows, 3 * bone + 1), poseRow(rows, 3 * bone + 2), last));
}`;
