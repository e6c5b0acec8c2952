// The panel's views: tree, wire, voxels, modes, and the tree at rest over it.

import { $, describe, fill } from "./dom.js";
import { length, number, text } from "./texts.js";
import { accent } from "./theme.js";

export class ViewPanel {
  constructor(stage, player) {
    Object.assign(this, { stage, player });
    $("views").onchange = () => this.show();
    $("mode").oninput = $("mode-alone").onchange = () => this._showMode();
    $("rest").onchange = () => this._showRest();
    $("turntable").onchange = () => {
      stage.controls.autoRotate = $("turntable").checked;
    };
  }

  get view() {
    return $("views").querySelector(":checked").value;
  }

  show() {
    $("mode-box").hidden = this.view !== "modes";
    this.player.tree?.setView(this.view);
    this._showMode();
    this._showRest();
  }

  _showMode() {
    const { player, stage } = this;
    const { tree } = player;
    player.alone = null;
    if (!tree?.moves) return;
    const k = Number($("mode").value);
    $("mode").max = tree.modes.K - 1;
    describe($("mode"), $("mode-out"), `${k}: ${number(tree.modes.frequencies_hz[k], 2)} Hz`);
    if (this.view !== "modes") return;
    const largest = tree.showBin(k);
    const times = $("mode-alone").checked ? player.setAlone(k, largest, stage.height) : 1;
    const words = [length(largest)];
    if (times > 1.05) words.push(text("mode.times", { n: number(times, times < 10 ? 1 : 0) }));
    fill($("mode-most"), words.join(", "));
  }

  _showRest() {
    const { ghost } = this.player.tree ?? {};
    if (!ghost) return;
    ghost.visible = $("rest").checked;
    ghost.material.color.set(accent());
    this.stage.stale = true;
  }
}
