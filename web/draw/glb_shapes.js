// The vertices' own motion out of a job's tree.glb: a large mesh moves by it once the file is written.

import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const LARGEST_BYTES = 100e6; // 270,000 vertices

export const isWorthLoading = ({ name, bytes }) => name === "tree.glb" && bytes <= LARGEST_BYTES;

/**
 * Shapes [N, K, 3, 2] in 16-bit steps of `scale_m` [K], as …/surface has them. The file's morph targets are twice the
 * real and imaginary part of each bin; the first is Re c_0 less all of these parts (docs/formats.md).
 */
export async function readShapes(buffer) {
  const { scene } = await new GLTFLoader().parseAsync(buffer, "");
  let mesh = null;
  scene.traverse((node) => (mesh ??= node.isMesh ? node : null));
  const targets = mesh.geometry.morphAttributes.position.map(({ array }) => array);
  const N = targets[0].length / 3;
  const K = (targets.length + 1) / 2;
  const lean = Float32Array.from(targets[0]);
  for (const part of targets.slice(1)) for (let i = 0; i < lean.length; i++) lean[i] += part[i] / 2;
  const shapes = new Int16Array(6 * N * K);
  const scale_m = new Float32Array(K);
  for (let k = 0; k < K; k++) {
    const parts = k === 0 ? [lean] : [targets[2 * k - 1], targets[2 * k]];
    const step = largestOf(parts) / 32767;
    scale_m[k] = k === 0 ? step : step / 2;
    parts.forEach((part, i) => {
      for (let v = 0; v < N; v++) {
        const at = 6 * (v * K + k) + i;
        shapes[at] = Math.round(part[3 * v] / step);
        shapes[at + 2] = Math.round(-part[3 * v + 2] / step); // glTF's +Y is our +Z
        shapes[at + 4] = Math.round(part[3 * v + 1] / step);
      }
    });
  }
  return { shapes, scale_m };
}

function largestOf(parts) {
  let largest = 1e-12;
  for (const part of parts) for (const value of part) largest = Math.max(largest, Math.abs(value));
  return largest;
}
