// The voxel view: the three faces of each voxel that look at the camera, in one draw.

import * as THREE from "three";
import { makeFollow } from "./follow.js";

const WIDTH = 2048; // texels of a row; draw/follow.js reads with the same
const QUADS = [0, 1, 2].flatMap((axis) => [-1, 1].flatMap((a) => [-1, 1].map((b) => [axis, a, b])));

/** A mesh of voxels; `uniforms.moved` must hold the voxels' displacements. */
export function buildCubes(modes, uniforms) {
  const all = { ...uniforms, voxels: { value: voxelTexture(modes) }, halfSize: { value: modes.voxelSize / 2 } };
  const cubes = new THREE.Mesh(cubeGeometry(visibleVoxels(modes)), makeFollow(litMaterial(), all, "cubes"));
  const depth = new THREE.MeshDepthMaterial({ side: THREE.DoubleSide });
  cubes.customDepthMaterial = makeFollow(depth, all, "cubes");
  cubes.castShadow = cubes.receiveShadow = true;
  cubes.frustumCulled = false;
  return cubes;
}

export function disposeCubes(cubes) {
  cubes.geometry.dispose();
  cubes.material.dispose();
  cubes.customDepthMaterial.dispose();
}

const litMaterial = () => new THREE.MeshLambertMaterial({ side: THREE.DoubleSide, shadowSide: THREE.DoubleSide });

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

function cubeGeometry(rows) {
  const corners = new Int8Array(rows.length * 36);
  const voxelRow = new Float32Array(rows.length * 12);
  const index = new Uint32Array(rows.length * 18);
  const quads = QUADS.flat();
  rows.forEach((row, i) => {
    corners.set(quads, 36 * i);
    voxelRow.fill(row, 12 * i, 12 * i + 12);
    for (let face = 0; face < 3; face++) {
      const first = 12 * i + 4 * face;
      index.set([first, first + 1, first + 2, first + 2, first + 1, first + 3], 18 * i + 6 * face);
    }
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
  // unused, but without normals three.js shades flat and declares none
  geometry.setAttribute("normal", new THREE.BufferAttribute(new Int8Array(corners.length), 3, true));
  geometry.setAttribute("voxelRow", new THREE.BufferAttribute(voxelRow, 1));
  geometry.setIndex(new THREE.BufferAttribute(index, 1));
  return geometry;
}

function voxelTexture({ centres, bone_of_voxel: bones, V }) {
  const texels = new Float32Array(4 * WIDTH * Math.ceil(V / WIDTH));
  for (let v = 0; v < V; v++) {
    texels.set(centres.subarray(3 * v, 3 * v + 3), 4 * v);
    texels[4 * v + 3] = bones[v];
  }
  const texture = new THREE.DataTexture(texels, WIDTH, texels.length / 4 / WIDTH, THREE.RGBAFormat, THREE.FloatType);
  texture.needsUpdate = true;
  return texture;
}
