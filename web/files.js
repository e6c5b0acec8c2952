// The panel's files: what a job has made, what is being made, what could be.

import { hasEnded } from "./client.js";
import { $, button, element, size } from "./page.js";

const NAMES = {
  // in the order in which they are listed
  "tree.glb": "Animated GLB",
  "tree.animated-splat.safetensors": "Animated splat",
  "tree-8-targets.glb": "Animated GLB, 8 targets",
  "tree-skinned.glb": "Skinned GLB",
  "tree.usdz": "USD",
  "tree.vat.zip": "Vertex animation texture",
  "motion.ply.zip": "PLY sequence",
  "splat.ply.zip": "Splat sequence",
  "motion.safetensors": "Motion, every frame",
  "preview.mp4": "Preview, video",
  "preview.webp": "Preview, animated",
  "preview.png": "Preview picture",
  "mesh.ply": "Reconstructed mesh",
  "tree.spectrum.safetensors": "Spectrum",
  "tree.voxels.safetensors": "Voxels",
};
const FORMATS = {
  glb: "GLB",
  "glb-reduced": "GLB, 8 targets",
  "glb-skinned": "GLB, skinned",
  usd: "USD",
  vat: "Vertex texture",
  ply: "PLY sequence",
  motion: "Motion",
  "splat-ply": "Splat sequence",
  splat: "Splat",
  png: "Picture",
  webp: "WebP",
  mp4: "MP4",
};
const INNER = new Set(["mesh.safetensors", "cloud.safetensors"]); // for the stages after
const ORDER = Object.keys(NAMES);

export class Files {
  constructor(client, { onProblem }) {
    Object.assign(this, { client, onProblem });
    this.clear();
    $("more").ontoggle = () => $("more").open && this._offer();
  }

  clear() {
    this.listed = new Map(); // by name
    this.making = new Map(); // job id to its last state
    this.job = null;
    $("artifacts").replaceChildren();
    $("more").open = false;
  }

  /** Take a job's state: while it runs its bar is shown, then its files. */
  async follow(job) {
    this.job ??= job;
    const owner = this.job;
    if (hasEnded(job)) this.making.delete(job.id);
    else this.making.set(job.id, job);
    const made = job.result ? await this.client.artifacts(job.id).catch(() => []) : [];
    if (owner !== this.job) return; // another tree is on the stage by now
    for (const artifact of made) if (!INNER.has(artifact.name)) this.listed.set(artifact.name, artifact);
    this._show();
  }

  _show() {
    const rank = ({ name }) => ORDER.indexOf(name) + 1 || ORDER.length + 1;
    const all = [...this.listed.values()].sort((a, b) => rank(a) - rank(b));
    const items = all.map((artifact) => element("li", {}, this._link(artifact)));
    for (const { progress, params } of this.making.values()) {
      const wanted = (params.formats ?? []).map((format) => FORMATS[format] ?? format).join(", ");
      items.unshift(
        element("li", { className: "making" }, `Writing ${wanted}`, element("progress", { max: 1, value: progress })),
      );
    }
    $("artifacts").replaceChildren(...items);
  }

  _link({ name, bytes, url }) {
    const link = element(
      "a",
      { href: url, download: name },
      element("b", {}, NAMES[name] ?? name),
      element("small", {}, size(bytes)),
      element("small", {}, name),
    );
    // a link sends no key
    if (this.client.key)
      link.onclick = (event) => {
        event.preventDefault();
        this._save(name, url);
      };
    return link;
  }

  async _save(name, url) {
    try {
      const blob = URL.createObjectURL(new Blob([await this.client.bytes(url)]));
      element("a", { href: blob, download: name }).click();
      setTimeout(() => URL.revokeObjectURL(blob), 60_000);
    } catch (error) {
      this.onProblem(error);
    }
  }

  /** Formats that the service's own description knows. */
  async _offer() {
    try {
      this.known ??= formatsOf(await this.client.json("GET", "/openapi.json"));
    } catch (error) {
      return this.onProblem(error);
    }
    const buttons = this.known.map((format) =>
      element(
        "li",
        {},
        button(FORMATS[format] ?? format.toUpperCase(), (event) => this._make(format, event.target)),
      ),
    );
    $("more-formats").replaceChildren(...buttons);
  }

  async _make(format, pressed) {
    pressed.disabled = true;
    const owner = this.job;
    const { asset_id, preset, seed, params } = owner;
    const follow = (job) => this.job === owner && this.follow(job);
    try {
      const job = await this.client.createJob({
        type: "animate",
        asset_id,
        preset,
        seed,
        params: { ...params, formats: [format] },
      });
      await this.client.wait(job.id, { onJob: follow });
    } catch (error) {
      if (error.job) follow(error.job);
      if (this.job === owner) this.onProblem(error);
    }
    pressed.disabled = false;
  }
}

function formatsOf({ components: { schemas } }) {
  const known = (schema) => {
    if (!schema) return [];
    if (schema.$ref) return known(schemas[schema.$ref.split("/").pop()]);
    return schema.enum ?? [...known(schema.items), ...(schema.anyOf ?? []).flatMap(known)];
  };
  return known(schemas.AnimateParams.properties.formats);
}
