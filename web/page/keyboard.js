// Keys of the page.

import { hideProblem } from "./problem.js";

const STEP_RAD = 0.12;
const PAN = 0.06; // of what the view sees

export function watchKeys({ stage, hand, player }) {
  const playOrPause = () => player.tree && player.setPlaying(!player.playing);
  const actions = {
    ArrowLeft: () => stage.orbit(-STEP_RAD, 0),
    ArrowRight: () => stage.orbit(STEP_RAD, 0),
    ArrowUp: () => stage.orbit(0, STEP_RAD),
    ArrowDown: () => stage.orbit(0, -STEP_RAD),
    "+": () => stage.orbit(0, 0, 0.9),
    "=": () => stage.orbit(0, 0, 0.9),
    "-": () => stage.orbit(0, 0, 1.1),
    Home: () => stage.home(),
    " ": playOrPause,
    p: () => hand.knock(),
    P: () => hand.knock(),
  };
  const shifted = {
    ArrowLeft: () => stage.pan(-PAN, 0),
    ArrowRight: () => stage.pan(PAN, 0),
    ArrowUp: () => stage.pan(0, PAN),
    ArrowDown: () => stage.pan(0, -PAN),
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
