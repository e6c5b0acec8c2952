// A place of the tree that is pulled: the point that is drawn there, and the bones that carry it.

import { bonesOfGaussian, gaussianInWind } from "./gaussian.js";
import { carried } from "./modes.js";
import { nearest, plus, rowOf } from "./vectors.js";
import { vertexInWind } from "./vertex.js";

/** The place to pull at a voxel of a Tree. */
export function gripAt({ modes, surface, hidden, splat }, voxel) {
  if (splat?.visible) return gripOfGaussian(modes, splat.ride, voxel);
  return surface && !hidden && !splat ? gripOfSurface(modes, surface.geometry, voxel) : gripOfVoxel(modes, voxel);
}

/** Where the wind alone has a place that is pulled [m]. */
export function gripInWind(tree, place, q, turn) {
  const { voxel, vertex, gaussian, rest } = place;
  if (gaussian !== undefined) return gaussianInWind(tree.splat.ride, gaussian, q, turn);
  if (vertex === undefined) return tree.modes.voxelInWind(voxel, q, turn);
  return plus(rest, vertexInWind(tree, vertex, q, turn));
}

/** Where it is now [m]. */
export function gripNow(tree, place) {
  const at = gripInWind(tree, place, tree.q, tree.turn);
  return tree.groups.length ? carriedPoint(tree.boneMotion, place, at) : at;
}

/** The voxel itself, where no surface is drawn. */
export const gripOfVoxel = (modes, voxel) => ({
  voxel,
  rest: Array.from(modes.centres.subarray(3 * voxel, 3 * voxel + 3)),
  bones: [modes.bone_of_voxel[voxel]],
  weights: [1],
});

/**
 * The drawn vertex nearest to a voxel: `{ voxel, vertex, rest, bones, weights }`. Leaves and twigs move with the bone of
 * the place where they hang, so the voxel to pull at is the nearest of the vertex' strongest bone.
 */
function gripOfSurface(modes, geometry, voxel) {
  const own = gripOfVoxel(modes, voxel);
  const vertex = nearest(geometry.getAttribute("position").array, own.rest);
  const [bones, weights] = ["boneRows", "boneWeights"].map((name) => {
    const values = geometry.getAttribute(name);
    return ["getX", "getY", "getZ", "getW"].map((get) => values[get](vertex));
  });
  if (!Math.max(...weights)) return own;
  const rest = rowOf(geometry.getAttribute("position").array, vertex);
  return { voxel: pulledBy(modes, rest, { bones, weights }) ?? voxel, vertex, rest, bones, weights };
}

/** The drawn Gaussian nearest to a voxel: `{ voxel, gaussian, rest, bones, weights }`. */
function gripOfGaussian(modes, ride, voxel) {
  const own = gripOfVoxel(modes, voxel);
  const gaussian = nearest(ride.means, own.rest, (g) => ride.face_of[g] >= 0);
  if (gaussian === null) return own;
  const carriers = bonesOfGaussian(ride, gaussian);
  if (!carriers.bones.length) return own;
  const rest = rowOf(ride.means, gaussian);
  return { voxel: pulledBy(modes, rest, carriers) ?? voxel, gaussian, rest, ...carriers };
}

/** The voxel at which the service pulls: the nearest of those that the strongest bone carries. */
function pulledBy(modes, rest, { bones, weights }) {
  const strongest = bones[weights.indexOf(Math.max(...weights))];
  return nearest(modes.centres, rest, (v) => modes.bone_of_voxel[v] === strongest);
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
