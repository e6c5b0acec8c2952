// Time: the wind's loop is played, paused and scrubbed, endless wind goes on; what is pushed goes on in real time.

import { Gust } from "../draw/gust.js";
import { bandGains, powerLaw } from "../motion/bands.js";
import { forestMotions, forestPlaces, pairPlaces, windMotion } from "../motion/company.js";
import { $, describe } from "./dom.js";
import { number, text } from "./texts.js";

const SHOWN_EVERY_S = 0.1; // what the clock says while time goes on
const EASE_S = 0.3; // in which the wind follows its slider
const SHOWN_SHARE = 0.05; // of the height: a mode alone is enlarged to this
const MOST_TURNS = 3; // of a mode alone in one loop, slow enough for the eye

export class Player {
  constructor(hand) {
    this.hand = hand;
    hand.onFling = (angle) => this.blow({ angle });
    this.onStart = () => {}; // a tree's motion begins
    this.playing = true;
    this.phase = 0;
    this.K = 0; // bins of the tree's motion
    this.seconds = 0; // of endless wind
    this.gust = null;
    this.turbulent = null; // its table of cosines; null plays the loop
    this.windSpeed = 0; // as it is shown; follows `speed`, the slider's
    this.speed = this.turn = 0;
    this.scripted = null; // { phase, seconds } that a recording asks for
    this.alone = null; // { k, times }: one mode by itself, enlarged
    $("play").onclick = () => this.setPlaying(!this.playing);
    $("time").oninput = () => {
      this.setPlaying(false);
      this.phase = Number($("time").value) % 1;
    };
  }

