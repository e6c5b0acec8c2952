// The ground: a disc that fades outward, and the shadow on it, in one draw.

import * as THREE from "three";
import { replaced } from "./chunks.js";

const FADE = [1, 0.85, 0.3, 0]; // opacity at these distances from the middle, in shares of the radius
const RINGS = [0, 0.35, 0.7, 1];

// the shadow over the ground over the page, as two discs one above the other would be blended
const SHADE_GROUND = /* glsl */ `
float shade = opacity * (1.0 - getShadowMask());
float covered = soil + shade - soil * shade;
// noise of half a step of the screen's colours, or the slow fade shows its steps
float grain = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5;
gl_FragColor = vec4(ground * (soil * (1.0 - shade) / max(covered, 1e-4)) + grain / 255.0, covered + 1.5 * grain / 255.0);`;

export class Ground extends THREE.Mesh {
  constructor() {
    const material = new THREE.ShadowMaterial({ transparent: true, depthWrite: false });
    const rings = new THREE.LatheGeometry(
      RINGS.map((r) => new THREE.Vector2(r, 0)),
      96,
    ).rotateX(-Math.PI / 2);
    const fades = Float32Array.from({ length: 97 * RINGS.length }, (_, i) => FADE[i % RINGS.length]);
    super(rings.setAttribute("fade", new THREE.BufferAttribute(fades, 1)), material);
    this.tint = new THREE.Color();
    this.receiveShadow = true;
    this.renderOrder = -1;
    material.onBeforeCompile = (shader) => {
      shader.uniforms.ground = { value: this.tint };
      shader.vertexShader = replaced(shader.vertexShader, {
        common: "$&\nattribute float fade; varying float soil;",
        begin_vertex: "$&\nsoil = fade;",
      });
      shader.fragmentShader = replaced(shader.fragmentShader, {
        common: "$&\nvarying float soil; uniform vec3 ground;",
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
