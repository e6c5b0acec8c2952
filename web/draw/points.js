// A cloud at rest as round points: what is seen of a splat or scan until its Gaussians move.

import * as THREE from "three";
import { readTensors } from "../motion/tensors.js";
import { replaced } from "./chunks.js";

export class Points {
  /** `buffer` is the body of …/points: `points` [P, 3] m, `colours` uint8 [P, 3], `radius_m` [P]. */
  constructor(buffer) {
    const { points, colours, radius_m: radius } = readTensors(buffer).tensors;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3, true));
    geometry.setAttribute("radius", new THREE.BufferAttribute(radius, 1));
    geometry.computeBoundingBox();
    this.box = geometry.boundingBox;
    this.object = new THREE.Points(geometry, roundMaterial());
    this.object.frustumCulled = false;
  }

  dispose() {
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}

/** Discs of the colours, which the file has as sRGB, and of each point's own radius, in pixels of the drawing buffer. */
function roundMaterial() {
  const material = new THREE.PointsMaterial({ size: 1, sizeAttenuation: true, vertexColors: true });
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = replaced(shader.vertexShader, {
      common: "$&\nattribute float radius;",
      "gl_PointSize = size;": "gl_PointSize = 2.0 * radius * projectionMatrix[1][1];",
      fog_vertex: "gl_PointSize = max(gl_PointSize, 1.5);\n$&",
    });
    shader.fragmentShader = replaced(shader.fragmentShader, {
      color_fragment:
        "$&\nif (length(gl_PointCoord - 0.5) > 0.5) discard;\ndiffuseColor.rgb = pow(diffuseColor.rgb, vec3(2.2));",
    });
  };
  return material;
}
