// A place of the tree that is pulled: the vertex that is drawn there, and the bones that carry it.

import { carried } from "./modes.js";
import { displaced } from "./swing.js";
import { nearest, plus, rowOf } from "./vectors.js";

/**
 * The place to pull at a voxel of a Tree: the nearest vertex that is of the plant, `{ voxel, vertex, rest, bones, weights }`.
 * Leaves and twigs move with the bone of the place where they hang, so the voxel to pull at is the nearest of the vertex'
 * strongest bone. Gaussians ride on the same vertices.
 */
export function gripAt({ modes, surface }, voxel) {
  const { vertices, bone_rows, bone_weights } = surface;
  const at = rowOf(modes.centres, voxel);
  const vertex = nearest(vertices, at, (v) => bone_weights[4 * v] > 0);
  const four = (values) => Array.from(values.subarray(4 * vertex, 4 * vertex + 4));
  const [bones, weights] = [four(bone_rows), four(bone_weights).map((byte) => byte / 255)];
  const strongest = bones[weights.indexOf(Math.max(...weights))];
  const rest = rowOf(vertices, vertex);
  const pulled = nearest(modes.centres, rest, (v) => modes.bone_of_voxel[v] === strongest);
  return { voxel: pulled ?? voxel, vertex, rest, bones, weights };
}

/** Where the wind alone has a place that is pulled [m]. */
export const gripInWind = ({ surface, swings }, { vertex, rest }) => plus(rest, displaced(surface, vertex, swings));

/** Where it is now [m]. */
export function gripNow(tree, place) {
  const at = gripInWind(tree, place);
  return tree.groups.length ? carriedPoint(tree.boneMotion, place, at) : at;
}

/** Where the bones carry a point [m]; what no bone carries stays. */
export function carriedPoint(poses, { bones, weights }, point) {
  const left = 1 - weights.reduce((sum, w) => sum + w, 0);
  return bones.reduce(
    (sum, b, i) => {
      const at = carried(poses, b, point);
      return sum.map((x, c) => x + weights[i] * at[c]);
    },
    point.map((x) => left * x),
  );
}
