// Pulls that the page answers by itself, without a service: the bends of the joints that carry the pulled place, which
// ring out after the release. What motion/remote.js asks of the service is a whole tree's response; this is one branch's.

import { Pin } from "./pin.js";
import { binSizes } from "./swing.js";
import { plus, rowOf } from "./vectors.js";

const DAMPING = 0.13; // share of critical damping of a tree in leaf: docs/laws.md
const AT_REST = 0.01; // of the bend

/** A source for page/hand.js of a Tree. */
export const localSource = (tree) => ({
  push: (options) => new LocalPush(tree, options),
});

class LocalPush {
  constructor(
    tree,
    { damping_ratio: damping = DAMPING, onFrame = () => {}, onRest = () => {} } = /** @type {any} */ ({}),
  ) {
    this.tree = tree;
    this.damping = damping;
    this.onFrame = onFrame;
    this.onRest = onRest;
    this.frame = 0;
  }

  drag({ voxel }, displacement_m) {
    const { modes } = this.tree;
    const rest = rowOf(modes.centres, voxel);
    this.began = null;
    if (this.pin?.voxel !== voxel) {
      this.pin = new Pin(modes, { voxel, rest, joints: [modes.joint_of_voxel[voxel]], weights: [1] });
    }
    this.pin.hold([], rest, plus(rest, displacement_m));
    this._give(1);
  }

  release() {
    if (!this.pin) return;
    this.began = performance.now();
    const began = this.began;
    const frequency = swayFrequency(this.tree, this.pin.voxel);
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
    this.began = this.pin = null;
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

/** The mean frequency at which a voxel of a Tree sways in the wind, weighted by its velocity [Hz]. */
export function swayFrequency({ surface, modes, vertexOf }, voxel) {
  let [sum, total] = [0, 0];
  for (let k = 1; k < modes.K; k++) {
    const hz = modes.frequencies_hz[k];
    const [size] = binSizes(surface, k, [vertexOf[voxel]]);
    sum += hz * (size * hz) ** 2;
    total += (size * hz) ** 2;
  }
  return total > 0 ? sum / total : modes.frequencies_hz[1];
}
