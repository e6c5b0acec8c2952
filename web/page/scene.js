// What stands on the stage: photos, the tree at rest, in motion, and what the job's files add.

import { hasStill } from "../client/states.js";
import { Person } from "../draw/person.js";
import { readSurface } from "../draw/surface.js";
import { Tree } from "../draw/tree.js";
import { Modes } from "../motion/modes.js";
import { $, element } from "./dom.js";
import { readStill } from "./still.js";

const MOST_PHOTOS = 24;
const TALLEST_M = 120; // of trees
const DRAFT = "draft.splat"; // of photos, while it is learned
const LEARNED = "splat.ply"; // of photos, at rest and in metres
const DRAFT_MS = 5000; // so often they are asked for
const LATE_MS = 1000; // then the service has yet to find how a tree moves
const MOVING_SPLAT = "tree.animated-splat.safetensors";

export class Scene {
  constructor(stage) {
    this.stage = stage;
    this.tree = null;
  }

  /**
   * Give it the service. `onMotion(tree, spectrum)` is called once there is a tree that moves, `onComplete(job, signal)` with
   * all of its files, `onDraft(height_m)` once what was dropped is drawn, null when it goes.
   */
  connect(client, { onMotion, onComplete, onDraft, onClear }) {
    Object.assign(this, { client, onMotion, onComplete, onDraft, onClear });
  }

  clear() {
    this.onClear();
    this.tree?.dispose();
    this.tree = null;
    this._dropDraft();
    this.complete = false; // the job's files are on the stage
    this.nextDraft = 0;
    this._dropPhotos();
    this._dropPoster();
  }

  _dropPhotos() {
    for (const picture of $("photos").children) URL.revokeObjectURL(picture.src);
    $("photos").replaceChildren();
  }

  /** Photos as photos: something to look at while the tree is reconstructed. */
  photos(files) {
    const pictures = files.filter(({ name }) => /\.(jpe?g|png|webp)$/i.test(name));
    if (pictures.length < files.length / 2 || files.some(({ name }) => /\.(gltf|obj|dae)$/i.test(name))) return; // textures
    const blobs = pictures.slice(0, MOST_PHOTOS).map((file) => file.content ?? file);
    $("photos").replaceChildren(...blobs.map((blob) => element("img", { src: URL.createObjectURL(blob), alt: "" })));
  }

  /** The still of a job that has ended, until its tree is drawn. */
  async poster(job, signal) {
    if (!hasStill(job)) return;
    const still = await readStill(this.client, job.id, { signal });
    if (!still || this.tree || signal.aborted) return;
    this.still = $("poster").src = URL.createObjectURL(still);
    $("poster").hidden = false;
  }

  _dropPoster() {
    if (!this.still) return;
    URL.revokeObjectURL(this.still);
    this.still = null;
    $("poster").hidden = true;
  }

  /** The splat of the photos so far, in their place, while it is learned. */
  async learned(job, signal) {
    if (this.tree || Date.now() < this.nextDraft) return;
    this.nextDraft = Date.now() + DRAFT_MS;
    const all = await this.client.artifacts(job.id);
    const file = all.find(({ name }) => name === LEARNED) ?? all.find(({ name }) => name === DRAFT);
    if (!file || file.id === this.draft?.id) return;
    const { id, name } = file;
    const content = new Blob([await this.client.bytes(file.url, { signal })]);
    await this.dropped([{ name, path: name, content }], { signal, id, isTree: name === LEARNED });
    if (this.draft) this._dropPhotos();
  }

  /**
   * What was dropped, from the files themselves, with a person beside it; until the service has read them. `isTree` where
   * it stands as the tree that moves will.
   */
  async dropped(files, { signal, id, isTree = false }) {
    const { readDropped } = await import("../draw/dropped.js");
    const draft = await readDropped(files, this.stage);
    if (!draft || draft.box.isEmpty()) return;
    if (signal.aborted || this.tree) return draft.dispose();
    const isFirst = !this.draft;
    this._dropDraft();
    this.draft = { ...draft, id, isTree };
    this.stage.scene.add(draft.object);
    if (isFirst || isTree) this.stage.frame(draft.box);
    Object.assign(this.stage.resolution, { frame: -1, since: -1 }); // the last shadow is another's: a new one comes at once
    this.person ??= new Person(this.stage);
    const sized = !draft.sizeless && this.stage.height <= TALLEST_M; // else the file means another unit
    this.person.show(sized, 1);
    if (sized) this.onDraft(this.stage.height);
  }

