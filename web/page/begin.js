// What the page begins with: the stage, and on it the welcome's tree. The rest of the page is loaded once it is drawn.

import { Problem } from "../client/problem.js";
import { Stage } from "../draw/stage.js";
import { $ } from "./dom.js";
import { linkedJob } from "./example.js";
import { runFrames } from "./frames.js";
import { Hand } from "./hand.js";
import { layOut, showGrip } from "./layout.js";
import { LiveTree } from "./live.js";
import { Player } from "./player.js";
import { showProblem } from "./problem.js";
import { Scene } from "./scene.js";
import { translate } from "./texts.js";
import { applyTheme, currentTheme } from "./theme.js";

const LATEST_MS = 2000; // neither picture nor rest waits longer for the tree, without which the page works as well

translate();
applyTheme();
export const stage = newStage();
export const hand = new Hand(stage, {
  onGrab: (point, pointer) => showGrip(stage, point, pointer),
  onProblem: showProblem,
});
export const player = new Player(hand);
export const scene = new Scene(stage);
export const live = new LiveTree(scene, { onMotion: begin });
export const frames = { stage, player, scene, hand, onDraw: loadRest };

function newStage() {
  try {
    return new Stage($("canvas"), { onContext: (lost) => ($("context-lost").hidden = !lost) });
  } catch (error) {
    showProblem(new Problem({ code: "no-webgl", detail: error.message }));
    throw error;
  }
}

function begin({ tree, source, spectrum }) {
  hand.take(tree, source);
  player.start(tree, spectrum, { atRest: false });
  document.body.dataset.live = true;
}

function loadRest() {
  import("../app.js");
}

stage.look(currentTheme());
layOut(stage, "welcome");
setTimeout(loadRest, LATEST_MS);
if (linkedJob()) loadRest();
else await Promise.race([live.show(), new Promise((resolve) => setTimeout(resolve, LATEST_MS))]).catch(() => {});
runFrames(frames);
