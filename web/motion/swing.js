// How the bones of a surface swing in the wind, as numbers. docs/engines.md has the equations.

import { flutterOf } from "./flutter.js";
import { cross, dot, minus, plus, rowOf, scaled, turnedUpright } from "./vectors.js";

/**
 * Of each bone its half turn and how far its foot moves [m], each with a fourth number that is not used, into `swings` [B, 2, 4].
 * `q` are the wind's coordinates, `turn` is its direction against its motion's [rad], `air` see `gustyAir`. Parents come
 * before children.
 */
export function swingBones(surface, { q, turn, air }, swings) {
  const { turn_parent: parent, turn_foot_m: feet } = surface;
  const vectorAt = (i) => [swings[i], swings[i + 1], swings[i + 2]];
  for (let b = 0; b < parent.length; b++) {
    swings.set(halfTurnOf(surface, b, q, turn, air ? flutterOf(surface, b, air) : [0, 0, 0]), 8 * b);
    const above = parent[b];
    if (above < 0) continue;
    const arm = minus(rowOf(feet, b), rowOf(feet, above));
    swings.set(plus(vectorAt(8 * above + 4), swung(vectorAt(8 * above), arm)), 8 * b + 4);
  }
}

/** Displacement of a vertex [m] where the bones swing as `swings` says. */
export function displaced({ turn_parent, turn_foot_m, turn_bone, turn_share, vertices }, vertex, swings) {
  const bone = turn_bone[vertex];
  const share = turn_share[vertex];
  const arm = minus(rowOf(vertices, vertex), rowOf(turn_foot_m, bone));
  const halfTurn = (b) => [swings[8 * b], swings[8 * b + 1], swings[8 * b + 2]];
  const foot = [swings[8 * bone + 4], swings[8 * bone + 5], swings[8 * bone + 6]];
  const own = swung(halfTurn(bone), arm);
  if (!share) return plus(foot, own);
  return plus(foot, plus(scaled(own, 1 - share), scaled(swung(halfTurn(turn_parent[bone]), arm), share)));
}

/** How far bin k alone moves each of these vertices where turns are small [m]: the root of the squares of both its parts. */
export function binSizes(surface, k, vertices) {
  const { turn_shapes, turn_step_rad, turn_parent, turn_foot_m, turn_bone, turn_share } = surface;
  const K = turn_shapes.length / turn_parent.length / 6;
  const sizes = new Float32Array(vertices.length);
  for (const part of [0, 1]) {
    const turn = (bone) => {
      const at = 6 * (bone * K + k) + part;
      return scaled([turn_shapes[at], turn_shapes[at + 2], turn_shapes[at + 4]], turn_step_rad[bone]);
    };
    const feet = [];
    turn_parent.forEach((above, b) => {
      const arm = () => minus(rowOf(turn_foot_m, b), rowOf(turn_foot_m, above));
      feet.push(above < 0 ? [0, 0, 0] : plus(feet[above], cross(turn(above), arm())));
    });
    vertices.forEach((vertex, i) => {
      const [bone, share] = [turn_bone[vertex], turn_share[vertex]];
      const above = share ? scaled(turn(turn_parent[bone]), share) : [0, 0, 0];
      const theta = plus(scaled(turn(bone), 1 - share), above);
      const moved = plus(feet[bone], cross(theta, minus(rowOf(surface.vertices, vertex), rowOf(turn_foot_m, bone))));
      sizes[i] += dot(moved, moved);
    });
  }
  return sizes.map(Math.sqrt);
}

function halfTurnOf({ turn_shapes, turn_step_rad, turn_direction }, b, q, turn, leaf) {
  const direction = rowOf(turn_direction, b);
  const own = scaled(modeSum(turn_shapes, b, q), turn_step_rad[b]);
  const across = cross(direction, turnedUpright(cross(own, direction), turn));
  return halfTurn(plus(plus(across, scaled(direction, dot(own, direction))), leaf));
}

/** Of a turn by an angle of atan |theta|: its axis times the sine of half the angle. */
export function halfTurn(theta) {
  const c = 1 / Math.sqrt(1 + dot(theta, theta)); // cosine of the angle
  return scaled(theta, c / Math.sqrt(2 + 2 * c));
}

/** How far an arm's end moves. */
function swung(half, arm) {
  const real = Math.sqrt(1 - dot(half, half));
  return scaled(cross(half, plus(cross(half, arm), scaled(arm, real))), 2);
}

/** Re Σ_k φ_k q_k of one row of `shapes` [rows, K, 3, 2]; q is [2K]. */
function modeSum(shapes, row, q) {
  let [x, y, z] = [0, 0, 0];
  for (let i = 0, at = 3 * q.length * row; i < q.length; i += 2, at += 6) {
    const [re, im] = [q[i], q[i + 1]];
    x += shapes[at] * re - shapes[at + 1] * im;
    y += shapes[at + 2] * re - shapes[at + 3] * im;
    z += shapes[at + 4] * re - shapes[at + 5] * im;
  }
  return [x, y, z];
}
