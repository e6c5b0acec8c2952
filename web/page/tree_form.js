// The panel's tree: height, which way is up, gust, chance, and of a cloud the box that moves.

import * as THREE from "three";
import { Person } from "../draw/person.js";
import { AXES, toZUp } from "../draw/upright.js";
import { $, describe, element, fill } from "./dom.js";
import { fromUnit, length, lengthUnit, number, text, toUnit } from "./texts.js";

const PERSON_M = 1.75; // as draw/person.js draws it
const LEAST_SEEN = 0.015; // of the tree's height: ten pixels of a usual window
const SIDES = ["x", "y", "z"].flatMap((axis) => [`${axis}-low`, `${axis}-high`]);

export class TreeForm {
  /** `onApply({ reading, request, newUpload })`; `tree()` gives the tree on the stage. */
  constructor(stage, { onApply, tree }) {
    Object.assign(this, { stage, onApply, tree });
    this._listAxes();
    $("crop").replaceChildren(...SIDES.map(cropSlider));
    $("crop").oninput = () => this._showBox();
    $("crop-on").onchange = () => this._showBox();
    $("up-axis").onchange = () => this._preview();
    $("tree-height").oninput = () => this._preview();
    $("gust").oninput = () => this._showGust();
    $("another-seed").onclick = () => {
      this.request.seed = Math.floor(Math.random() * 2 ** 31);
      this._apply({});
    };
    $("apply-tree").onclick = () => this._apply(this._reading());
    $("tree-details").ontoggle = () => this._showPerson();
    $("tree-details").addEventListener("input", () => {
      this.touched = true;
    });
  }

  /** Take what is known of the tree; `files` allow to read them anew. */
  set({ asset, job, files }) {
    if (!asset || (this.asset === asset && this.job?.id === job?.id)) return;
    const known = this.asset === asset;
    Object.assign(this, { asset, job, files });
    this.request = { seed: job?.seed ?? 0 };
    if (known && this.touched) return; // something was chosen before the first job was there
    const { extent_m: extent, source_up_axis: up } = asset.summary;
    this.height = extent ? extent[2] : (job?.params.height_m ?? 1);
    $("tree-height").value = toUnit(this.height).toFixed(2);
    fill($("tree-unit"), lengthUnit);
    this._listAxes(up);
    $("up-axis").value = up ?? "+Z";
    $("gust").value = job?.params.wind?.gust ?? 0.3;
    this._listTrees(asset.summary.trees ?? [], job?.params.tree);
    const canReread = asset.kind === "photos" || Boolean(files);
    for (const id of ["tree-height", "up-axis"]) $(id).disabled = !canReread;
    $("up-box").hidden = asset.kind === "photos";
    $("plant-section").hidden = asset.kind !== "photos";
    $("reread-note").hidden = canReread;
    $("crop-box").hidden = asset.kind !== "cloud";
    this._setBox(job?.params.box_m);
    this._showGust();
    this._preview();
  }

  /** Make the tree again, so high. */
  makeHigh(height_m) {
    $("tree-height").value = toUnit(height_m);
    this._apply(this._reading());
  }

  clear() {
    this.asset = this.job = null;
    this.touched = false;
    this.helper?.removeFromParent();
    this.helper = null;
    this.person?.show(false, 1);
  }

  // ---- what is asked for

  /** How the files are to be read: only what differs from how they were. */
  _reading() {
    const { source_up_axis: up, source_scale: scale = 1 } = this.asset.summary;
    const wanted = fromUnit(Number($("tree-height").value));
    const axis = $("up-axis").value;
    const turned = this._turnedHeight(axis);
    if (this.asset.kind === "photos") return wanted === this.height ? {} : { height_m: wanted };
    const reading = /** @type {any} */ ({});
    if (axis !== (up ?? axis)) reading.upAxis = axis;
    if (Math.abs(wanted - this.height) > 0.005 * this.height) reading.unitM = (scale * wanted) / turned;
    if (Object.keys(reading).length) reading.upAxis = axis;
    if (reading.upAxis && !reading.unitM) reading.unitM = scale;
    return reading;
  }

  /** The six axes, and the direction along which the file was levelled. */
  _listAxes(up = "+Z") {
    const names = AXES.includes(up) ? AXES : [up, ...AXES];
    const words = (axis) => (AXES.includes(axis) ? axis : text("tree.level"));
    $("up-axis").replaceChildren(...names.map((axis) => element("option", { value: axis }, words(axis))));
  }

  /** Of a file of several trees one can be chosen; otherwise each moves by itself. */
  _listTrees(trees, chosen) {
    const words = ({ tree, height_m: high }) => text("tree.nth", { n: number(tree), height: length(high) });
    const options = trees.map((entry) => element("option", { value: entry.tree }, words(entry)));
    $("which-tree").replaceChildren(
      element("option", { value: "" }, text("tree.all", { n: trees.length })),
      ...options,
    );
    $("which-tree").value = chosen ?? "";
    $("which-box").hidden = trees.length < 2;
  }

