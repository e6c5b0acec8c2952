// The page's sky, drawn behind the tree where WebGL runs in software: under a canvas it takes a browser longer there.

import * as THREE from "three";

export class Sky extends THREE.Mesh {
  constructor() {
    const material = new THREE.ShaderMaterial({
      uniforms: { colours: { value: [new THREE.Color(), new THREE.Color()] }, share: { value: 1 } },
      vertexShader: `uniform float share; varying float down;
void main() { down = share * (0.5 - 0.5 * position.y); gl_Position = vec4(position.xy, 1.0, 1.0); }`,
      fragmentShader: `uniform vec3 colours[2]; varying float down;
void main() { gl_FragColor = vec4(mix(colours[0], colours[1], min(down / 0.72, 1.0)), 1.0); }`,
      depthWrite: false,
    });
    super(new THREE.PlaneGeometry(2, 2), material);
    this.uniforms = material.uniforms; // `share` is that of the window's height which the canvas has, from the top
    Object.assign(this, { frustumCulled: false, renderOrder: 1, visible: false }); // where nothing else was drawn
  }

  /** In two colours of CSS, at the top and towards the horizon, or not at all. */
  look(colours) {
    this.visible = Boolean(colours);
    for (const i in colours || []) this.uniforms.colours.value[i].set(colours[i]).convertLinearToSRGB();
  }
}
