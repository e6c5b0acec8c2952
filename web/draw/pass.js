// A program that the GPU runs once for each texel of a texture of floats, which other shaders then read.

import * as THREE from "three";

const VERTEX = "void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }";

export class Pass {
  constructor({ width, height, fragmentShader, defines, uniforms }) {
    this.target = new THREE.WebGLRenderTarget(width, height, {
      type: THREE.FloatType,
      minFilter: THREE.NearestFilter,
      magFilter: THREE.NearestFilter,
      depthBuffer: false,
    });
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

  render(renderer) {
    const before = renderer.getRenderTarget();
    const { enabled } = renderer.xr;
    renderer.xr.enabled = false; // or its eyes would look at the square
    renderer.setRenderTarget(this.target);
    renderer.render(this.square, this.camera);
    renderer.setRenderTarget(before);
    renderer.xr.enabled = enabled;
  }

  dispose() {
    this.target.dispose();
    this.material.dispose();
    this.square.geometry.dispose();
  }
}
