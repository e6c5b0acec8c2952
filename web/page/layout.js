// Where the tree stands between the panels, the ring at the pulled branch, and the hint.

import { $, fill } from "./dom.js";
import { text } from "./texts.js";

const RING_PX = 11;
const HINT_MS = 7000;
const PLAYER_PX = 84;

/** The tree stands in the middle of what the panels leave free. */
export function layOut(stage, state) {
  if (state === "welcome") return stage.clear(besideWelcome());
  const panel = $("panel").getBoundingClientRect();
  const beside = panel.width > 0 && panel.top < innerHeight / 3;
  const card = $("progress").getBoundingClientRect(); // 0 high while it is hidden
  const doubt = $("doubt").getBoundingClientRect(); // likewise
  const bottom = state === "moving" ? PLAYER_PX : card.height && card.height + 40;
  stage.clear({ right: beside ? innerWidth - panel.left : 0, top: Math.max(56, doubt.bottom + 8), bottom });
}

/** The live tree stands beside the welcome, or above it where the window is narrow. */
function besideWelcome() {
  const welcome = $("welcome").getBoundingClientRect();
  const first = $("welcome").firstElementChild.getBoundingClientRect();
  const beside = welcome.width < 0.9 * innerWidth;
  return { left: beside ? welcome.right : 0, right: 0, top: 56, bottom: beside ? 0 : innerHeight - first.top };
}

export function showHint() {
  const hint = $("hint");
  hint.hidden = false;
  hint.classList.remove("going");
  fill(hint, text(matchMedia("(pointer: coarse)").matches ? "hint.touch" : "hint.mouse"));
  setTimeout(() => hint.classList.add("going"), HINT_MS);
}

/** A ring at each pulled point, and a line to where it is pulled. */
export function showGrips(stage, places) {
  const pulling = places.some(Boolean);
  /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(".grip")).forEach((ring, i) => {
    ring.hidden = !places[i];
    if (places[i]) showRing(ring, ...[places[i].point, places[i].target].map((place) => stage.onScreen(place)));
  });
  $("stage").classList.toggle("holding", pulling);
  if (pulling) $("hint").classList.add("going");
}

function showRing(ring, { x, y }, pointer) {
  ring.style.transform = `translate(${x}px, ${y}px)`;
  const [dx, dy] = [pointer.x - x, pointer.y - y];
  const line = ring.firstElementChild;
  line.style.width = `${Math.max(Math.hypot(dx, dy) - RING_PX, 0)}px`;
  line.style.transform = `rotate(${Math.atan2(dy, dx)}rad) translateX(${RING_PX}px)`;
}