  /** Begin with a tree's motion; `wind` is the one that it was made for. `atRest` begins where the tree stands still. */
  start(tree, { period_s: period, wind = null, wind_bands: bands = null }, { atRest = true } = {}) {
    const made = wind ?? tree.surface.wind;
    const windSpeed = atRest ? 0 : made.speed_m_s;
    Object.assign(this, { tree, K: tree.modes.K, period, made, windSpeed, speed: made.speed_m_s, phase: 0 });
    this.direction_rad = (made.direction_deg * Math.PI) / 180;
    this.bands = bands ?? powerLaw(tree.modes.K, made.speed_m_s);
    this.hasBands = Boolean(bands);
    this.drawn = this.shownTime = this.gust = null;
    this.company = "one";
    this.setTurbulent(null);
    this._showTime();
    this.setPlaying(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    this.blow({ first: true });
    this.onStart();
  }

  /** Let a gust run through the crown, in the wind's direction or another [rad]. */
  blow({ angle = this.direction_rad, first = false } = {}) {
    if (!this.tree?.moves || !this.playing || this.gust || this.alone) return;
    const { box } = this.tree;
    const middle = { x: (box.min.x + box.max.x) / 2, y: (box.min.y + box.max.y) / 2 };
    const radius = Math.max(box.max.x - box.min.x, box.max.y - box.min.y) / 2;
    this.gust = new Gust({ angle, middle, radius, speed_m_s: this.speed, first });
  }

  /** How far the tree moves, 1 in the wind that its motion was made for. */
  get motion() {
    return this.tree?.moves && this.playing && this.gains ? this.gains[1] * (this.gust?.inMiddle ?? 1) : 0;
  }

  /** What is pulled, paused or recorded shows the wind alone. */
  _gustNow(seconds) {
    if (!this.gust) return false;
    if (!this.playing || this.scripted || this.hand.grip || this.gust.isOver) this.gust = null;
    this.tree.blow(this.gust?.after(seconds));
    return true;
  }

  /** The model's gains in all winds, in place of a power law. */
  takeBands(bands) {
    Object.assign(this, { bands, hasBands: true });
    this.drawn = null;
  }

  stop() {
    this.tree = null;
  }

  setPlaying(playing) {
    this.playing = playing;
    $("play").dataset.playing = playing;
    $("play").setAttribute("aria-label", text(playing ? "time.pause" : "time.play"));
  }

  /** Play wind that never repeats, from the answer of /v1/spectra/{id}/wind; null plays the loop. */
  setTurbulent(wind) {
    this.turbulent = wind;
    $("time").disabled = Boolean(wind);
  }

  /** Show another wind: the same motion, each mode stronger or weaker, and turned. Returns how far it sways. */
  setWind({ speed_m_s: speed, direction_deg: direction }) {
    Object.assign(this, { speed, direction_rad: (direction * Math.PI) / 180 });
    this.turn = ((direction - this.made.direction_deg) * Math.PI) / 180;
    return bandGains(this.bands, speed)[1];
  }

  /** What stands beside the tree: "one" for nothing, "pair" for the same tree in a wind of `speed_m_s`, or "forest". */
  setCompany(kind, speed_m_s) {
    const { box } = this.tree;
    const width = Math.max(box.max.x - box.min.x, box.max.y - box.min.y);
    if (kind !== this.company) {
      this.tree.setCopies(kind === "forest" ? forestPlaces(width) : kind === "pair" ? pairPlaces(width) : []);
    }
    Object.assign(this, { company: kind, otherSpeed: speed_m_s });
  }

  /** Show one mode by itself, enlarged so that its `largest` swing is seen beside the tree's height [m]; returns how many times. */
  setAlone(k, largest, height) {
    const times = Math.max(1, (SHOWN_SHARE * height) / largest);
    this.alone = { k, times };
    return times;
  }

  /** Once a frame. */
  advance(seconds) {
    const { tree, hand } = this;
    if (!tree?.moves) return;
    if (this.scripted) Object.assign(this, this.scripted);
    else if (this.playing && this.turbulent) this.seconds += seconds;
    else if (this.playing) this.phase = (this.phase + seconds / this.period) % 1;
    const behind = this.speed - this.windSpeed;
    this.windSpeed = Math.abs(behind) > 1e-3 ? this.windSpeed + behind * (1 - Math.exp(-seconds / EASE_S)) : this.speed;
    this.gains = bandGains(this.bands, this.windSpeed);
    const time = this.turbulent ? this.seconds : this.phase;
    const windless = !this.windSpeed && !this.alone && !(this.company === "pair" && this.otherSpeed);
    const beside = [this.company, this.otherSpeed];
    const now = JSON.stringify([windless || time, this.windSpeed, this.turn, this.alone, ...beside]);
    const blown = this._gustNow(seconds);
    const changed = now !== this.drawn || blown;
    if (changed || hand.moving || tree.groups.length) {
      tree.swing(this._motion());
      tree.bend(hand.groupsNow(seconds));
    }
    if (changed && tree.copies) tree.copies.move(this._companyMotions(tree.copies.places));
    this.sinceShown += seconds;
    if (time !== this.shownTime && (!this.playing || this.sinceShown > SHOWN_EVERY_S)) this._showTime();
    this.drawn = now;
  }

  _motion() {
    const { windSpeed: speed, gains, turn, alone } = this;
    if (!alone) return windMotion(this, { speed, gains, turn, gusty: this.company === "forest" });
    const q = new Float32Array(2 * this.K);
    const phase = this.turbulent ? (this.seconds / this.period) % 1 : this.phase;
    const angle = 2 * Math.PI * Math.min(alone.k, MOST_TURNS) * phase;
    q[2 * alone.k] = alone.times * Math.cos(angle);
    q[2 * alone.k + 1] = alone.times * Math.sin(angle);
    return { q, turn };
  }

  _companyMotions(places) {
    const { speed, gains, turn, otherSpeed } = this;
    if (this.company === "forest") return forestMotions(places, this, { speed, gains, turn });
    const other = { speed: otherSpeed, gains: bandGains(this.bands, otherSpeed), turn, gusty: false };
    return places.map(() => windMotion(this, other));
  }

  _showTime() {
    Object.assign(this, { shownTime: this.turbulent ? this.seconds : this.phase, sinceShown: 0 });
    if (this.turbulent) {
      $("clock").textContent = text("time.seconds", { n: number(this.seconds, 1) });
      return;
    }
    $("time").value = this.phase;
    $("clock").textContent = `${number(this.phase * this.period, 2)} / ${number(this.period, 2)} s`;
    describe($("time"), null, text("time.at", { n: number(this.phase * this.period, 1) }));
  }
}