  /** The tree's height if `axis` of its file were up [m]. */
  _turnedHeight(axis) {
    const { extent_m: extent = [1, 1, this.height] } = this.asset.summary;
    const size = new THREE.Vector3(...extent).applyMatrix3(this._turn(axis));
    return Math.abs(size.z);
  }

  /** The rotation from how the tree stands now to how it would stand. */
  _turn(axis) {
    return toZUp(axis).multiply(toZUp(this.asset.summary.source_up_axis ?? "+Z").transpose());
  }

  _apply(/** @type {any} */ { height_m: height, ...reading }) {
    const { wind = {}, formats: _, ...params } = this.job?.params ?? {};
    const request = {
      seed: this.request.seed,
      params: { ...params, wind: { ...wind, gust: Number($("gust").value) } },
    };
    if (!$("which-box").hidden) request.params.tree = Number($("which-tree").value) || null;
    if (height) request.params.height_m = height;
    if (this.asset.kind === "cloud") request.params.box_m = $("crop-on").checked ? this._box() : null;
    this.onApply({ reading, request, newUpload: Object.keys(reading).length > 0 });
  }

  // ---- what is seen of it

  _showGust() {
    describe($("gust"), $("gust-out"), `${number(100 * Number($("gust").value))} %`);
  }

  /** Turn and scale the tree at rest as the form says. */
  _preview() {
    const { group, box } = this.tree() ?? {}; // of the tree alone, not of a forest
    if (!box || !this.asset) return this._showPerson();
    const moved = $("up-axis").value !== (this.asset.summary.source_up_axis ?? "+Z");
    const middle = box.getCenter(new THREE.Vector3());
    group.matrixAutoUpdate = false;
    group.matrix.identity();
    if (moved) {
      const turn = new THREE.Matrix4().setFromMatrix3(this._turn($("up-axis").value));
      const bottom = this._turnedHeight($("up-axis").value) / 2;
      group.matrix.makeTranslation(middle.x, middle.y, box.min.z + bottom).multiply(turn);
      group.matrix.multiply(new THREE.Matrix4().makeTranslation(-middle.x, -middle.y, -middle.z));
    }
    this.stage.stale = true;
    this._showPerson();
  }

  /** A person of 1.75 m beside a tree of the height that the form says. */
  _showPerson() {
    const visible = $("tree-details").open && Boolean(this.asset);
    this.person ??= new Person(this.stage);
    const wanted = fromUnit(Number($("tree-height").value)) || this.height;
    this.person.show(visible, this.height ? this.height / wanted : 1);
    const seen = visible && PERSON_M > LEAST_SEEN * wanted;
    fill($("person-note"), seen ? text("tree.person", { height: length(PERSON_M) }) : "");
  }

  // ---- crop box

  _setBox(box) {
    const { low_m: low, extent_m: extent } = this.asset.summary;
    $("crop-on").checked = Boolean(box);
    SIDES.forEach((side, i) => {
      const axis = Math.floor(i / 2);
      const value = box && extent ? (box[i % 2][axis] - low[axis]) / extent[axis] : i % 2;
      $(`crop-${side}`).value = Math.min(Math.max(value, 0), 1);
    });
    this._showBox();
  }

  /** Low and high corner [m]. */
  _box() {
    const { low_m: low, extent_m: extent } = this.asset.summary;
    const at = (side, axis) => low[axis] + extent[axis] * Number($(`crop-${side}`).value);
    const corners = [0, 1, 2].map((axis) => [at(SIDES[2 * axis], axis), at(SIDES[2 * axis + 1], axis)]);
    return [corners.map((pair) => Math.min(...pair)), corners.map((pair) => Math.max(...pair))];
  }

  _showBox() {
    const on = $("crop-on").checked && this.asset?.kind === "cloud";
    $("crop").hidden = !on;
    this.helper?.removeFromParent();
    this.helper = null;
    if (on) {
      const [low, high] = this._box().map((corner) => new THREE.Vector3(...corner));
      this.helper = new THREE.Box3Helper(new THREE.Box3(low, high), 0x2563a8);
      this.stage.scene.add(this.helper);
      for (const side of SIDES) describe($(`crop-${side}`), null, `${number(100 * Number($(`crop-${side}`).value))} %`);
    }
    this.stage.stale = true;
  }
}

function cropSlider(side) {
  const input = element("input", { type: "range", id: `crop-${side}`, min: 0, max: 1, step: 0.01 });
  input.setAttribute("aria-label", text(`crop.${side}`));
  return element("li", {}, element("span", {}, text(`crop.${side}`)), input);
}
