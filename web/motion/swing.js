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

/**
 * Mode shapes of the vertices, `{ shapes, scale_m }` as …/surface has them, out of the bones' turns: for small motions they
 * are the same.
 */
export function shapesOfBones(surface) {
  const { turn_shapes, turn_scale_rad, turn_parent, turn_foot_m, turn_bone, turn_share, vertices } = surface;
  const K = turn_scale_rad.length;
  const [B, N] = [turn_parent.length, vertices.length / 3];
  const feet = new Float32Array(6 * K * B);
  const moved = new Float32Array(6 * K * N);
  const turn = (out, row, bone, share, arm) => {
    for (let k = 0; k < K; k++)
      addTurned(out, 6 * (row * K + k), turn_shapes, 6 * (bone * K + k), share * turn_scale_rad[k], arm);
  };
  for (let b = 0; b < B; b++) {
    const above = turn_parent[b]; // parents come before children
    if (above < 0) continue;
    feet.copyWithin(6 * K * b, 6 * K * above, 6 * K * (above + 1));
    turn(feet, b, above, 1, minus(rowOf(turn_foot_m, b), rowOf(turn_foot_m, above)));
  }
  for (let v = 0; v < N; v++) {
    const [b, share] = [turn_bone[v], turn_share[v]];
    const arm = minus(rowOf(vertices, v), rowOf(turn_foot_m, b));
    moved.set(feet.subarray(6 * K * b, 6 * K * (b + 1)), 6 * K * v);
    turn(moved, v, b, 1 - share, arm);
    if (share > 0) turn(moved, v, turn_parent[b], share, arm);
  }
  return inSteps(moved, K);
}

/** θ × arm of real and imaginary part, θ in steps of `scale` [rad]. */
function addTurned(out, at, turns, from, scale, [ax, ay, az]) {
  for (let i = 0; i < 2; i++) {
    const [x, y, z] = [scale * turns[from + i], scale * turns[from + 2 + i], scale * turns[from + 4 + i]];
    out[at + i] += y * az - z * ay;
    out[at + 2 + i] += z * ax - x * az;
    out[at + 4 + i] += x * ay - y * ax;
  }
}

/** Shapes [rows, K, 3, 2] as 16-bit steps of each bin's own size. */
function inSteps(shapes, K) {
  const scale_m = new Float32Array(K).fill(1e-12);
  const binOf = (i) => Math.floor(i / 6) % K;
  shapes.forEach((value, i) => {
    scale_m[binOf(i)] = Math.max(scale_m[binOf(i)], Math.abs(value) / 32767);
  });
  return { shapes: Int16Array.from(shapes, (value, i) => Math.round(value / scale_m[binOf(i)])), scale_m };
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
