// The panel's files: what a job has written, what is being written, what can be.

import { hasEnded } from "../client.js";
import { $, button, element, keyedChildren, saveBlob } from "./dom.js";
import { filesOf } from "./kits.js";
import { fileName, nameTag } from "./names.js";
import { store, stored } from "./storage.js";
import { bytes, percent, text, textOrNull } from "./texts.js";

/** In the order in which they are listed. */
const ORDER = [
  "tree.glb",
  "tree.animated-splat.safetensors",
  "tree-8-targets.glb",
  "tree-skinned.glb",
  "tree.usdz",
  "tree.abc",
  "tree.lod.zip",
  "tree.vat.zip",
  "motion.ply.zip",
  "splat.ply.zip",
  "motion.safetensors",
  "preview.mp4",
  "preview.webp",
  "preview.png",
  "mesh.ply",
  "tree.spectrum.safetensors",
  "tree.voxels.safetensors",
];
const MOST_BESIDE = 24; // as many formats as there are
const INNER = new Set(["mesh.safetensors", "cloud.safetensors", "photos.safetensors", "draft.splat"]); // for stages, strokes, a first look

export class Files {
  constructor(client, { onProblem }) {
    Object.assign(this, { client, onProblem });
    this.clear();
    $("more").ontoggle = () => $("more").open && this._offer();
  }

  clear() {
    this.listed = new Map(); // by name
    this.job = null;
    this.treeName = "";
    $("artifacts").replaceChildren();
    $("more").open = false;
  }

  /** Take a job's state: list the files that it has written so far. */
  async follow(job, treeName) {
    this.job ??= job;
    const owner = this.job;
    if (treeName) this.treeName = treeName;
    const key = JSON.stringify(job.result);
    if (!job.result || (this.seen === key && !hasEnded(job))) return;
    this.seen = key;
    const ids = new Set([...this._beside(), job.id]);
    const lists = await Promise.all([...ids].map((id) => this.client.artifacts(id).catch(() => [])));
    if (owner !== this.job) return; // another tree is on the stage by now
    for (const artifact of lists.flat()) if (!INNER.has(artifact.name)) this.listed.set(artifact.name, artifact);
    this._show();
  }

  /** A job has written other formats of the tree of job `id`. */
  made(job, id = this.job.id) {
    store(`formats ${id}`, JSON.stringify([...this._beside(id), job.id].slice(-MOST_BESIDE)));
    if (this.job.id === id) this.client.job(job.id).then((ended) => this.follow(ended));
  }

  /** Jobs that this browser has asked for other formats of the same tree; these are stored for when it is opened again. */
  _beside(id = this.job.id) {
    return JSON.parse(stored(`formats ${id}`) ?? "[]");
  }

  _show() {
    const rank = (name) => ORDER.indexOf(name) + 1 || ORDER.length + 1;
    const names = [...this.listed.keys()].sort((a, b) => rank(a) - rank(b));
    keyedChildren($("artifacts"), names, (name) => element("li", {}, this._link(this.listed.get(name))));
  }

  /** "oak.glb" for the tree.glb of oak.obj, "oak-preview.png" for its preview.png. */
  _fileName(name) {
    return fileName(this.treeName, name.startsWith("tree") ? name.slice(4) : `-${name}`);
  }

  _link({ name, bytes: size, url }) {
    const download = this._fileName(name);
    const href = `${url}?filename=${encodeURIComponent(download)}`;
    const title = element("b", {}, textOrNull(`file.${name}`) ?? name);
    const words = [title, element("small", {}, bytes(size)), element("small", {}, nameTag(download))];
    const link = element("a", { href, download }, ...words);
    link.onclick = (event) => {
      if (!this.client.key) return; // a link sends no key
      event.preventDefault();
      this._save(download, url);
    };
    return link;
  }

  async _save(name, url) {
    try {
      saveBlob(name, new Blob([await this.client.bytes(url)]));
    } catch (error) {
      this.onProblem(error);
    }
  }

  /** The service's products, with what each is for. */
  async _offer() {
    try {
      this.formats ??= (await this.client.json("GET", "/v1/limits")).products.map(({ format }) => format);
    } catch (error) {
      return this.onProblem(error);
    }
    keyedChildren($("more-formats"), this.formats, (format) => {
      const chip = button(textOrNull(`format.${format}`) ?? format.toUpperCase(), () => this._make(format, chip));
      return element("li", {}, chip, element("small", {}, textOrNull(`format.${format}.for`) ?? ""));
    });
  }

  /** Write one more format; the chip shows how far it is. */
  async _make(format, chip) {
    const label = chip.textContent;
    const owner = this.job;
    const onJob = (job) => {
      chip.style.setProperty("--share", percent(job.progress));
      chip.textContent = `${label} · ${job.state === "queued" ? text("title.queued") : percent(job.progress)}`;
      if (this.job === owner) this.follow(job);
    };
    chip.disabled = true;
    try {
      await filesOf(this.client, owner, [format], { onJob, onMade: (job) => this.made(job, owner.id) });
    } catch (error) {
      if (this.job === owner) this.onProblem(error);
    }
    chip.textContent = label;
    chip.style.removeProperty("--share");
    chip.disabled = false;
  }
}
