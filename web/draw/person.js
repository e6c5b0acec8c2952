// The outline of a person beside the tree, for its size.

import * as THREE from "three";

const HEIGHT_M = 1.75;
const SEEN_SHARE = 0.85; // of the half width; the first view is turned
const HALF_WIDTH = 0.165; // of the height
const TALLEST_SEEN = 4; // times the tree: a small plant is still to be seen
/** Half of the outline from the feet up, as shares of the height: distance from the middle, height. */
const OUTLINE = [
  [0.02, 0], [0.07, 0], [0.08, 0.03], [0.075, 0.3], [0.1, 0.5], [0.09, 0.6], [0.14, 0.56], [0.165, 0.6],
  [0.15, 0.78], [0.12, 0.82], [0.04, 0.845], [0.035, 0.87], [0.06, 0.91], [0.06, 0.955], [0.035, 0.99], [0, 1],
]; // biome-ignore format: a table

export class Person {
  constructor(stage) {
    this.stage = stage;
    const right = OUTLINE.map(([x, y]) => new THREE.Vector2(x, y));
    const left = right.slice(0, -1).map(({ x, y }) => new THREE.Vector2(-x, y));
    const crotch = [new THREE.Vector2(-0.005, 0.46), new THREE.Vector2(0.005, 0.46)];
    const geometry = new THREE.ShapeGeometry(new THREE.Shape([...right, ...left.reverse(), ...crotch]));
    const material = new THREE.MeshBasicMaterial({
      color: 0x5c6765,
      side: THREE.DoubleSide,
      transparent: true,
      opacity: 0.75,
    });
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.visible = false;
    stage.scene.add(this.mesh);
  }

  /** Stand to the right of the tree as far as that is seen, facing the first view; `scale` where the tree is drawn in another size. */
  show(visible, scale) {
    const height = HEIGHT_M * scale;
    this._showWhole(visible ? height : 0);
    const { box, middle, radius, halfWidth } = this.stage;
    const beside = Math.min(box.max.x + 0.1 * radius, middle.x + SEEN_SHARE * halfWidth - 0.4 * height);
    this.mesh.visible = visible;
    this.stage.surroundings.arrow.material.visible = !visible; // which lies where the person stands
    this.mesh.scale.setScalar(height);
    this.mesh.position.set(beside + 0.2 * height, middle.y - 0.3 * radius, box.min.z);
    this.mesh.rotation.set(Math.PI / 2, 0, 0);
    this.stage.stale = true;
  }

  /** Look from so far that a person who is taller than the tree is seen whole. */
  _showWhole(height) {
    const { box, middle } = this.stage;
    const tall = Math.min(height, TALLEST_SEEN * this.stage.height);
    const right = box.max.x + 2 * HALF_WIDTH * tall;
    const person = new THREE.Box3(
      new THREE.Vector3(right, middle.y, box.min.z),
      new THREE.Vector3(right, middle.y, box.min.z + tall),
    );
    this.stage.seeAlso(tall > this.stage.height ? person : null);
  }
}
