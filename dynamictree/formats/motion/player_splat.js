// The scene of a page that plays the loop of an animated splat: +Z up, metres.

import { windCoordinates } from "modes";
import { ownRide, readSplat, SplatView } from "splat";
import * as THREE from "three";

const TAIL = 0.01; // of the Gaussians, on each side: floaters do not decide what the camera looks at

export async function show(content, { scene, renderer, camera }) {
  const splat = readSplat(content);
  const box = boxOf(splat);
  const stage = { scene, renderer, camera, radius: box.getSize(new THREE.Vector3()).length() / 2 };
  const none = new THREE.DataTexture(new Float32Array(4), 1, 1, THREE.RGBAFormat, THREE.FloatType);
  none.needsUpdate = true;
  const uniforms = { poses: { value: none }, bent: { value: 0 } };
  const view = await SplatView.make(stage, splat, ownRide(splat, new Float32Array(8 * splat.N)), uniforms);
  const period = splat.frames / splat.fps;
  const seek = (seconds) => view.evaluate(renderer, windCoordinates(splat.K, (seconds / period) % 1), 0);
  return { box, view: new THREE.Vector3(0.38, -0.9, 0.2), up: new THREE.Vector3(0, 0, 1), seek, splat, gaussians: view };
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
