// A place of the tree that is pulled: the vertex that is drawn there, and the joints that carry it.

import { carried } from "./modes.js";
import { displaced } from "./swing.js";
import { nearest, plus, rowOf, scaled } from "./vectors.js";

/**
 * The place to pull at a voxel of a Tree: the nearest vertex that is of the plant, `{ voxel, vertex, rest, joints,
 * weights }`. The voxel to pull at is the nearest of the vertex' joint, or of the next towards the root that has one.
 * Gaussians ride on the same vertices.
 */
export function gripAt({ modes, surface }, voxel) {
  const { vertices, turn_bone, turn_share } = surface;
  const vertex = nearest(vertices, rowOf(modes.centres, voxel), (v) => turn_bone[v] > 0);
  const [joints, weights] = carriersOf(modes, surface, vertex);
  const rest = rowOf(vertices, vertex);
  let pulled = null;
  for (let j = joints[turn_share[vertex] > 0.5 ? 1 : 0]; pulled === null && j > 0; j = modes.joint_parent[j]) {
    pulled = nearest(modes.centres, rest, (v) => modes.joint_of_voxel[v] === j);
  }
  return { voxel: pulled ?? voxel, vertex, rest, joints, weights };
}

/** Joints of the two bones that carry a vertex, and their shares. */
export function carriersOf({ joint_of_bone }, { turn_bone, turn_parent, turn_share }, vertex) {
  const bone = turn_bone[vertex];
  const joints = [joint_of_bone[bone], joint_of_bone[Math.max(turn_parent[bone], 0)]];
  return [joints, [1 - turn_share[vertex], turn_share[vertex]]];
}

/** Where the wind alone has a place that is pulled [m]. */
export const gripInWind = ({ surface, swings }, { vertex, rest }) => plus(rest, displaced(surface, vertex, swings));

/** Where it is now [m]. */
export function gripNow(tree, place) {
  const at = gripInWind(tree, place);
  return tree.groups.length ? carriedPoint(tree.jointMotion, place, at) : at;
}

/** Where the joints carry a point [m]. */
export const carriedPoint = (poses, { joints, weights }, point) =>
  joints.reduce((sum, j, i) => plus(sum, scaled(carried(poses, j, point), weights[i])), [0, 0, 0]);
