// The pointer on the tree: pull a branch, let go. What it does to the tree comes back over the client's Push.

import * as THREE from "three";

const FURTHEST = 0.12; // of the height: what a pull comes near to; beyond it bones would turn over
const KNOCK = { share: 0.06, seconds: 0.3 }; // of the height, held so long

export class Hand {
  /** `onGrab(point | null, where the pointer is)`, `onProblem(problem)`. */
  constructor(stage, client, { onGrab, onProblem }) {
    Object.assign(this, { stage, client, onGrab, onProblem });
    this.tree = this.push = this.held = null;
    this.groups = [];
    this.frame = 0;
    this.damping = undefined; // until it is set, the server takes that of real trees
    const place = stage.canvas.parentElement; // before OrbitControls, which listens at the canvas
    place.addEventListener("pointerdown", (event) => this._down(event), true);
    place.addEventListener("pointermove", (event) => this._move(event), true);
    for (const name of ["pointerup", "pointercancel"]) place.addEventListener(name, (event) => this._up(event), true);
  }

  take(tree, spectrumId) {
    this.leave();
    this.tree = tree;
    this.spectrumId = spectrumId;
    this.weights = new Map(); // of groups, by locality
    this._hold();
  }

  /** Share of critical damping; what swings begins anew. */
  setDamping(ratio) {
    this.damping = ratio;
    if (!this.push) return;
    this.letGo();
    this.push.close();
    this.groups = [];
    this._hold();
  }

  _hold() {
    this.push = this.client.push(this.spectrumId, {
      damping_ratio: this.damping,
      onFrame: (message) => this._frame(message),
      onRest: () => this._settled(),
      onProblem: this.onProblem,
    });
  }

  leave() {
    this.letGo();
    this.push?.close();
    this.tree = this.push = null;
    this.groups = [];
  }

  get moving() {
    return this.groups.length > 0 || Boolean(this.held);
  }

  /** For those who use no pointer: the top aside, and let go. */
  knock() {
    if (!this.push || this.held) return;
    const right = new THREE.Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0);
    right.multiplyScalar(KNOCK.share * this.stage.height);
    this.push.drag({ voxel: this.tree.top }, right.toArray());
    const { push } = this;
    setTimeout(() => push === this.push && !this.held && push.release(), KNOCK.seconds * 1000);
  }

  letGo() {
    if (!this.held) return;
    this.held = null;
    this.push?.release();
    this.stage.controls.enabled = true;
    this.onGrab(null);
  }

  /** Once a frame: the pointer's last place goes out, and what was drawn is told. */
  tick() {
    if (this.held?.wanted) {
      this.push.drag({ voxel: this.held.voxel }, this.held.wanted.toArray());
      this.held.wanted = null;
    }
    if (this.held) this.onGrab(this.tree.voxelNow(this.held.voxel), this.held.at);
    if (this.frame) {
      this.push?.drawn(this.frame);
      this.frame = 0;
    }
  }

  _down(event) {
    if (!this.tree?.moves || this.held || event.button !== 0 || event.shiftKey || event.target !== this.stage.canvas)
      return;
    const voxel = this.tree.pick(event);
    if (voxel === null) return;
    this.stage.controls.enabled = false;
    this.stage.canvas.setPointerCapture(event.pointerId);
    const start = new THREE.Vector3(...this.tree.voxelNow(voxel));
    const facing = this.stage.camera.getWorldDirection(new THREE.Vector3());
    this.held = {
      voxel,
      start,
      pointer: event.pointerId,
      plane: new THREE.Plane().setFromNormalAndCoplanarPoint(facing, start),
      wanted: null,
      at: { x: event.clientX, y: event.clientY },
    };
    this.onGrab(start.toArray(), this.held.at);
  }

  _move(event) {
    if (!this.held) {
      if (event.pointerType !== "mouse" || event.buttons) return;
      const over =
        event.target === this.stage.canvas && this.tree?.moves && this.tree.pick(event, { exact: false }) !== null;
      this.stage.canvas.classList.toggle("over", Boolean(over));
      return;
    }
    if (event.pointerId !== this.held.pointer) return;
    const ray = new THREE.Raycaster();
    ray.setFromCamera(this.stage.pointer(event), this.stage.camera);
    const at = ray.ray.intersectPlane(this.held.plane, new THREE.Vector3());
    this.held.at = { x: event.clientX, y: event.clientY };
    if (!at) return;
    const limit = FURTHEST * this.stage.height;
    const pull = at.sub(this.held.start);
    const far = pull.length();
    this.held.wanted = pull.multiplyScalar(far > 0 ? (limit * Math.tanh(far / limit)) / far : 0);
  }

  _up(event) {
    if (event.pointerId === this.held?.pointer) this.letGo();
  }

  _frame({ frame, groups }) {
    this.frame = frame;
    const known = [];
    for (const { locality, q } of groups) {
      const perBone = this._weightsOf(locality);
      if (perBone) known.push({ q, perBone });
    }
    this.groups = known;
  }

  _settled() {
    this.groups = [];
    if (this.held) this.letGo();
  }

  /** Weights of a group's bones; null until they have come. */
  _weightsOf(locality) {
    const key = JSON.stringify(locality);
    const { tree, weights } = this;
    if (!weights.has(key)) {
      weights.set(key, null);
      const all = locality
        ? this.client.reach(this.spectrumId, locality)
        : Promise.resolve(new Float32Array(tree.modes.V).fill(1));
      all.then((w) => weights.set(key, tree.modes.boneWeights(w)), this.onProblem);
    }
    return weights.get(key);
  }
}
