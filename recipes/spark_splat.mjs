// An animated splat in a scene of three.js with Spark 2: `const tree = await treeSplat(url); scene.add(tree.mesh);`, and
// `tree.play(seconds)` before each frame. Put animated_splat.mjs beside it.

import { ExtSplats, SplatMesh } from "@sparkjsdev/spark";
import { Color, Quaternion, Vector3 } from "three";
import { AnimatedSplat } from "./animated_splat.mjs";

export async function treeSplat(url) {
  const splat = new AnimatedSplat(await (await fetch(url)).arrayBuffer());
  const cloud = new ExtSplats({ maxSplats: splat.count });
  const [at, size, turn] = [new Vector3(), new Vector3(), new Quaternion()];
  const colours = Array.from({ length: splat.count }, (_, g) => new Color(...splat.colour(g)));
  const place = (write, { means, quaternions, scales }) => {
    for (let g = 0; g < splat.count; g++) {
      const [w, x, y, z] = quaternions.subarray(4 * g, 4 * g + 4);
      write(g, at.fromArray(means, 3 * g), size.fromArray(scales, 3 * g), turn.set(x, y, z, w), splat.opacity[g], colours[g]);
    }
    cloud.updateTextures();
  };
  place((_, ...values) => cloud.pushSplat(...values), splat.at(0));
  const mesh = new SplatMesh({ extSplats: cloud });
  mesh.rotation.x = -Math.PI / 2; // +Z of the file is up
  await mesh.initialized;
  const play = (seconds) => {
    place((g, ...values) => cloud.setSplat(g, ...values), splat.at((seconds / splat.seconds) % 1));
    mesh.updateVersion();
  };
  return { mesh, splat, play };
}
