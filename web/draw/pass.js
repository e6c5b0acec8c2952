// A program that the GPU runs once for each texel of a texture of floats, which other shaders then read. There are two
// textures, so that one lasts while the other is written.

import * as THREE from "three";

const VERTEX = "void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }";

export class Pass {
  constructor({ width, height, fragmentShader, defines, uniforms }) {
    const type = { type: THREE.FloatType, minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter };
    const make = () => new THREE.WebGLRenderTarget(width, height, { ...type, depthBuffer: false });
    this.targets = [make(), make()];
    this.target = this.targets[0]; // that is written last
    this.material = new THREE.ShaderMaterial({
      defines,
      vertexShader: VERTEX,
      fragmentShader,
      uniforms,
      blending: THREE.NoBlending,
      depthTest: false,
      depthWrite: false,
      toneMapped: false,
    });
    this.square = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), this.material);
    this.square.frustumCulled = false;
    this.camera = new THREE.Camera();
  }

  /** Write the texture that is not `lasting`. */
  render(renderer, lasting = null) {
    this.target = this.targets.find(({ texture }) => texture !== lasting);
    const before = renderer.getRenderTarget();
    const { enabled } = renderer.xr;
    renderer.xr.enabled = false; // or its eyes would look at the square
    renderer.setRenderTarget(this.target);
    renderer.render(this.square, this.camera);
    renderer.setRenderTarget(before);
    renderer.xr.enabled = enabled;
  }

  dispose() {
    for (const resource of [...this.targets, this.material]) resource.dispose();
    this.square.geometry.dispose();
  }
}
