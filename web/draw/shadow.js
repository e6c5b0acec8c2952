// How old a shadow may be before it darkens what throws it.

import { displaced } from "../motion/swing.js";
import { length, minus } from "../motion/vectors.js";

export const SLACK = 0.012; // of the stage's radius: so far a shadow stays off its surface

const SOME = 256; // vertices that stand for all

/** How far the wind moves some vertices of a Tree [m]. */
export function sampleMotion({ surface, swings }) {
  const step = Math.ceil(surface.N / SOME);
  return Array.from({ length: Math.ceil(surface.N / step) }, (_, i) => displaced(surface, step * i, swings));
}

/** Whether the wind has moved a Tree further than that since its shadow was drawn. */
export function leavesItsShadow({ surface, swings, shadowed, stage }) {
  const moved = shadowed && sampleMotion({ surface, swings }).map((now, i) => length(minus(now, shadowed[i])));
  return !moved || Math.max(...moved) > SLACK * stage.radius;
}
