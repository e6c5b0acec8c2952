// One vertex in the wind as numbers: what the shaders of draw/ compute for all of them.

import { modeSum } from "./modes.js";
import { halfTurnOf, swung } from "./swing.js";
import { dot, frameOf, minus, plus, rowOf, scaled, turnedUpright } from "./vectors.js";

/** Displacement of a vertex of a Tree's surface by the wind [m]; `turn` is the wind's direction against its motion's. */
export function vertexInWind({ surface, modes }, vertex, q, turn) {
  if (surface.turn_parent) return bentBy(surface, vertex, q, turn);
  if (surface.tie_rows) return turnedUpright(tied(surface, modes, vertex, q), turn);
  const inWind = (v) => turnedUpright(modeSum(surface.shapes, surface.scale_m, v, q), turn);
  const corners = rowOf(surface.geometry.getAttribute("cardRows").array, vertex);
  return corners[0] < 0 ? inWind(vertex) : withCard(surface.vertices, corners, vertex, inWind);
}

/** Of a large mesh: the weighted mean of the voxels near the vertex. */
function tied({ tie_rows: rows, tie_weights: weights }, modes, vertex, q) {
  const ties = [0, 1, 2, 3].map((i) => 4 * vertex + i);
  return ties.reduce((sum, at) => plus(sum, scaled(modes.voxelAt(rows[at], q), weights[at] / 255)), [0, 0, 0]);
}

/** Of a leaf card: rigid, as its corners move. draw/cards.js has the equations. */
function withCard(places, corners, vertex, inWind) {
  const [a, b, c] = corners.map((row) => rowOf(places, row));
  const [now, ...others] = corners.map((row, i) => plus([a, b, c][i], inWind(row)));
  const rest = frameOf(minus(b, a), minus(c, a));
  const frame = frameOf(...others.map((at) => minus(at, now)));
  const arm = minus(rowOf(places, vertex), a);
  const carried = rest.reduce((sum, axis, i) => plus(sum, scaled(frame[i], dot(axis, arm))), now);
  return minus(carried, rowOf(places, vertex));
}

/** By the bones that turn in the wind; see motion/swing.js. */
function bentBy(surface, vertex, q, turn) {
  const { turn_parent: parent, turn_foot_m: feet, turn_bone, turn_share, vertices } = surface;
  const bone = turn_bone[vertex];
  const share = turn_share[vertex];
  const halfTurn = (b) => halfTurnOf(surface, b, q, turn);
  const arm = minus(rowOf(vertices, vertex), rowOf(feet, bone));
  let moved = swung(halfTurn(bone), arm);
  if (share > 0) moved = plus(scaled(moved, 1 - share), scaled(swung(halfTurn(parent[bone]), arm), share));
  for (let b = bone; parent[b] >= 0; b = parent[b]) {
    moved = plus(moved, swung(halfTurn(parent[b]), minus(rowOf(feet, b), rowOf(feet, parent[b]))));
  }
  return moved;
}
