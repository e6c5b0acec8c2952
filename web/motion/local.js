// Pulls that the page answers by itself, without a service: the bends of the joints that carry the pulled place, which
// ring out after the release. What motion/remote.js asks of the service is a whole tree's response; this is one branch's.

import { gripOfVoxel } from "./grip.js";
import { Pin } from "./pin.js";

const DAMPING = 0.13; // share of critical damping of a tree in leaf: docs/laws.md
const AT_REST = 0.01; // of the bend

/** A source for page/hand.js of a tree's Modes. */
export const localSource = (modes) => ({
  push: (options) => new LocalPush(modes, options),
  reach: async () => new Float32Array(modes.V).fill(1),
});

class LocalPush {
  constructor(
    modes,
    { damping_ratio: damping = DAMPING, onFrame = () => {}, onRest = () => {} } = /** @type {any} */ ({}),
  ) {
    this.modes = modes;
    this.damping = damping;
    this.onFrame = onFrame;
    this.onRest = onRest;
    this.frame = 0;
  }

  drag({ voxel }, displacement_m) {
    this.began = null;
    if (this.pin?.voxel !== voxel) this.pin = new Pin(this.modes, gripOfVoxel(this.modes, voxel));
    const rest = Array.from(this.modes.centres.subarray(3 * voxel, 3 * voxel + 3));
    this.pin.hold(
      [],
      rest,
      rest.map((x, i) => x + displacement_m[i]),
    );
    this._give(1);
  }

  release() {
    if (!this.pin) return;
    this.began = performance.now();
    const began = this.began;
    const frequency = swayFrequency(this.modes, this.pin.voxel);
    const step = (now) => {
      if (began !== this.began) return; // pulled again, or closed
      const seconds = Math.max(now - began, 0) / 1000;
      if (Math.exp(-this.damping * 2 * Math.PI * frequency * seconds) < AT_REST) return this._end();
      this._give(ringing(seconds, frequency, this.damping));
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  drawn() {}

  close() {
    this.began = null;
    this.pin = null;
  }

  _end() {
    this.close();
    this.onRest({ frame: this.frame });
  }

  _give(share) {
    const { seed, bend } = this.pin.group;
    const bent = bend.map((turn) => turn.map((x) => share * x));
    this.onFrame({ frame: ++this.frame, groups: [{ locality: { seed_voxel: seed }, bend: bent }] });
  }
}

/** A damped oscillator that is let go at 1 without velocity. */
export function ringing(seconds, frequency_hz, damping) {
  const omega = 2 * Math.PI * frequency_hz;
  const root = Math.sqrt(Math.max(1 - damping ** 2, 1e-6));
  const angle = omega * root * seconds;
  return Math.exp(-damping * omega * seconds) * (Math.cos(angle) + (damping / root) * Math.sin(angle));
}

/** The mean frequency at which a voxel sways in the wind, weighted by its velocity [Hz]. */
export function swayFrequency({ K, shapes, scale_m: scale, frequencies_hz: hz }, voxel) {
  let [sum, total] = [0, 0];
  for (let k = 1; k < K; k++) {
    let energy = 0;
    for (let i = 6 * (voxel * K + k), end = i + 6; i < end; i++) energy += (shapes[i] * scale[k] * hz[k]) ** 2;
    sum += hz[k] * energy;
    total += energy;
  }
  return total > 0 ? sum / total : hz[1];
}
