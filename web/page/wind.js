// The panel's wind: presets, speed and direction preview at once, a job makes the motion anew.

import { $, button, describe, element, fill } from "./dom.js";
import { bearing, degrees, number, speed as speedWords, text } from "./texts.js";
import { accent } from "./theme.js";

export const PRESETS = { calm: 1, breeze: 4, wind: 8, gale: 14, storm: 20 }; // m/s, those that the model is asked for
const FULL_M_S = 12; // from here on the arrow is at its darkest

export class WindPanel {
  /** `onMake(wind)` is called with the wind that a motion is to be made for, `onProblem` with a problem of the service. */
  constructor(stage, player, { onMake, onProblem }) {
    Object.assign(this, { stage, player });
    this.active = false;
    for (const choice of document.getElementsByName("wind-mode")) {
      choice.onchange = () => this._setMode().catch(onProblem);
    }
    const items = Object.entries(PRESETS).map(([name, value]) => this._presetItem(name, value));
    $("wind-presets").replaceChildren(...items);
    $("speed").oninput = () => this.show();
    $("direction").oninput = () => this.show();
    $("make-wind").onclick = () => onMake(this.wind);
    this._watchDial();
    player.onStart = () => {
      this.wind = player.made;
    };
    if (player.tree) player.onStart();
  }

  /** Begin with a motion; `turbulent()` asks for its endless wind. */
  start(turbulent) {
    this.turbulent = turbulent;
    return this._setMode();
  }

  /** The model's answer to all winds has come. */
  takeBands(bands) {
    this.player.takeBands(bands);
    this.show();
  }

  async _setMode() {
    const { turbulent, player } = this;
    if (!$("wind-endless").checked || !turbulent) return player.setTurbulent(null);
    const table = await turbulent();
    if (this.turbulent !== turbulent || !$("wind-endless").checked) return;
    player.setTurbulent(table);
  }

  _presetItem(name, value) {
    const chip = button(text(`wind.${name}`), () => {
      $("speed").value = value;
      this.show();
    });
    chip.dataset.speed = value;
    return element("li", {}, chip);
  }

  get wind() {
    return { speed_m_s: Number($("speed").value), direction_deg: Number($("direction").value) };
  }

  set wind({ speed_m_s: speed, direction_deg: direction }) {
    $("speed").value = speed;
    $("direction").value = ((direction % 360) + 360) % 360;
    this.show();
  }

  /** Preview the sliders' wind. */
  show() {
    const { wind, player, stage } = this;
    const { speed_m_s: speed, direction_deg: direction } = wind;
    describe($("speed"), $("speed-out"), speedWords(speed));
    describe($("direction"), $("direction-out"), bearing(direction));
    $("needle").setAttribute("transform", `rotate(${-direction})`);
    for (const chip of $("wind-presets").querySelectorAll("button")) {
      chip.setAttribute("aria-pressed", Math.abs(Number(chip.dataset.speed) - speed) < 0.05);
    }
    if (!player.tree) return;
    const times = player.setWind(wind);
    fill($("wind-note"), this._note(speed, direction, times));
    stage.wind(direction, speed / FULL_M_S, accent());
  }

  _note(speed, direction, times) {
    const { made, hasBands } = this.player;
    const turn = Math.abs(((direction - made.direction_deg + 540) % 360) - 180);
    const sameSpeed = Math.abs(speed - made.speed_m_s) < 0.01;
    const same = sameSpeed && turn < 0.01;
    $("make-wind").hidden = same || !speed;
    if (same || !speed) return text(same ? "wind.same" : "wind.none");
    const parts = [text("wind.preview")];
    if (!sameSpeed)
      parts.push(text(hasBands ? "wind.times-bands" : "wind.times", { n: number(times, times < 10 ? 1 : 0) }));
    if (turn >= 0.01) parts.push(text("wind.turned", { angle: degrees(turn) }));
    return `${parts.join(", ")}.`;
  }

  /** The compass: a pointer anywhere on it sets the direction. */
  _watchDial() {
    const dial = $("dial");
    const set = (event) => {
      const box = dial.getBoundingClientRect();
      const [x, y] = [event.clientX - box.left - box.width / 2, box.top + box.height / 2 - event.clientY];
      $("direction").value = Math.round((Math.atan2(y, x) * 180) / Math.PI + 360) % 360;
      this.show();
    };
    dial.onpointerdown = (event) => {
      dial.setPointerCapture(event.pointerId);
      set(event);
      dial.onpointermove = set;
    };
    dial.onpointerup = dial.onpointercancel = () => {
      dial.onpointermove = null;
    };
  }
}
