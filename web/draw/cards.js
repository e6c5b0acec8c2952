// Leaf cards and other small parts move rigidly, however far they go: as a sum of modes they would grow in strong wind.

import * as THREE from "three";
import { partsOf } from "./foliage.js";

const MOST_VERTICES = 8; // with no more, a part is a card of any size, as in the products
const SMALL_VOXELS = 8;
const WIDTH = 2048; // of the texture, as of the field's

/** Marks vertices that are in no card. */
export function noCards(N) {
  return new THREE.BufferAttribute(new Float32Array(3 * N).fill(-1), 3);
}

/** Give the geometry three corners of each vertex' card, and return the places of all vertices at rest as a texture. */
export function setCards(surface) {
  surface.geometry.setAttribute("cardRows", new THREE.BufferAttribute(cardCorners(surface), 3));
  const { vertices, N } = surface;
  const places = new Float32Array(4 * WIDTH * Math.ceil(N / WIDTH));
  for (let v = 0; v < N; v++) places.set(vertices.subarray(3 * v, 3 * v + 3), 4 * v);
  const texture = new THREE.DataTexture(places, WIDTH, places.length / 4 / WIDTH, THREE.RGBAFormat, THREE.FloatType);
  texture.needsUpdate = true;
  surface.textures.push(texture); // behind the colours, to be disposed of with them
  return texture;
}

/** Rows of three vertices that say how the card of a vertex moves, the first where it moves least; −1 without a card. */
export function cardCorners(surface) {
  const { N, vertices, shapes, scale_m: scale, box } = surface;
  const parts = new Map();
  partsOf(surface).forEach((part, v) => {
    if (!parts.has(part)) parts.set(part, []);
    parts.get(part).push(v);
  });
  const largest = (SMALL_VOXELS / 128) * Math.max(...box.getSize(new THREE.Vector3()).toArray());
  const corners = new Float32Array(3 * N).fill(-1);
  for (const rows of parts.values()) {
    if (rows.length > MOST_VERTICES && extentOf(vertices, rows) > largest) continue;
    const chosen = threeOf(rows, vertices, (v) => swing(v, shapes, scale));
    if (chosen) for (const v of rows) corners.set(chosen, 3 * v);
  }
  return corners;
}

/** The vertex that moves least, the one that is farthest from it, and the one that is farthest from their line. */
function threeOf(rows, vertices, swingOf) {
  const first = best(rows, (v) => -swingOf(v));
  const [x, y, z] = [0, 1, 2].map((c) => vertices[3 * first + c]);
  const squared = (v) => (vertices[3 * v] - x) ** 2 + (vertices[3 * v + 1] - y) ** 2 + (vertices[3 * v + 2] - z) ** 2;
  const second = best(rows, squared);
  const [ax, ay, az] = [vertices[3 * second] - x, vertices[3 * second + 1] - y, vertices[3 * second + 2] - z];
  const area = (v) => {
    const [bx, by, bz] = [vertices[3 * v] - x, vertices[3 * v + 1] - y, vertices[3 * v + 2] - z];
    return (by * az - bz * ay) ** 2 + (bz * ax - bx * az) ** 2 + (bx * ay - by * ax) ** 2;
  };
  const third = best(rows, area);
  return area(third) > 1e-6 * squared(second) ** 2 ? [first, second, third] : null;
}

function best(rows, scoreOf) {
  let chosen = rows[0];
  let most = -Infinity;
  for (const v of rows) {
    const value = scoreOf(v);
    if (value > most) [chosen, most] = [v, value];
  }
  return chosen;
}

function swing(v, shapes, scale) {
  let power = 0;
  let at = 6 * scale.length * v;
  for (let k = 0; k < scale.length; k++) {
    let sum = 0;
    for (const end = at + 6; at < end; at++) sum += shapes[at] * shapes[at];
    power += sum * scale[k] * scale[k];
  }
  return power;
}

/** The longest side of the box around some vertices. */
function extentOf(vertices, rows) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (const v of rows) {
    for (let c = 0; c < 3; c++) {
      const value = vertices[3 * v + c];
      if (value < low[c]) low[c] = value;
      if (value > high[c]) high[c] = value;
    }
  }
  return Math.max(...high.map((value, c) => value - low[c]));
}

/** What a vertex shader needs: `cardMoved` is the displacement of this vertex with its card. */
export const CARDS = /* glsl */ `
uniform highp sampler2D restAt; // by vertex
attribute vec3 cardRows;
vec3 restOf(int v) { return texelFetch(restAt, ivec2(v % ${WIDTH}, v / ${WIDTH}), 0).xyz; }
mat3 frameOf(vec3 along, vec3 other) {
  vec3 x = normalize(along), z = normalize(cross(x, other));
  return mat3(x, cross(z, x), z);
}
vec3 cardMoved(vec3 own) {
  if (cardRows.x < 0.0) return own;
  ivec3 at = ivec3(cardRows + 0.5);
  vec3 a = restOf(at.x), b = restOf(at.y) - a, c = restOf(at.z) - a, moved = movedAt(at.x).xyz;
  mat3 now = frameOf(b + movedAt(at.y).xyz - moved, c + movedAt(at.z).xyz - moved);
  return a + moved + now * (transpose(frameOf(b, c)) * (position - a)) - position;
}`;
