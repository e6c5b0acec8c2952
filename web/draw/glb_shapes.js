// The vertices' own motion out of a job's tree.glb: a large mesh moves by it once the file is written.

import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const LARGEST_BYTES = 100e6; // 270,000 vertices

export const isWorthLoading = ({ name, bytes }) => name === "tree.glb" && bytes <= LARGEST_BYTES;

/**
 * Shapes [N, K, 3, 2] in 16-bit steps of `scale_m` [K], as …/surface has them; null where a skin places the vertices.
 * The file's morph targets are twice the real and imaginary part of each of its L ≥ K bins; the first is Re c_0 less all
 * of these parts (docs/formats.md). Bins from K on, which a sum needs to turn as the bones do, have no coordinate here.
 */
export async function readShapes(buffer, K) {
  const { parser } = await new GLTFLoader().parseAsync(buffer, "");
  const { num_vertices: N, primitives } = parser.json.animations[0].extras;
  if (primitives.some(({ to_z_up_m }) => !to_z_up_m)) return null;
  const L = (parser.json.asset.extras.num_targets + 1) / 2;
  const shapes = new Int16Array(6 * N * K);
  const scale_m = new Float32Array(K);
  const lean = await target(parser, primitives, N, L, 0);
  for (let k = L - 1; k >= 0; k--) {
    const parts =
      k === 0 ? [lean] : await Promise.all([2 * k - 1, 2 * k].map((m) => target(parser, primitives, N, L, m)));
    const step = largestOf(parts) / 32767;
    if (k < K) scale_m[k] = k === 0 ? step : step / 2;
    parts.forEach((part, i) => {
      for (let v = 0; v < N; v++) {
        for (let axis = 0; axis < 3; axis++) {
          const value = part[3 * v + axis];
          if (k < K) shapes[6 * (v * K + k) + 2 * axis + i] = Math.round(value / step);
          if (k > 0) lean[3 * v + axis] += value / 2;
        }
      }
    });
  }
  return { shapes, scale_m };
}

/** Target m of ours, the last 2L - 1 of each primitive, for all vertices of the mesh: +Z up and in metres. */
async function target(parser, primitives, N, L, m) {
  const moved = new Float32Array(3 * N);
  for (const { node, primitive, first_vertex, to_z_up_m: a } of primitives) {
    const { targets } = parser.json.meshes[parser.json.nodes[node].mesh].primitives[primitive];
    const accessor = targets[targets.length - (2 * L - 1) + m].POSITION;
    const { array } = await parser.getDependency("accessor", accessor);
    for (let i = 0; i < array.length; i += 3) {
      const [x, y, z] = [array[i], array[i + 1], array[i + 2]];
      const at = 3 * first_vertex + i;
      for (let axis = 0; axis < 3; axis++) {
        moved[at + axis] = a[3 * axis] * x + a[3 * axis + 1] * y + a[3 * axis + 2] * z;
      }
    }
  }
  return moved;
}

function largestOf(parts) {
  let largest = 1e-12;
  for (const part of parts) for (const value of part) largest = Math.max(largest, Math.abs(value));
  return largest;
}
