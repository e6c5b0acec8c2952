// Shadows: how old one may be before it darkens what throws it, and soft edges that cost less than three.js' own.

import * as THREE from "three";
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

const SAMPLES = 5;
const GOLDEN_ANGLE = 2.399963229728653;

const { shadowmap_pars_fragment: BEFORE } = THREE.ShaderChunk;

/**
 * The same samples of a shadow's edge, turned together by one sine and cosine a pixel where three.js takes one each. In
 * `software` one, between texels, in a loop: software skips one beside the map, as it does not skip a branch.
 */
export function sampleShadows(software) {
  const place = (i) => {
    const radius = Math.sqrt((i + 0.5) / SAMPLES);
    return [Math.cos(i * GOLDEN_ANGLE), Math.sin(i * GOLDEN_ANGLE)].map((share) => (radius * share).toFixed(8));
  };
  const one = "for (int i = int(frustumTest); i > 0; i--) shadow = texture(shadowMap, shadowCoord.xyz);";
  const sampled = software
    ? BEFORE.replace(/if \( frustumTest \) \{[^}]*vogel[^}]*\}/, one)
    : BEFORE.replace(/(float phi = .*);/, "$1; mat2 turned = mat2(cos(phi), sin(phi), -sin(phi), cos(phi));").replace(
        /vogelDiskSample\( (\d), 5, phi \)/g,
        (_, i) => `turned * vec2(${place(Number(i))})`,
      );
  if (sampled.includes("vogelDiskSample( 0") || sampled === BEFORE)
    throw new Error("three.js samples a shadow's edge otherwise now");
  THREE.ShaderChunk.shadowmap_pars_fragment = sampled;
}
