// The panel's company: the tree alone, beside itself in another wind, or in a forest of its own kind.

import { $, describe, fill } from "./dom.js";
import { speed } from "./texts.js";

export class CompanyPanel {
  constructor(stage, player) {
    Object.assign(this, { stage, player });
    $("company").onchange = $("other-speed").oninput = () => this.show();
  }

  show() {
    const { player } = this;
    if (!player.tree?.moves) return;
    const gaussians = Boolean(player.tree.hidden); // they have no copies
    const kind = gaussians ? "one" : $("company").querySelector(":checked").value;
    const right = Number($("other-speed").value);
    $("company").hidden = gaussians;
    $("pair-box").hidden = kind !== "pair";
    describe($("other-speed"), $("other-speed-out"), speed(right));
    player.setCompany(kind, right);
  }

  /** What stands under each of the two; once a drawn frame. */
  place() {
    const { company, tree, speed: own, otherSpeed } = this.player;
    const named = company === "pair" && tree?.copies?.mesh.visible;
    $("plates").hidden = !named;
    if (!named) return;
    const places = [{ x: 0, y: 0 }, ...tree.copies.places];
    const { min, max } = tree.box;
    [...$("plates").children].forEach((plate, i) => {
      const { x, y } = places[i];
      const at = this.stage.onScreen([(min.x + max.x) / 2 + x, (min.y + max.y) / 2 + y, min.z]);
      fill(plate, speed([own, otherSpeed][i]));
      plate.style.transform = `translate(-50%, 14px) translate(${at.x}px, ${at.y}px)`;
    });
  }
}
