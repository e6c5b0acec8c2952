// The panel's files: what a job has written, what is being written, what can be.

import { hasEnded } from "../client.js";
import { $, button, element, keyedChildren, saveBlob } from "./dom.js";
import { warningsOf } from "./doubt.js";
import { filesOf } from "./kits.js";
import { fileName, nameTag } from "./names.js";
import { store, stored } from "./storage.js";
import { bytes, percent, text, textOrNull } from "./texts.js";

const MOST_BESIDE = 24; // as many formats as there are
const INNER = new Set(["mesh.safetensors", "cloud.safetensors", "photos.safetensors", "draft.splat", "still.webp"]); // for stages, strokes, a first look

export class Files {
  /** `products()` are those of /v1/limits, a promise; `onDoubts(sentences)` gets what a report of photos warns of. */
  constructor(client, { products, onDoubts, onProblem }) {
    Object.assign(this, { client, products, onDoubts, onProblem });
    this.clear();
    $("more").ontoggle = () => $("more").open && this._offer();
  }

  clear() {
    this.listed = new Map(); // by name
    this.job = this.report = this.seen = null;
    this.treeName = "";
    $("artifacts").replaceChildren();
    $("more").open = false;
  }

  /** Take a job's state: list the files that it has written so far. */
  async follow(job, treeName) {
    this.job ??= job;
    const owner = this.job;
    if (treeName) this.treeName = treeName;
    const key = JSON.stringify([job.id, job.state, job.result]);
    if (!job.result || this.seen === key) return;
    this.seen = key;
    const ids = new Set([...this._beside(), job.id]);
    const lists = await Promise.all([...ids].map((id) => this.client.artifacts(id).catch(() => [])));
    if (owner !== this.job) return; // another tree is on the stage by now
    for (const artifact of lists.flat()) if (!INNER.has(artifact.name)) this.listed.set(artifact.name, artifact);
    this._show(await this.products());
    const report = this.listed.get("report.json");
    if (!hasEnded(job) || !report || report.id === this.report) return;
    this.report = report.id;
    const warnings = await warningsOf(this.client, report);
    if (owner === this.job && warnings.length) this.onDoubts(warnings);
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

  /** Products first, in the service's order, then what else the job has written. */
  _show(products) {
    const formats = new Map(products.map(({ format, file_name }) => [file_name, format]));
    const order = [...formats.keys()];
    const rank = (name) => (formats.has(name) ? order.indexOf(name) : order.length);
    const names = [...this.listed.keys()].sort((a, b) => rank(a) - rank(b));
    const title = (name) => textOrNull(`format.${formats.get(name)}`) ?? textOrNull(`file.${name}`) ?? name;
    keyedChildren($("artifacts"), names, (name) => element("li", {}, this._link(this.listed.get(name), title(name))));
  }

  /** "oak.glb" for the tree.glb of oak.obj, "oak-preview.png" for its preview.png. */
  _fileName(name) {
    return fileName(this.treeName, name.startsWith("tree") ? name.slice(4) : `-${name}`);
  }

  _link({ name, bytes: size, url }, words) {
    const download = this._fileName(name);
    const href = `${url}?filename=${encodeURIComponent(download)}`;
    const facts = [element("small", {}, bytes(size)), element("small", {}, nameTag(download))];
    const link = element("a", { href, download }, element("b", {}, words), ...facts);
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
    const formats = (await this.products()).map(({ format }) => format);
    keyedChildren($("more-formats"), formats, (format) => {
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
