// Shadows: how old one may be before it darkens what throws it, and soft edges that cost less than three.js' own.

import * as THREE from "three";

export const SLACK = 0.012; // of the stage's radius: so far a shadow stays off its surface

/** Whether the wind has moved a Tree further than that since its shadow was drawn. */
export function leavesItsShadow({ swings, shadowed, stage }) {
  if (!shadowed) return true;
  let most = 0; // squared, of the feet of the bones
  for (let i = 4; i < swings.length; i += 8) {
    const [x, y, z] = [swings[i] - shadowed[i], swings[i + 1] - shadowed[i + 1], swings[i + 2] - shadowed[i + 2]];
    most = Math.max(most, x * x + y * y + z * z);
  }
  return Math.sqrt(most) > SLACK * stage.radius;
}

const SAMPLES = 5;
const GOLDEN_ANGLE = 2.399963229728653;

/** The same samples of a shadow's edge, turned together by one sine and cosine a pixel where three.js takes one each. */
export function turnSamplesTogether() {
  const { shadowmap_pars_fragment: before } = THREE.ShaderChunk;
  const place = (i) => {
    const radius = Math.sqrt((i + 0.5) / SAMPLES);
    return [Math.cos(i * GOLDEN_ANGLE), Math.sin(i * GOLDEN_ANGLE)].map((share) => (radius * share).toFixed(8));
  };
  const together = before
    .replace(/(float phi = .*);/, "$1; mat2 turned = mat2(cos(phi), sin(phi), -sin(phi), cos(phi));")
    .replace(/vogelDiskSample\( (\d), 5, phi \)/g, (_, i) => `turned * vec2(${place(Number(i))})`);
  if (together.split("turned").length !== SAMPLES + 2)
    throw new Error("three.js samples a shadow's edge otherwise now");
  THREE.ShaderChunk.shadowmap_pars_fragment = together;
}
