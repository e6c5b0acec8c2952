// The ground: a disc that fades outward, and the shadow on it, in one draw.

import * as THREE from "three";
import { replaced } from "./chunks.js";

// opacity by distance from the middle, in shares of the radius
const FADE = /* glsl */ `
varying vec2 onDisc;
float fade() {
  float r = length(onDisc);
  return r < 0.35 ? mix(1.0, 0.85, r / 0.35) : r < 0.7 ? mix(0.85, 0.3, (r - 0.35) / 0.35) : mix(0.3, 0.0, (r - 0.7) / 0.3);
}
uniform vec3 ground;`;

// the shadow over the ground over the page, as two discs one above the other would be blended
const SHADE_GROUND = /* glsl */ `
float shade = opacity * (1.0 - getShadowMask());
float soil = max(fade(), 0.0);
float covered = soil + shade - soil * shade;
// noise of half a step of the screen's colours, or the slow fade shows its steps
float grain = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5;
gl_FragColor = vec4(ground * (soil * (1.0 - shade) / max(covered, 1e-4)) + grain / 255.0, covered + 1.5 * grain / 255.0);`;

export class Ground extends THREE.Mesh {
  constructor() {
    const material = new THREE.ShadowMaterial({ transparent: true, depthWrite: false });
    super(new THREE.CircleGeometry(1, 96), material);
    this.tint = new THREE.Color();
    this.receiveShadow = true;
    this.renderOrder = -1;
    material.onBeforeCompile = (shader) => {
      shader.uniforms.ground = { value: this.tint };
      shader.vertexShader = replaced(shader.vertexShader, {
        common: "$&\nvarying vec2 onDisc;",
        begin_vertex: "$&\nonDisc = position.xy;",
      });
      shader.fragmentShader = replaced(shader.fragmentShader, {
        common: `$&\n${FADE}`,
        "gl_FragColor = vec4( color, opacity * ( 1.0 - getShadowMask() ) );": SHADE_GROUND,
        colorspace_fragment: "", // discs are blended as the screen blends them
      });
    };
  }

  /** Its colour, and how dark a full shadow is in [0, 1]. */
  look({ ground, shadow }) {
    this.tint.set(ground).convertLinearToSRGB();
    /** @type {THREE.Material} */ (this.material).opacity = shadow;
  }
}
