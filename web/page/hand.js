// The pointer on the tree: pull a branch or two, let go. The response comes back over the client's Push.

import * as THREE from "three";
import { pickVoxel, topVoxel } from "../draw/pick.js";
import { gripNow } from "../motion/grip.js";
import { Pull } from "./pull.js";

const MOST_PLACES = 2; // that are pulled at once
const FLING = { share: 0.3, px_per_ms: 1.5, pause_ms: 60 }; // of the stage's width, at such a speed, without a pause
const KNOCK = { share: 0.06, seconds: 0.3 }; // of the height, and how long it lasts

export class Hand {
  /** `onGrab(places)` once a frame: what is pulled, `{ point, target }` [m] or null each; `onProblem(problem)`. */
  constructor(stage, { onGrab = () => {}, onProblem = () => {} } = /** @type {any} */ ({})) {
    Object.assign(this, { stage, onGrab, onProblem, pulls: [] });
    this.tree = null;
    this.onFling = (_angle) => {}; // with the direction [rad] in which the mouse was flung past the tree
    this.flung = { px: 0, at: 0 };
    this.damping = undefined; // until it is set, the service takes that of real trees
    const place = stage.canvas.parentElement; // before OrbitControls, which listens at the canvas
    place.addEventListener("pointerdown", (event) => this._down(event), true);
    place.addEventListener("pointermove", (event) => this._move(event), true);
    for (const name of ["pointerup", "pointercancel"]) place.addEventListener(name, (event) => this._up(event), true);
  }

  /** Pull at this tree. `source.push(options)` opens a push: see motion/remote.js and motion/local.js. */
  take(tree, source) {
    this.leave();
    Object.assign(this, { tree, source });
  }

  /** Share of critical damping; what swings is let go. */
  setDamping(ratio) {
    this.damping = ratio;
    this._close();
  }

  leave() {
    this._close();
    this.tree = null;
  }

  _close() {
    this.letGo();
    for (const pull of this.pulls) pull.close();
    this.pulls = [];
  }

  get grip() {
    return this.pulls.find(({ grip }) => grip)?.grip ?? null;
  }

  get moving() {
    return this.pulls.some(({ moving }) => moving);
  }

  /** A pull that holds nothing; undefined where all hold something. */
  _free() {
    if (this.pulls.length < MOST_PLACES && this.pulls.every(({ grip }) => grip)) this.pulls.push(new Pull(this));
    return this.pulls.find(({ grip }) => !grip);
  }

  /** For those who use no pointer: displace the top, and let go. */
  knock() {
    if (!this.tree?.moves || this.grip) return;
    const right = new THREE.Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0);
    right.multiplyScalar(KNOCK.share * this.stage.height);
    const pull = this._free();
    pull.push.drag({ voxel: topVoxel(this.tree.modes) }, right.toArray());
    setTimeout(() => this.pulls.includes(pull) && !pull.grip && pull.push.release(), KNOCK.seconds * 1000);
  }

  letGo(which = this.pulls) {
    for (const pull of which) pull.letGo();
    this.stage.controls.enabled = !this.pulls.some(({ grip }) => grip?.pointer != null);
    this._show();
  }

  /** The groups to draw in the wind of now: those of the source, and the bends that pin what is pulled. */
  groupsNow(seconds) {
    const beside = (pull) => this.pulls.filter((other) => other !== pull).flatMap(({ drawn }) => drawn);
    return this.pulls.flatMap((pull) => pull.groupsNow(seconds, beside(pull)));
  }

  /** Once a frame, after what was drawn. */
  tick() {
    for (const pull of this.pulls) pull.tick();
    if (this.grip) this._show();
  }

  _show() {
    this.onGrab(this.pulls.map(({ grip }) => grip && { point: gripNow(this.tree, grip.place), target: grip.target }));
  }

  _down(event) {
    const second = !event.isPrimary && !this.grip; // of two fingers that turn or zoom the view
    if (!this.tree?.moves || event.button !== 0 || second || event.target !== this.stage.canvas) return;
    const pull = this._free();
    const picked = pull ? pickVoxel(this.tree, event) : null;
    if (picked === null) return;
    pull.take(picked, event);
    this.stage.controls.enabled = false;
    this.stage.canvas.setPointerCapture(event.pointerId);
    this._show();
  }

  _of({ pointerId }) {
    return this.pulls.find(({ grip }) => grip?.pointer === pointerId);
  }

  _move(event) {
    const pull = this._of(event);
    if (pull) pull.follow(event);
    else if (!this.pulls.some(({ grip }) => grip?.pointer != null)) this._hover(event);
  }

  /** With Shift a place stays where it was pulled to, until something is let go without. */
  _up(event) {
    const pull = this._of(event);
    if (!pull) return;
    if (event.shiftKey) pull.grip.pointer = null;
    this.letGo(event.shiftKey ? [] : this.pulls.filter((other) => other === pull || other.grip?.pointer === null));
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
}
