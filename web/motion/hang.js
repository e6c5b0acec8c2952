// Where the voxels of a tree hang on its surface: each moves with a vertex in or near it.

import { nearest, plus, rowOf } from "./vectors.js";

const AROUND = [-1, 0, 1].flatMap((x) => [-1, 0, 1].flatMap((y) => [-1, 0, 1].map((z) => [x, y, z])));

/** Of each voxel a vertex in it, else that of the next voxel that has one, else the nearest. */
export function verticesNear({ coords, centres, voxelSize, origin, V }, vertices) {
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
