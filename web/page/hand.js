// The pointer on the tree: pull a branch, let go. The response comes back over the client's Push.

import * as THREE from "three";
import { pickVoxel } from "../draw/pick.js";
import { gripAt, gripInWind, gripNow } from "../motion/grip.js";
import { Pin } from "../motion/pin.js";

const EASE_S = 0.1; // in which a grip that was picked beside the pointer comes under it
const FLING = { share: 0.3, px_per_ms: 1.5, pause_ms: 60 }; // of the stage's width, at such a speed, without a pause
const KNOCK = { share: 0.06, seconds: 0.3 }; // of the height, and how long it lasts

export class Hand {
  /** `onGrab(point | null, pointer)` while something is pulled; `onProblem(problem)`. */
  constructor(stage, { onGrab = () => {}, onProblem = () => {} } = {}) {
    Object.assign(this, { stage, onGrab, onProblem });
    this.tree = null;
    this.push = null;
    this.grip = null; // { place, voxel, pointer, plane, target, beside, at }
    this.pin = null; // keeps the grip under the pointer; after the release it fades
    this.onFling = () => {}; // with the direction [rad] in which the mouse was flung past the tree
    this.flung = { px: 0, at: 0 };
    this.groups = [];
    this.frame = 0;
    this.damping = undefined; // until it is set, the service takes that of real trees
    const place = stage.canvas.parentElement; // before OrbitControls, which listens at the canvas
    place.addEventListener("pointerdown", (event) => this._down(event), true);
    place.addEventListener("pointermove", (event) => this._move(event), true);
    for (const name of ["pointerup", "pointercancel"]) place.addEventListener(name, (event) => this._up(event), true);
  }

  /**
   * Pull at this tree. `source.push(options)` opens a push, `source.reach(locality)` gives the weights [V] of a group;
   * see motion/remote.js and motion/modes.js.
   */
  take(tree, source) {
    this.leave();
    this.tree = tree;
    this.source = source;
    this.weights = new Map(); // of groups, by locality
    this._open();
  }

  /** Share of critical damping; what swings is let go. */
  setDamping(ratio) {
    this.damping = ratio;
    if (!this.push) return;
    this.letGo();
    this.push.close();
    this.groups = [];
    this._open();
  }

  _open() {
    this.push = this.source.push({
      damping_ratio: this.damping,
      onFrame: (message) => this._frame(message),
      onRest: (message) => this._settled(message),
      onProblem: this.onProblem,
    });
  }

  leave() {
    this.letGo();
    this.push?.close();
    this.tree = this.push = null;
    this.groups = [];
    this.pin = null;
  }

  get moving() {
    return this.groups.length > 0 || Boolean(this.grip) || Boolean(this.pin);
  }

