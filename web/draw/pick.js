// Which voxel is under the pointer. Projecting voxels works for meshes and splats alike, and forgives fingers.

import * as THREE from "three";

const PICK_PX = 16; // a finger is not more precise

/** The row of the foremost voxel near the pointer, or null; `exact` looks where the motion has carried it. */
export function pickVoxel(tree, event, { exact = true } = {}) {
  const { modes, stage } = tree;
  const { camera } = stage;
  const box = stage.canvas.getBoundingClientRect();
  camera.updateMatrixWorld();
  const m = new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
  const pointer = { x: event.clientX - box.left, y: event.clientY - box.top };
  const focal = (box.height / 2) * camera.projectionMatrix.elements[5];
  let best = null;
  for (let v = 0; v < modes.V; v++) {
    const [x, y, z] = modes.centres.subarray(3 * v, 3 * v + 3);
    const w = m[3] * x + m[7] * y + m[11] * z + m[15];
    if (w <= 0) continue;
    let at = {
      x: ((m[0] * x + m[4] * y + m[8] * z + m[12]) / w + 1) * 0.5 * box.width,
      y: (1 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / w) * 0.5 * box.height,
      depth: w,
    };
    const slack = PICK_PX + (exact ? (focal * 0.04 * stage.height) / w : 0);
    if (Math.abs(at.x - pointer.x) > slack || Math.abs(at.y - pointer.y) > slack) continue;
    if (exact) at = projected(new THREE.Vector3(...tree.voxelNow(v)), camera, box);
    const distance = Math.hypot(at.x - pointer.x, at.y - pointer.y);
    const size = (focal * modes.voxelSize) / w;
    if (distance > Math.max(size, PICK_PX)) continue;
    const cost = at.depth + (Math.max(distance - size, 0) / PICK_PX) * 0.2 * stage.radius;
    if (!best || cost < best.cost) best = { voxel: v, cost };
  }
  return best?.voxel ?? null;
}

function projected(point, camera, box) {
  const depth = camera.position.distanceTo(point);
  point.project(camera);
  return { x: ((point.x + 1) / 2) * box.width, y: ((1 - point.y) / 2) * box.height, depth };
}

/** The voxel that stands highest. */
export function topVoxel({ centres, V }) {
  let best = 0;
  for (let v = 1; v < V; v++) if (centres[3 * v + 2] > centres[3 * best + 2]) best = v;
  return best;
}
