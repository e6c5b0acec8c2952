// The panel's light: where the sun stands, shadows, what lies under the tree and behind it.

import { $, describe } from "./dom.js";
import { bearing, degrees } from "./texts.js";
import { dress } from "./theme.js";

export class LightPanel {
  constructor(stage) {
    this.stage = stage;
    $("sun-from").oninput = $("sun-height").oninput = () => this._showSun();
    $("ground").onchange = $("shadows").onchange = () => {
      stage.surroundings.ground.visible = $("ground").checked;
      stage.surroundings.sun.castShadow = $("shadows").checked;
      stage.stale = true;
    };
    $("background").onchange = () => {
      document.body.dataset.background = $("background").value;
      dress(stage);
    };
    const { from_deg, height_deg } = stage.surroundings.sunPlace;
    $("sun-from").value = from_deg;
    $("sun-height").value = height_deg;
    this._describe();
  }

  _showSun() {
    this.stage.moveSun({ from_deg: Number($("sun-from").value), height_deg: Number($("sun-height").value) });
    this._describe();
  }

  _describe() {
    describe($("sun-from"), $("sun-from-out"), bearing(Number($("sun-from").value)));
    describe($("sun-height"), $("sun-height-out"), degrees(Number($("sun-height").value)));
  }
}
