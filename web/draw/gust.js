// One gust that runs through the crown and dies away: with it a tree is shown, and the mouse can blow.

import { drag } from "../motion/bands.js";

const CROSSING_S = 1.4; // from one side of the crown to the other
const SWELL_S = 0.8; // from its front to its height
const LASTS_S = 7 * SWELL_S; // a hundredth is left
const CALM = 0.3; // of the wind, before the first gust has come
const STRONGEST_M_S = 14; // a gale: no gust makes more of a breeze
const MOST = 2.5; // of the wind's own motion

/** What a field's shader needs: `gustAt` gives the factor on the motion of a place. */
export const GUST = /* glsl */ `
uniform vec4 gust;      // delay a metre, time since the front was at the origin [s], strength
uniform float gustCalm; // the factor before the front
float gustAt(vec2 place) {
  if (gust.w == 0.0) return 1.0;
  float late = gust.z - dot(gust.xy, place);
  float swell = max(late, 0.0) / ${SWELL_S.toFixed(3)};
  return mix(gustCalm, 1.0, smoothstep(-0.3, 0.5, late)) + gust.w * swell * exp(1.0 - swell);
}`;

/** No gust. */
export const still = () => ({ gust: [0, 0, 0, 0], calm: 1 });

export class Gust {
  /** Towards `angle` [rad] through a crown of `middle` and `radius` [m] in a wind of `speed_m_s`; `first` where it was calm before. */
  constructor({ angle, middle, radius, speed_m_s, first = false }) {
    const delay = CROSSING_S / (2 * radius);
    this.along = [delay * Math.cos(angle), delay * Math.sin(angle)];
    this.begins = CROSSING_S / 2 - this.along[0] * middle.x - this.along[1] * middle.y;
    const room = drag(STRONGEST_M_S) / drag(Math.max(speed_m_s, 1)) - 1;
    this.strength = Math.min(Math.max(room, 0), MOST);
    this.calm = first ? CALM : 1;
    this.seconds = 0;
  }

  get isOver() {
    return this.seconds > CROSSING_S + LASTS_S || !this.strength;
  }

  /** The factor on the motion in the middle of the crown. */
  get inMiddle() {
    const late = this.seconds - CROSSING_S / 2;
    const swell = Math.max(late, 0) / SWELL_S;
    return (late < 0 ? this.calm : 1) + this.strength * swell * Math.exp(1 - swell);
  }

  /** Values of the shader's uniforms, some seconds later. */
  after(seconds) {
    this.seconds += seconds;
    if (this.isOver) return still();
    return { gust: [...this.along, this.seconds - this.begins, this.strength], calm: this.calm };
  }
}
