// The panel's pushes: how fast what is pushed comes to rest, and a push for those who use no pointer.

import { $, describe } from "./dom.js";
import { percent, text } from "./texts.js";

export function buildPushPanel(hand) {
  const damping = $("damping");
  describe(damping, $("damping-out"), text("push.natural"));
  damping.oninput = () => describe(damping, $("damping-out"), percent(Number(damping.value) / 100));
  damping.onchange = () => hand.setDamping(Number(damping.value) / 100);
  $("knock").onclick = () => hand.knock();
}
