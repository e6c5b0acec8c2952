// The viewer as a library: one tree that sways in a canvas, from the bodies of …/surface and …/modes.
//
//   const { stage, tree, stop } = await viewTree(document.querySelector("canvas"), { surface, modes });

import { Stage } from "./draw/stage.js";
import { readSurface } from "./draw/surface.js";
import { Tree } from "./draw/tree.js";
import { gustyAir } from "./motion/flutter.js";
import { Modes, windCoordinates } from "./motion/modes.js";

export { Client } from "./client.js";
export { Modes, readSurface, Stage, Tree, windCoordinates };

/** Play the wind's loop for ever; the view is turned by dragging. `theme` is "light" or "dark". */
export async function viewTree(canvas, { surface, modes, theme = "light" }) {
  const stage = new Stage(canvas);
  const tree = new Tree(stage);
  stage.look(theme);
  tree.setSurface(await readSurface(surface));
  tree.setModes(new Modes(modes));
  stage.prepare = (renderer) => tree.prepare(renderer);
  const { K, frequencies_hz: hz } = tree.modes;
  stage.renderer.setAnimationLoop((now) => {
    stage.controls.update();
    const phase = ((now / 1000) * hz[1]) % 1;
    tree.swing({ q: windCoordinates(K, phase), turn: 0, air: gustyAir(tree.surface.wind, phase) });
    tree.bend([]);
    stage.draw(now);
  });
  const stop = () => {
    stage.renderer.setAnimationLoop(null);
    tree.dispose();
    stage.renderer.dispose();
  };
  return { stage, tree, stop };
}
