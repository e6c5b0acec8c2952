// What the page begins with: the stage, and on it the welcome's tree. The rest of the page is loaded once it is drawn.

import { Problem } from "../client/problem.js";
import { Stage } from "../draw/stage.js";
import { $ } from "./dom.js";
import { runFrames } from "./frames.js";
import { Hand } from "./hand.js";
import { layOut, showGrips } from "./layout.js";
import { LiveTree } from "./live.js";
import { Player } from "./player.js";
import { showProblem } from "./problem.js";
import { Scene } from "./scene.js";
import { translate } from "./texts.js";
import { applyTheme, dress } from "./theme.js";

const LATEST_MS = 2000; // neither picture nor rest waits longer for the tree, without which the page works as well

/** Draw the welcome's tree from its `files`, or open a job by a `fetch` that has asked for it; gives the page's parts. */
export async function begin({ files = null, fetch = null }) {
  translate();
  applyTheme();
  const stage = newStage();
  const hand = new Hand(stage, { onGrab: (places) => showGrips(stage, places), onProblem: showProblem });
  const player = new Player(hand);
  const scene = new Scene(stage);
  const live = new LiveTree(scene, files, {
    onMotion: ({ tree, source, spectrum }) => {
      hand.take(tree, source);
      player.start(tree, spectrum, { atRest: false });
      document.body.dataset.live = "true";
    },
  });
  const parts = { stage, hand, player, scene, live, fetch };
  parts.onDraw = async () => {
    parts.onDraw = () => {};
    const { App } = await import("../app.js");
    new App(parts);
  };
  dress(stage);
  layOut(stage, "welcome");
  setTimeout(() => parts.onDraw(), LATEST_MS);
  const begun = fetch ? parts.onDraw() : live.show(); // an empty stage is not drawn before
  await Promise.race([begun, new Promise((resolve) => setTimeout(resolve, LATEST_MS))]).catch(() => {});
  runFrames(parts);
  return parts;
}

function newStage() {
  try {
    return new Stage($("canvas"), { onContext: (lost) => ($("context-lost").hidden = !lost) });
  } catch (error) {
    showProblem(new Problem({ code: "no-webgl", detail: error.message }));
    throw error;
  }
}
