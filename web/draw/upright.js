// Which way is up: from a file's axes to ours, +Z up.

import * as THREE from "three";

/** Rows are where a file's axes go; the same table as in dynamictree/up_axis.py. */
const TO_Z_UP = {
  "+X": [0, 1, 0, 0, 0, 1, 1, 0, 0],
  "-X": [0, 0, 1, 0, 1, 0, -1, 0, 0],
  "+Y": [1, 0, 0, 0, 0, -1, 0, 1, 0],
  "-Y": [1, 0, 0, 0, 0, 1, 0, -1, 0],
  "+Z": [1, 0, 0, 0, 1, 0, 0, 0, 1],
  "-Z": [1, 0, 0, 0, -1, 0, 0, 0, -1],
};

const FLAT = 0.1; // height of what lies, in its own width or the tree's height

export const AXES = Object.keys(TO_Z_UP);

/** The rotation of a file whose `axis`, or direction such as "0.17,-0.97,0.17", is up. */
export function toZUp(axis) {
  if (axis in TO_Z_UP) return new THREE.Matrix3().fromArray(TO_Z_UP[axis]).transpose();
  const up = new THREE.Vector3(...axis.split(",").map(Number)).normalize();
  const along = (name) => "XYZ".indexOf(name[1]);
  const share = (name) => (name[0] === "+" ? 1 : -1) * up.getComponent(along(name));
  const nearest = toZUp(AXES.reduce((best, name) => (share(name) > share(best) ? name : best)));
  const z = new THREE.Vector3(0, 0, 1);
  const turn = new THREE.Quaternion().setFromUnitVectors(up.applyMatrix3(nearest), z);
  const matrix = new THREE.Matrix4().makeRotationFromQuaternion(turn);
  return new THREE.Matrix3().setFromMatrix4(matrix).multiply(nearest);
}

/** `{ object, box }`: an object of a file whose `axis` is up, turned; `box` is its own where three.js knows none. */
export function makeUpright(object, axis, box = null) {
  const turned = new THREE.Group();
  turned.add(object);
  turned.matrixAutoUpdate = false;
  turned.matrix.setFromMatrix3(toZUp(axis));
  turned.updateMatrixWorld(true);
  return { object: turned, box: box ? box.clone().applyMatrix4(turned.matrix) : boxOfStanding(turned) };
}

/** The box of what stands: a plane of ground or water around a tree is no part of its size. */
function boxOfStanding(object) {
  const boxes = [];
  object.traverse((node) => node.geometry && boxes.push(new THREE.Box3().setFromObject(node, true)));
  const size = (box) => box.getSize(new THREE.Vector3());
  const tallest = Math.max(...boxes.map((box) => size(box).z));
  const standing = boxes.filter((box) => size(box).z > FLAT * Math.max(size(box).x, size(box).y, tallest));
  return (standing.length ? standing : boxes).reduce((all, box) => all.union(box), new THREE.Box3());
}
