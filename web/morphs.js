// The vertices' own motion out of a job's tree.glb: what a large mesh hangs on once its files are written.

const LARGEST = 100e6; // bytes of a file that is worth it: 270,000 vertices

export const isWorthLoading = ({ name, bytes }) => name === "tree.glb" && bytes <= LARGEST;

/** Shapes [N, K, 3, 2] in 16-bit steps of `scale_m` [K], as …/surface has them; the targets are Re c_0, then Re and Im of each bin. */
export function readMorphs(buffer, frames) {
  const view = new DataView(buffer);
  const length = view.getUint32(12, true);
  const { accessors, bufferViews, meshes } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length)));
  const targets = meshes[0].primitives[0].targets.map(({ POSITION }) => {
    const { bufferView, byteOffset = 0, count } = accessors[POSITION];
    const start = 28 + length + (bufferViews[bufferView].byteOffset ?? 0);
    return new Float32Array(buffer.slice(start + byteOffset, start + byteOffset + 12 * count));
  });
  const N = targets[0].length / 3;
  const K = (targets.length + 1) / 2;
  const shapes = new Int16Array(6 * N * K);
  const scale_m = new Float32Array(K);
  for (let k = 0; k < K; k++) {
    const parts = k === 0 ? [targets[0]] : [targets[2 * k - 1], targets[2 * k]];
    const most = parts.reduce((far, part) => part.reduce((most, value) => Math.max(most, Math.abs(value)), far), 1e-12);
    const step = most / 32767;
    scale_m[k] = step * (k === 0 || 2 * k === frames ? 1 : 2);
    parts.forEach((part, i) => {
      for (let v = 0; v < N; v++) {
        // glTF's +Y is our +Z
        const at = 6 * (v * K + k) + i;
        shapes[at] = Math.round(part[3 * v] / step);
        shapes[at + 2] = Math.round(-part[3 * v + 2] / step);
        shapes[at + 4] = Math.round(part[3 * v + 1] / step);
      }
    });
  }
  return { shapes, scale_m };
}
