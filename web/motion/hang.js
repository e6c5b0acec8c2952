// Where the files leave mode shapes out: vertices move as their bones say, and each voxel as a vertex in or near it.

import { shapesOfBones } from "./swing.js";
import { nearest, plus, rowOf } from "./vectors.js";

const AROUND = [-1, 0, 1].flatMap((x) => [-1, 0, 1].flatMap((y) => [-1, 0, 1].map((z) => [x, y, z])));

/** Give a surface the shapes of its bones, and Modes those of the surface, once they are asked for. */
export function hang(modes, surface) {
  Object.assign(surface, shapesOfBones(surface));
  hangVoxels(modes, surface);
}

export function hangVoxels(modes, { shapes, scale_m, vertices }) {
  let own = null;
  modes.scale_m = scale_m;
  const made = () => rowsOf(shapes, 6 * modes.K, verticesNear(modes, vertices));
  Object.defineProperty(modes, "shapes", { get: () => (own ??= made()) });
}

/** Of each voxel a vertex in it, else that of the next voxel that has one, else the nearest. */
function verticesNear({ coords, centres, voxelSize, origin, V }, vertices) {
  const key = (x, y, z) => (x * 1024 + y) * 1024 + z;
  const voxelAt = new Map(Array.from({ length: V }, (_, v) => [key(...rowOf(coords, v)), v]));
  const rows = new Int32Array(V).fill(-1);
  const found = [];
  const give = (place, row) => {
    const v = voxelAt.get(key(place[0], place[1], place[2]));
    if (v === undefined || rows[v] >= 0) return;
    rows[v] = row;
    found.push(v);
  };
  for (let i = 0; i < vertices.length; i += 3) {
    const cell = [0, 1, 2].map((c) => Math.floor((vertices[i + c] - origin[c]) / voxelSize));
    give(cell, i / 3);
  }
  for (const v of found) for (const step of AROUND) give(plus(rowOf(coords, v), step), rows[v]); // it grows meanwhile
  return rows.map((row, v) => (row < 0 ? nearest(vertices, rowOf(centres, v)) : row));
}

/** `width` numbers of each of `rows`. */
function rowsOf(values, width, rows) {
  const all = new values.constructor(width * rows.length);
  rows.forEach((row, i) => {
    all.set(values.subarray(width * row, width * row + width), width * i);
  });
  return all;
}
