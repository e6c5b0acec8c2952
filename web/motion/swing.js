// How the bones of a surface swing in the wind, as numbers. docs/engines.md has the equations.

import { modeSum } from "./modes.js";
import { cross, dot, minus, plus, rowOf, scaled, turnedUpright } from "./vectors.js";

/**
 * Of each bone its half turn and how far its foot moves [m], each with a fourth number that is not used, into `swings` [B, 2, 4].
 * `q` are the wind's coordinates, `turn` is its direction against its motion's [rad]. Parents come before children.
 */
export function swingBones(surface, q, turn, swings) {
  const { turn_parent: parent, turn_foot_m: feet } = surface;
  const vectorAt = (i) => [swings[i], swings[i + 1], swings[i + 2]];
  for (let b = 0; b < parent.length; b++) {
    swings.set(halfTurnOf(surface, b, q, turn), 8 * b);
    const above = parent[b];
    if (above < 0) continue;
    const arm = minus(rowOf(feet, b), rowOf(feet, above));
    swings.set(plus(vectorAt(8 * above + 4), swung(vectorAt(8 * above), arm)), 8 * b + 4);
  }
}

/** A bone's turn: its axis times the sine of half the angle. */
export function halfTurnOf({ turn_shapes, turn_scale_rad, turn_direction }, b, q, turn) {
  const direction = rowOf(turn_direction, b);
  const own = modeSum(turn_shapes, turn_scale_rad, b, q);
  const across = cross(direction, turnedUpright(cross(own, direction), turn));
  const theta = plus(across, scaled(direction, dot(own, direction)));
  const c = 1 / Math.sqrt(1 + dot(theta, theta)); // cosine of the angle, atan |theta|
  return scaled(theta, c / Math.sqrt(2 + 2 * c));
}

/** How far an arm's end moves. */
export function swung(half, arm) {
  const real = Math.sqrt(1 - dot(half, half));
  return scaled(cross(half, plus(cross(half, arm), scaled(arm, real))), 2);
}