  _dropDraft() {
    if (!this.draft) return;
    this.stage.scene.remove(this.draft.object);
    this.draft.dispose();
    this._forgetDraft();
  }

  _forgetDraft() {
    this.draft = null;
    this.person.show(false, 1);
    this.onDraft(null);
  }

  /** What was uploaded, at rest. */
  async rest(asset, signal) {
    if (asset.kind === "mesh") {
      const surface = await readSurface(await this.client.assetSurface(asset.id, { signal }));
      if (!signal.aborted && !this.tree?.moves) this._tree().setSurface(surface);
    } else if (asset.kind === "cloud") {
      const { Points } = await import("../draw/points.js");
      const points = new Points(await this.client.bytes(`/v1/assets/${asset.id}/points`, { signal }));
      if (!signal.aborted && !this.complete) this._tree().setPoints(points);
    }
  }

  _tree() {
    this._dropDraft();
    this._dropPoster();
    this.tree ??= new Tree(this.stage);
    return this.tree;
  }

  /** A tree in motion from what is at hand: a surface that was read, and Modes; `hidden` where Gaussians will be seen. */
  stand(surface, modes, { hidden = false } = {}) {
    const learned = hidden && this.draft?.isTree ? this.draft : null;
    if (learned) this._forgetDraft();
    const tree = this._tree();
    if (learned) tree.setPoints(learned);
    tree.setSurface(surface, { hidden: hidden || Boolean(tree.points) });
    tree.setModes(modes);
    return tree;
  }

  /** The tree in motion, from the service's spectrum; of photos, the splat is seen at rest until it moves as well. */
  async motion(job, signal, { ofPhotos = false, hasEnded = false } = {}) {
    const hidden = ofPhotos && Boolean(job.params.formats?.includes("splat"));
    this.nextDraft = 0;
    if (hidden && !hasEnded) await this.learned(job, signal).catch(() => {}); // only a preview
    const id = job.result.spectrum_id;
    const asked = [this.client.spectrum(id), this.client.modes(id, { signal }), this.client.surface(id, { signal })];
    const late = setTimeout(() => this.poster(job, signal).catch(() => {}), LATE_MS); // only a preview
    asked[1].finally(() => clearTimeout(late)).catch(() => {}); // a still's file takes as long as the rest
    const [spectrum, modes, surface] = await Promise.all(asked);
    const read = await readSurface(surface);
    if (signal.aborted) return;
    const tree = this.stand(read, new Modes(modes), { hidden });
    if (hidden && hasEnded) await this._setGaussians(tree, await this.client.artifacts(job.id), signal);
    if (signal.aborted) return;
    if (!hidden || tree.points || tree.splat) this._dropPhotos();
    this.onMotion(tree, spectrum);
  }

  /** What only the job's files contain: Gaussians of a cloud or of photos. */
  async products(job, signal) {
    const { tree } = this;
    if (!tree?.moves || this.complete) return;
    this.complete = true;
    const artifacts = await this.client.artifacts(job.id);
    if (!tree.splat && !(await this._setGaussians(tree, artifacts, signal)) && tree.hidden) this.showMesh();
    if (signal.aborted) return;
    this._dropPhotos();
    this.onComplete(job, signal);
  }

  /** The mesh in place of what would be seen if the job had more files. */
  showMesh() {
    this.tree.showMesh();
    this._dropPhotos();
  }

  /** The job's Gaussians in place of the mesh; whether there are any. */
  async _setGaussians(tree, artifacts, signal) {
    const file = artifacts.find(({ name }) => name === MOVING_SPLAT);
    if (!file) return false;
    const { isUncoloured, readSplat } = await import("../draw/splat.js");
    const splat = readSplat(await this.client.bytes(file.url, { signal }));
    if (signal.aborted) return true;
    if (isUncoloured(splat)) tree.showMesh();
    else await tree.setSplat(splat);
    return true;
  }
}
