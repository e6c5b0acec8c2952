// The scene of a page that plays the loop of an animated splat: +Z up, metres.

import { floats, texture } from "field";
import { gustyAir } from "flutter";
import { windCoordinates } from "modes";
import { readSplat, SplatView } from "splat";
import * as THREE from "three";

const TAIL = 0.01; // of the Gaussians, on each side: floaters do not decide what the camera looks at

export async function show(content, { scene, renderer, camera }) {
  const splat = readSplat(content);
  const box = boxOf(splat);
  const stage = { scene, renderer, camera, radius: box.getSize(new THREE.Vector3()).length() / 2 };
  const N = splat.vertices.length / 3;
  const texels = floats(4 * N);
  const uniforms = { moved: { value: texture(texels) }, poses: { value: texture(floats(4)) }, bent: { value: 0 } };
  const surface = { N, vertices: splat.vertices, joints: new Float32Array(4 * N) }; // nothing is pushed here
  const view = await SplatView.make(stage, splat, surface, uniforms);
  const period = splat.frames / splat.fps;
  const seek = (seconds) => {
    const phase = (seconds / period) % 1;
    const q = windCoordinates(splat.K, phase);
    displace(splat, q, texels);
    uniforms.moved.value.needsUpdate = true;
    view.evaluate(q, 0, splat.wind && gustyAir(splat.wind, phase));
  };
  return { box, view: new THREE.Vector3(0.38, -0.9, 0.2), up: new THREE.Vector3(0, 0, 1), seek, splat, gaussians: view };
}

/** Displacement of each vertex into four numbers of `texels`: Σ w_k Re(c_k q_k), w_k = 1 for the mean and k = T/2, else 2. */
function displace({ coefficients, vertices, K, frames }, q, texels) {
  const weighted = q.map((value, i) => (i < 2 || i >> 1 === frames / 2 ? value : 2 * value));
  for (let v = 0, at = 0; v < vertices.length / 3; v++) {
    const sum = [0, 0, 0];
    for (let k = 0; k < K; k++) {
      for (let c = 0; c < 3; c++, at += 2) {
        sum[c] += coefficients[at] * weighted[2 * k] - coefficients[at + 1] * weighted[2 * k + 1];
      }
    }
    texels.set(sum, 4 * v);
  }
}

/** Of the Gaussians that move, of all where none do. */
function boxOf({ means, face_of: faces, G }) {
  const moving = [...faces.keys()].filter((g) => faces[g] >= 0);
  const rows = moving.length ? moving : [...Array(G).keys()];
  const [low, high] = [new THREE.Vector3(), new THREE.Vector3()];
  for (let c = 0; c < 3; c++) {
    const sorted = Float32Array.from(rows, (g) => means[3 * g + c]).sort();
    const tail = Math.floor(TAIL * sorted.length);
    low.setComponent(c, sorted[tail]);
    high.setComponent(c, sorted[sorted.length - 1 - tail]);
  }
  return new THREE.Box3(low, high);
}
