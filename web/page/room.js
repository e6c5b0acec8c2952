// More room for the tree: full screen, and the page without its controls.

import { $ } from "./dom.js";
import { text } from "./texts.js";

/** `onChange()` once there is more room or less. */
export function watchRoom(onChange) {
  const { body } = document;
  $("fullscreen").hidden = !document.fullscreenEnabled;
  $("fullscreen").onclick = () =>
    document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen();
  $("hide-panel").onclick = () => {
    body.classList.toggle("alone");
    const hidden = body.classList.contains("alone");
    $("hide-panel").setAttribute("aria-pressed", hidden);
    $("hide-panel").setAttribute("aria-label", text(hidden ? "room.show" : "room.hide"));
    onChange();
  };
}
