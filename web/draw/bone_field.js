// Displacement of a mesh whose bones turn in the wind: branches bend however strong it is. docs/engines.md has the equations.

import * as THREE from "three";
import { swingBones } from "../motion/swing.js";
import { Field, placesTexture, shapesTexture, voxelFieldOf, WIDTH } from "./field.js";

const MOTION = /* glsl */ `
uniform highp sampler2D feet;   // by bone: place at rest, parent
uniform highp sampler2D swings; // by bone and copy two texels: half turn, how far the foot is moved
vec3 swingOf(int b, int i, int copy) {
  int at = 2 * b + i;
  return texelFetch(swings, ivec2(at % ${WIDTH}, at / ${WIDTH} + copy * BONE_ROWS), 0).xyz;
}
vec3 swung(vec3 v, vec3 arm) { return 2.0 * cross(v, cross(v, arm) + sqrt(1.0 - dot(v, v)) * arm); }
vec3 motionOf(int point, int copy) {
  vec4 place = placeOf(point); // its fourth number: its bone plus half the parent's share
  int b = int(place.w);
  vec4 foot = texelFetch(feet, ivec2(b % ${WIDTH}, b / ${WIDTH}), 0);
  vec3 arm = place.xyz - foot.xyz;
  float share = 2.0 * fract(place.w);
  vec3 moved = swung(swingOf(b, 0, copy), arm);
  if (share > 0.0) moved = mix(moved, swung(swingOf(int(foot.w + 0.5), 0, copy), arm), share);
  return swingOf(b, 1, copy) + moved;
}`;

export class BoneField extends Field {
  /** Of the contents of a surface file, or of the field that has its textures. */
  constructor(surface, copies = 1, textures = null) {
    const own = textures ?? texturesOf(surface);
    const { scale_m, turn_parent, N } = surface;
    const rows = Math.ceil((2 * turn_parent.length) / WIDTH);
    const swings = texture(floats(rows * copies));
    const motion = MOTION.replaceAll("BONE_ROWS", String(rows));
    const uniforms = { feet: { value: own.feet }, swings: { value: swings } };
    super(own.shapes, scale_m, N, copies, { motion, uniforms, places: own.places });
    Object.assign(this, { surface, own, swings, boneRows: rows, isCopy: Boolean(textures) });
  }

  copied(copies) {
    return new BoneField(this.surface, copies, this.own);
  }

  evaluateAll(renderer, motions) {
    motions.forEach(({ q, turn }, copy) => {
      swingBones(this.surface, q, turn, this.swings.image.data.subarray(4 * WIDTH * this.boneRows * copy));
    });
    this.swings.needsUpdate = true;
    this.pass.render(renderer);
  }

  dispose() {
    if (this.isCopy) this.places = null; // those of the field that it was made of
    super.dispose();
    const shared = this.isCopy ? [] : [this.own.shapes, this.own.feet];
    for (const resource of [this.swings, ...shared]) resource.dispose();
  }
}

/** The field of a surface file's contents: of bones, of modes of the vertices, or of its Modes where the mesh is large. */
export function fieldOf(surface, modes) {
  const N = surface.vertices.length / 3;
  if (surface.turn_parent) return new BoneField({ ...surface, N });
  if (!surface.shapes) return voxelFieldOf(modes);
  return new Field(surface.shapes, surface.scale_m, N, 1, { places: placesTexture(surface.vertices) });
}

function texturesOf({ shapes, scale_m, N, vertices, turn_parent, turn_foot_m, turn_bone, turn_share }) {
  const feet = floats(Math.ceil(turn_parent.length / WIDTH));
  for (let b = 0; b < turn_parent.length; b++) {
    feet.set(turn_foot_m.subarray(3 * b, 3 * b + 3), 4 * b);
    feet[4 * b + 3] = turn_parent[b];
  }
  return {
    shapes: shapes ? shapesTexture(shapes, 3 * N * scale_m.length) : shapesTexture([], 1), // only read where a bin's share is shown
    feet: texture(feet),
    places: placesTexture(vertices, (v) => turn_bone[v] + Math.min(turn_share[v] / 2, 0.499)),
  };
}

/** Room for rows of texels. */
const floats = (rows) => new Float32Array(4 * WIDTH * rows);

function texture(texels) {
  const made = new THREE.DataTexture(texels, WIDTH, texels.length / 4 / WIDTH, THREE.RGBAFormat, THREE.FloatType);
  made.needsUpdate = true;
  return made;
}
