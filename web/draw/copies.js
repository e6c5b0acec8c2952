// The same tree several times, each with coordinates of its own: one field for all of them, one draw.

import * as THREE from "three";
import { surfaceMaterials, uniformsAt } from "./follow.js";

export class Copies {
  /** Of a Tree; `places` are `{ x, y, yaw, size }` as of motion/company.js. */
  constructor({ surface, field, box, still }, places) {
    Object.assign(this, { places, one: box });
    this.field = field.copied(places.length);
    this.uniforms = { ...uniformsAt(still), copyRows: { value: this.field.rows } };
    const { lit, depth } = surfaceMaterials(surface, this.uniforms);
    this.mesh = new THREE.InstancedMesh(surface.geometry, lit, places.length);
    this.mesh.customDepthMaterial = depth;
    this.mesh.castShadow = this.mesh.receiveShadow = true;
    this.mesh.frustumCulled = false;
    const foot = footOf(box);
    places.forEach((place, i) => {
      this.mesh.setMatrixAt(i, matrixOf(place, foot));
    });
  }

  /** The box of all of them [m]. */
  get box() {
    const all = new THREE.Box3();
    const at = new THREE.Matrix4();
    this.places.forEach((_, i) => {
      this.mesh.getMatrixAt(i, at);
      all.union(this.one.clone().applyMatrix4(at));
    });
    return all;
  }

  /** One motion a copy: see `swingBones`. */
  move(motions) {
    this.field.swing(motions);
  }

  prepare(renderer) {
    if (this.mesh.visible) this.field.render(renderer, this.uniforms);
  }

  dispose() {
    this.mesh.removeFromParent();
    this.field.dispose();
    for (const material of [this.mesh.material, this.mesh.customDepthMaterial].flat()) material.dispose();
    this.mesh.dispose();
  }
}

const footOf = ({ min, max }) => new THREE.Vector3((min.x + max.x) / 2, (min.y + max.y) / 2, min.z);

/** Turned and scaled about the foot, then put beside it. */
function matrixOf({ x, y, yaw, size }, foot) {
  const at = new THREE.Matrix4().makeTranslation(foot.x + x, foot.y + y, foot.z);
  const turn = new THREE.Matrix4().makeRotationZ(yaw).scale(new THREE.Vector3(size, size, size));
  return at.multiply(turn).multiply(new THREE.Matrix4().makeTranslation(-foot.x, -foot.y, -foot.z));
}
