// The voxel view: a cube for each voxel that is seen, which moves with a vertex in or near it; one draw.

import * as THREE from "three";
import { makeFollow } from "./follow.js";

/** A mesh of a tree's voxels. */
export function buildCubes({ modes, vertexOf, uniforms }) {
  const geometry = cubeGeometry(modes, vertexOf, visibleVoxels(modes));
  const cubes = new THREE.Mesh(geometry, makeFollow(new THREE.MeshLambertMaterial(), uniforms, "cubes"));
  cubes.customDepthMaterial = makeFollow(new THREE.MeshDepthMaterial(), uniforms, "cubes");
  cubes.castShadow = cubes.receiveShadow = true;
  cubes.frustumCulled = false;
  return cubes;
}

export function disposeCubes(cubes) {
  for (const part of [cubes.geometry, cubes.material, cubes.customDepthMaterial]) part.dispose();
}

/** Rows of the voxels that have a free side. */
export function visibleVoxels({ coords, V }) {
  const key = (x, y, z) => (x * 1024 + y) * 1024 + z;
  const occupied = new Set();
  for (let v = 0; v < V; v++) occupied.add(key(coords[3 * v], coords[3 * v + 1], coords[3 * v + 2]));
  const free = (x, y, z) => !occupied.has(key(x, y, z));
  const rows = [];
  for (let v = 0; v < V; v++) {
    const [x, y, z] = coords.subarray(3 * v, 3 * v + 3);
    const open = free(x - 1, y, z) || free(x + 1, y, z) || free(x, y - 1, z) || free(x, y + 1, z);
    if (open || free(x, y, z - 1) || free(x, y, z + 1)) rows.push(v);
  }
  return rows;
}

/** A box for each of `rows`: its centre, and the vertex and the joint that it moves with. */
function cubeGeometry({ centres, joint_of_voxel, voxelSize }, vertexOf, rows) {
  const box = new THREE.BoxGeometry(voxelSize, voxelSize, voxelSize);
  const geometry = new THREE.InstancedBufferGeometry();
  geometry.setIndex(box.index);
  for (const name of ["position", "normal"]) geometry.setAttribute(name, box.attributes[name]);
  const perCube = (name, width, of) => {
    const values = new Float32Array(rows.flatMap(of));
    geometry.setAttribute(name, new THREE.InstancedBufferAttribute(values, width));
  };
  perCube("centre", 3, (v) => [...centres.subarray(3 * v, 3 * v + 3)]);
  perCube("carrier", 2, (v) => [vertexOf[v], joint_of_voxel[v]]);
  return geometry;
}
