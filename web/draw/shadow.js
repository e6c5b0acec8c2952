// How far a tree may move before its shadow must be drawn anew: a shadow map that is too old darkens what throws it.

export const SLACK = 0.012; // of the stage's radius: so far a shadow stays off its surface

/** Whether the wind has moved a Tree further than that since its shadow was drawn. */
export function leavesItsShadow({ q, turn, shadowed, largest, stage }) {
  if (!shadowed || shadowed.turn !== turn) return true;
  let squares = 0; // the bins' largest motions are taken to meet at one place, not at one time
  for (let i = 0; i < q.length; i++) squares += (largest[i >> 1] * (q[i] - shadowed.q[i])) ** 2;
  return Math.sqrt(squares) > SLACK * stage.radius;
}
