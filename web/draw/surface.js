// The mesh as it is drawn: geometry from a surface file, materials whose vertices follow the field and the bones.

import * as THREE from "three";
import { carriersOf } from "../motion/grip.js";
import { readTensors } from "../motion/tensors.js";
import { softenFoliage } from "./foliage.js";

const BESIDE = 0.4; // of the plant's size
const SCENE = 2.5; // of the plant's size: what is no larger is seen whole

/** `{ geometry, materials, box, ... }` of the body of …/surface. */
export async function readSurface(buffer) {
  const { tensors, shape, metadata } = readTensors(buffer);
  const materials = JSON.parse(metadata.materials);
  const textures = await Promise.all(materials.map((_, index) => readTexture(tensors[`texture_${index}`])));
  const wind = JSON.parse(metadata.wind ?? "null") ?? { speed_m_s: 5, direction_deg: 0 };
  const surface = { ...tensors, N: shape.vertices[0], F: shape.faces[0], materials, textures, wind };
  return Object.assign(surface, { geometry: buildGeometry(surface) });
}

async function readTexture(bytes) {
  if (!bytes) return null;
  const picture = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  const texture = new THREE.Texture(picture);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.flipY = false; // v runs downward, as in glTF
  texture.anisotropy = 4;
  texture.needsUpdate = true;
  return texture;
}

function buildGeometry(surface) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(surface.vertices, 3));
  if (surface.uv) geometry.setAttribute("uv", new THREE.BufferAttribute(surface.uv, 2));
  geometry.setAttribute("still", new THREE.BufferAttribute(surface.still ?? new Uint8Array(surface.N), 1));
  geometry.setAttribute("share", new THREE.BufferAttribute(new Float32Array(surface.N), 1));
  surface.joints = new Float32Array(3 * surface.N); // WebGL takes no 32-bit integers here
  geometry.setAttribute("joints", new THREE.BufferAttribute(surface.joints, 3));
  const { index, groups } = byMaterial(surface);
  geometry.setIndex(new THREE.BufferAttribute(index, 1));
  for (const [start, count, material] of groups) geometry.addGroup(start, count, material);
  geometry.computeVertexNormals();
  geometry.computeBoundingBox();
  surface.box = seenBox(surface, geometry.boundingBox);
  softenFoliage(geometry, surface);
  return geometry;
}

/** The box of the plant, and of what stands still as far as it is near: a pot or an island whole, of a sea a little. */
export function seenBox({ vertices, still, N }, whole) {
  if (!still) return whole;
  const plant = new THREE.Box3();
  const at = new THREE.Vector3();
  for (let v = 0; v < N; v++) if (!still[v]) plant.expandByPoint(at.fromArray(vertices, 3 * v));
  return plant.isEmpty() || sizeOf(whole) < SCENE * sizeOf(plant) ? whole : nearBox(plant, whole);
}

/** A box, and as much of a larger one as is near it. */
export function nearBox(box, whole) {
  const near = box.clone().expandByScalar(BESIDE * sizeOf(box));
  return near.intersect(whole).union(box);
}

const sizeOf = (box) => box.getSize(new THREE.Vector3()).length();

/** The joints of what is pulled that carry each vertex, and the share of the second; the ground's of what is no plant. */
export function carryByJoints(surface, modes) {
  for (let v = 0; v < surface.N; v++) {
    const [joints, [, share]] = carriersOf(modes, surface, v);
    surface.joints.set([...joints, share], 3 * v);
  }
  surface.geometry.attributes.joints.needsUpdate = true;
}

/** Faces sorted by material: one draw each. */
function byMaterial({ faces, face_material: of, F, materials }) {
  if (!of || materials.length < 2) return { index: new Uint32Array(faces), groups: [[0, 3 * F, 0]] };
  const start = new Uint32Array(materials.length + 1);
  for (let f = 0; f < F; f++) start[of[f] + 1]++;
  for (let m = 0; m < materials.length; m++) start[m + 1] += start[m];
  const index = new Uint32Array(3 * F);
  const next = start.slice();
  for (let f = 0; f < F; f++) index.set(faces.subarray(3 * f, 3 * f + 3), 3 * next[of[f]]++);
  return {
    index,
    groups: materials.map((_, m) => [3 * start[m], 3 * (start[m + 1] - start[m]), m]).filter(([, count]) => count),
  };
}
