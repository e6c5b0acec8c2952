// The page of a frame: one tree, moving, to be pulled. Its address says which, and how it looks: see README.md.

import { Client } from "../client.js";
import { Stage } from "../draw/stage.js";
import { $, fill } from "../page/dom.js";
import { fetchExample } from "../page/example.js";
import { runFrames } from "../page/frames.js";
import { Hand } from "../page/hand.js";
import { watchKeys } from "../page/keyboard.js";
import { showGrips, showHint } from "../page/layout.js";
import { fetchFolder, fetchParts, partsIn, partsOf, standParts } from "../page/parts.js";
import { Player } from "../page/player.js";
import { Scene } from "../page/scene.js";
import { text, textOrNull, translate } from "../page/texts.js";
import { currentTheme, onSystemTheme } from "../page/theme.js";

const options = new URLSearchParams(location.hash.slice(1));
const client = new Client();

addEventListener("hashchange", () => location.reload());
translate();
const theme = () => (["light", "dark"].includes(options.get("theme")) ? options.get("theme") : currentTheme());
document.documentElement.dataset.theme = theme();
document.body.classList.toggle("transparent", options.has("transparent"));

begin().catch((problem) => {
  fill($("embed-problem"), textOrNull(`problem.${problem.code}`, problem) ?? problem.title ?? text("problem.no-webgl"));
  $("embed-problem").hidden = false;
  tell({ state: "failed", code: problem.code ?? "page" });
});

async function begin() {
  const stage = new Stage($("canvas"));
  const hand = new Hand(stage, { onGrab: (places) => showGrips(stage, places) });
  const player = new Player(hand);
  const scene = new Scene(stage);
  stage.surroundings.ground.visible = !options.has("transparent");
  stage.controls.autoRotate = options.has("turntable");
  stage.look(theme());
  onSystemTheme(() => stage.look(theme()));
  watchKeys({ stage, hand, player });
  runFrames({ stage, player, scene, hand });
  const { tree, source, spectrum } = await standParts(scene, await chosenFiles());
  hand.take(tree, source);
  player.start(tree, spectrum);
  document.body.dataset.state = "moving";
  showHint();
  tell({ state: "moving" });
}

/** The files of what the address names: parts, a job, or nothing, which is the example. */
async function chosenFiles() {
  const { tree: folder, parts: names } = document.body.dataset; // of a page that stands alone on a web server
  if (folder) return fetchFolder(folder, names.split(" "));
  const id = options.get("job");
  const parts = partsIn(options) ?? (id && (await partsOf(client, await client.job(id))));
  return parts ? fetchParts(client, parts) : fetchExample();
}

/** The page around the frame learns the state, and nothing else. */
function tell(message) {
  if (parent !== window) parent.postMessage({ type: "dynamic-tree", ...message }, "*");
}
