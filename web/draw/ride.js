// How a splat's Gaussians ride on its mesh: with the bones of the page's surface where it has them, so that they bend.

import { nearest } from "../motion/vectors.js";
import { vertexInWind } from "../motion/vertex.js";
import { ownRide } from "./splat.js";

/** Of a splat on a tree, whose surface is that of the splat's mesh. */
export function rideOf(splat, { surface, modes, field }) {
  const rows = rowsOnSurface(splat, surface);
  if (!surface.turn_parent || rows.includes(-1)) return ownRide(splat, carriersOf(splat, surface, modes, rows));
  const { means, face_of, weights } = splat;
  const carriers = new Float32Array(8 * surface.N);
  for (let row = 0; row < surface.N; row++) setCarrier(carriers, row, surface, row);
  return {
    means,
    face_of,
    weights,
    triangles: splat.triangles.map((v) => rows[v]),
    vertices: surface.vertices,
    carriers,
    field,
    borrowed: true,
    inWind: (row, q, turn) => vertexInWind({ surface, modes }, row, q, turn),
  };
}

/** The surface's vertex in the place of each of the splat's; -1 where there is none. */
function rowsOnSurface(splat, surface) {
  const key = (x, v) => `${x[3 * v]} ${x[3 * v + 1]} ${x[3 * v + 2]}`;
  const at = new Map(Array.from({ length: surface.N }, (_, v) => [key(surface.vertices, v), v]));
  return Int32Array.from({ length: splat.N }, (_, v) => at.get(key(splat.vertices, v)) ?? -1);
}

/** Four bones and four weights of each vertex: those of the same place on the surface, else the nearest voxel's bone. */
function carriersOf(splat, surface, modes, rows) {
  const carriers = new Float32Array(8 * splat.N);
  rows.forEach((row, v) => {
    if (row >= 0) setCarrier(carriers, v, surface, row);
    else {
      carriers[8 * v] = modes.bone_of_voxel[nearest(modes.centres, splat.vertices.subarray(3 * v, 3 * v + 3))];
      carriers[8 * v + 4] = 1;
    }
  });
  return carriers;
}

function setCarrier(carriers, v, { bone_rows, bone_weights }, row) {
  for (let i = 0; i < 4; i++) {
    carriers[8 * v + i] = bone_rows[4 * row + i];
    carriers[8 * v + 4 + i] = bone_weights[4 * row + i] / 255;
  }
}