  /** For those who use no pointer: displace the top, and let go. */
  knock() {
    if (!this.push || this.grip) return;
    const right = new THREE.Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0);
    right.multiplyScalar(KNOCK.share * this.stage.height);
    this.push.drag({ voxel: this.tree.top }, right.toArray());
    const { push } = this;
    setTimeout(() => push === this.push && !this.grip && push.release(), KNOCK.seconds * 1000);
  }

  letGo() {
    if (!this.grip) return;
    this.grip = null;
    this.push?.release();
    this.stage.controls.enabled = true;
    this.onGrab(null);
  }

  /** The groups to draw under the wind's coordinates: those of the service, and the bend that pins the grip. */
  groupsIn(q, turn, seconds) {
    const { grip, pin, tree } = this;
    if (!pin) return this.groups;
    if (grip) {
      grip.beside.multiplyScalar(Math.exp(-seconds / EASE_S));
      const inWind = gripInWind(tree, grip.place, q, turn);
      const target = grip.target.clone().add(grip.beside);
      grip.displacement = target.toArray().map((x, i) => x - inWind[i]);
      const missing = this.missing ?? [0, 0, 0]; // how far the service says that the tree does not go
      pin.hold(
        this.groups,
        inWind,
        target.toArray().map((x, i) => x - missing[i]),
      );
    } else if (!pin.fade(seconds)) {
      this.pin = null;
      return this.groups;
    }
    return [...this.groups, pin.group];
  }

  /** Once a frame: send the pointer's last place, acknowledge what was drawn. */
  tick() {
    const { grip } = this;
    if (grip?.displacement) {
      this.push.drag({ voxel: grip.voxel }, grip.displacement);
      grip.displacement = null;
    }
    if (grip) this.onGrab(gripNow(this.tree, grip.place), grip.at);
    if (this.frame) {
      this.push?.drawn(this.frame);
      this.frame = 0;
    }
  }

  _down(event) {
    const other = event.button !== 0 || event.shiftKey || event.target !== this.stage.canvas;
    if (!this.tree?.moves || this.grip || other) return;
    const picked = pickVoxel(this.tree, event);
    if (picked === null) return;
    const place = gripAt(this.tree, picked);
    const { voxel } = place;
    const { camera, canvas, controls } = this.stage;
    controls.enabled = false;
    canvas.setPointerCapture(event.pointerId);
    const start = new THREE.Vector3(...gripNow(this.tree, place));
    const facing = camera.getWorldDirection(new THREE.Vector3());
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(facing, start);
    const at = { x: event.clientX, y: event.clientY };
    const target = this._onPlane(event, plane) ?? start.clone();
    const beside = start.clone().sub(target);
    this.grip = { place, voxel, pointer: event.pointerId, plane, target, beside, at };
    this.missing = null;
    this.pin = new Pin(this.tree.modes, place);
    this.onGrab(start.toArray(), at);
  }

  _move(event) {
    if (!this.grip) return this._hover(event);
    if (event.pointerId !== this.grip.pointer) return;
    this.grip.at = { x: event.clientX, y: event.clientY };
    this.grip.target = this._onPlane(event, this.grip.plane) ?? this.grip.target;
  }

  /** The pointer's place in the plane through the grip that faces the camera. */
  _onPlane(event, plane) {
    const caster = new THREE.Raycaster();
    caster.setFromCamera(this.stage.pointer(event), this.stage.camera);
    return caster.ray.intersectPlane(plane, new THREE.Vector3());
  }

  _hover(event) {
    if (event.pointerType !== "mouse" || event.buttons) return;
    this._fling(event);
    const { canvas } = this.stage;
    const over = event.target === canvas && this.tree?.moves && pickVoxel(this.tree, event, { exact: false }) !== null;
    canvas.classList.toggle("over", Boolean(over));
  }

  /** A fast sweep to one side over the stage is a fling; it blows along the ground as the camera sees it. */
  _fling({ movementX: px, timeStamp: at }) {
    const { flung, stage } = this;
    const goesOn = at - flung.at < FLING.pause_ms && Math.sign(px) === Math.sign(flung.px);
    this.flung = { px: (goesOn ? flung.px : 0) + px, at, since: goesOn ? flung.since : at };
    const speed = Math.abs(this.flung.px) / Math.max(at - this.flung.since, 1);
    if (Math.abs(this.flung.px) < FLING.share * stage.canvas.clientWidth || speed < FLING.px_per_ms) return;
    const right = new THREE.Vector3().setFromMatrixColumn(stage.camera.matrixWorld, 0).multiplyScalar(Math.sign(px));
    this.flung = { px: 0, at };
    this.onFling(Math.atan2(right.y, right.x));
  }

  _up(event) {
    if (event.pointerId === this.grip?.pointer) this.letGo();
  }

  _frame({ frame, groups, reached }) {
    this.frame = frame;
    this.missing = reached?.why ? reached.wanted_m.map((x, i) => x - reached.reached_m[i]) : null;
    const ready = groups.map(({ locality, q, bend }) => {
      return { q, bend, seed: locality?.seed_voxel, perBone: this._weightsOf(locality) };
    });
    this.groups = ready.filter(({ perBone }) => perBone);
  }

  /** The tree has come to rest, maybe just as it is pulled again; without a message, the connection has ended. */
  _settled(message) {
    this.groups = [];
    if (this.grip && !message) this.letGo();
  }

  /** Weights of a group's bones; null until they have come. */
  _weightsOf(locality) {
    const key = JSON.stringify(locality);
    const { tree, weights } = this;
    if (!weights.has(key)) {
      weights.set(key, null);
      const store = (perVoxel) => weights.set(key, tree.modes.boneWeights(perVoxel));
      this.source.reach(locality).then(store, this.onProblem);
    }
    return weights.get(key);
  }
}
