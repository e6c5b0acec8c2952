// One place that is pulled, or was: what the source answers, and the bend that keeps the place under the pointer.

import * as THREE from "three";
import { gripAt, gripInWind, gripNow } from "../motion/grip.js";
import { Pin } from "../motion/pin.js";

const EASE_S = 0.1; // in which a grip that was picked beside the pointer comes under it

export class Pull {
  /** `hand` has the tree, the source of pushes, and their damping. */
  constructor(hand) {
    Object.assign(this, { hand, groups: [], frame: 0 });
    this.grip = null; // { place, pointer, plane, target, beside }; pointer is null where it stays without a hand
    this.pin = null; // keeps the grip at its target; after the release it fades
    this.push = hand.source.push({
      damping_ratio: hand.damping,
      onFrame: (message) => this._frame(message),
      onRest: (message) => this._settled(message),
      onProblem: hand.onProblem,
    });
  }

  get moving() {
    return this.groups.length > 0 || Boolean(this.grip || this.pin);
  }

  /** Hold the place at a voxel; `target` is where the pointer is in a plane. */
  take(voxel, event) {
    const { tree, stage } = this.hand;
    const place = gripAt(tree, voxel);
    const start = new THREE.Vector3(...gripNow(tree, place));
    const facing = stage.camera.getWorldDirection(new THREE.Vector3());
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(facing, start);
    const target = stage.onPlane(event, plane) ?? start.clone();
    this.grip = { place, pointer: event.pointerId, plane, target, beside: start.sub(target) };
    this.missing = null;
    this.pin = new Pin(tree.modes, place);
  }

  follow(event) {
    this.grip.target = this.hand.stage.onPlane(event, this.grip.plane) ?? this.grip.target;
  }

  letGo() {
    if (!this.grip) return;
    this.grip = null;
    this.push.release();
  }

  /** The groups of the source, and the bend that pins the grip. */
  get drawn() {
    return this.pin ? [...this.groups, this.pin.group] : this.groups;
  }

  /** What is drawn of it in the wind of now, among the groups of `others`. */
  groupsNow(seconds, others) {
    const { grip, pin } = this;
    const around = [...this.groups, ...others];
    const inWind = pin && gripInWind(this.hand.tree, pin.grip);
    if (pin && !grip && !pin.fade(around, inWind, seconds)) this.pin = null;
    if (grip) {
      grip.beside.multiplyScalar(Math.exp(-seconds / EASE_S));
      const target = grip.target.clone().add(grip.beside).toArray();
      grip.displacement = target.map((x, i) => x - inWind[i]);
      const missing = this.missing ?? [0, 0, 0]; // how far the source says that the tree does not go
      const reached = target.map((x, i) => x - missing[i]);
      pin.hold(around, inWind, reached);
    }
    return this.drawn;
  }

  /** Once a frame: send the pointer's last place, acknowledge what was drawn. */
  tick() {
    const { grip, frame, push } = this;
    if (grip?.displacement) {
      push.drag({ voxel: grip.place.voxel }, grip.displacement);
      grip.displacement = null;
    }
    if (frame) push.drawn(frame);
    this.frame = 0;
  }

  close() {
    this.letGo();
    this.push.close();
  }

  _frame({ frame, groups, reached }) {
    this.frame = frame;
    this.missing = reached?.why ? reached.wanted_m.map((x, i) => x - reached.reached_m[i]) : null;
    const bent = groups.filter(({ bend }) => bend);
    this.groups = bent.map(({ locality, bend }) => ({ seed: locality.seed_voxel, bend }));
  }

  /** The tree has come to rest, maybe just as it is pulled again; without a message, the connection has ended. */
  _settled(message) {
    this.groups = [];
    if (this.grip && !message) this.hand.letGo();
  }
}
