// Keys of the page.

import { hideProblem } from "./problem.js";

const STEP_RAD = 0.12;
const PAN_PX = 40;
const ZOOM = 0.9;

export function watchKeys({ stage, hand, player }) {
  const { controls } = stage;
  const playOrPause = () => player.tree && player.setPlaying(!player.playing);
  const actions = {
    ArrowLeft: () => controls.rotateLeft(STEP_RAD),
    ArrowRight: () => controls.rotateLeft(-STEP_RAD),
    ArrowUp: () => controls.rotateUp(STEP_RAD),
    ArrowDown: () => controls.rotateUp(-STEP_RAD),
    "+": () => controls.dollyIn(ZOOM),
    "=": () => controls.dollyIn(ZOOM),
    "-": () => controls.dollyIn(1 / ZOOM),
    Home: () => stage.home(),
    " ": playOrPause,
    p: () => hand.knock(),
    P: () => hand.knock(),
  };
  const shifted = {
    ArrowLeft: () => controls.pan(PAN_PX, 0),
    ArrowRight: () => controls.pan(-PAN_PX, 0),
    ArrowUp: () => controls.pan(0, PAN_PX),
    ArrowDown: () => controls.pan(0, -PAN_PX),
  };
  addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]") || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Escape") return hand.grip ? hand.letGo() : hideProblem();
    const action = (event.shiftKey && shifted[event.key]) || actions[event.key];
    if (/** @type {any} */ (event.target).matches?.("input, button, summary, a, select, textarea") || !action) return;
    event.preventDefault();
    action();
  });
}
