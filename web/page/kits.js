// One archive for each program: the files that it reads best, and ten lines that say what to do with them.

import KITS from "../texts/kits.js";
import { $, button, element, fill, saveBlob } from "./dom.js";
import { fileName } from "./names.js";
import { partsOf } from "./parts.js";
import { percent, text } from "./texts.js";
import { webFolder } from "./web_folder.js";
import { zipped } from "./zip.js";

export class KitDialog {
  /** `tree()` gives `{ job, name, kind }` of what is on the stage; `onMade(job)` is called with jobs that write formats. */
  constructor(client, { tree, onMade, onProblem }) {
    Object.assign(this, { client, tree, onMade, onProblem });
    $("download").onclick = () => this.show();
    $("kits").querySelector(".close").onclick = () => $("kits").close();
  }

  show() {
    const { kind } = this.tree();
    const rows = Object.keys(KITS).filter((program) => formatsOf(program, kind));
    const row = (program) => {
      const take = button(text(`kit.${program}`), () => this._take(program, take), { className: "kit" });
      take.append(element("small", {}, text(`kit.${program}.for`)));
      return element("li", {}, take);
    };
    $("kit-list").replaceChildren(...rows.map(row));
    $("kits").showModal();
  }

  async _take(program, node) {
    const words = node.lastElementChild;
    const before = words.textContent;
    node.disabled = true;
    try {
      const { name, kind, job } = this.tree();
      const onShare = (share) => fill(words, text("kit.making", { share: percent(share) }));
      const files =
        program === "web" ? await this._page(job) : await this._files(job, formatsOf(program, kind), onShare);
      const readme = { name: "README.txt", bytes: new TextEncoder().encode(KITS[program].readme(name)) };
      saveBlob(fileName(name, `-${program}.zip`), zipped([readme, ...files]));
    } catch (error) {
      $("kits").close();
      this.onProblem(error);
    }
    node.disabled = false;
    fill(words, before);
  }

  /** The formats' files; those that the job has not are made. */
  async _files({ id, asset_id, preset, seed, params }, formats, onShare) {
    onShare(0);
    const missing = formats.filter((format) => !params.formats.includes(format));
    let from = [id];
    if (missing.length) {
      const request = { type: "animate", asset_id, preset, seed, params: { ...params, formats: missing } };
      const job = await this.client.createJob(request);
      await this.client.wait(job.id, { onJob: ({ progress }) => onShare(progress) });
      this.onMade(job);
      from = missing.length < formats.length ? [id, job.id] : [job.id];
    }
    const { products } = await this.client.json("GET", "/v1/limits");
    const names = products.filter(({ format }) => formats.includes(format)).map((product) => product.file_name);
    const lists = await Promise.all(from.map((one) => this.client.artifacts(one)));
    const wanted = new Map(lists.flat().map((file) => [file.name, file]));
    const files = names.map((name) => wanted.get(name)).filter(Boolean);
    return Promise.all(
      files.map(async ({ name, url }) => ({ name, bytes: new Uint8Array(await this.client.bytes(url)) })),
    );
  }

  async _page(job) {
    const read = async (path) => new Uint8Array(await this.client.bytes(path));
    const parts = Object.entries(await partsOf(this.client, job));
    const contents = await Promise.all(parts.map(async ([part, path]) => [part, await read(path)]));
    return webFolder(Object.fromEntries(contents), (path) => read(`/${path}`));
  }
}

/** Formats for a program, of a mesh or of a cloud; null where it takes none. */
const formatsOf = (program, kind) => KITS[program][kind === "cloud" ? "cloud" : "mesh"] ?? null;
