// One archive for each program: the files that it reads best, and ten lines that say what to do with them.

import KITS from "../texts/kits.js";
import { $, button, element, fill, saveBlob } from "./dom.js";
import { fileName } from "./names.js";
import { partsOf } from "./parts.js";
import { percent, text } from "./texts.js";
import { webFolder } from "./web_folder.js";

/** What is in the files is packed already, or small; the same files make the same archive. */
const AS_THEY_ARE = { level: 0, mtime: "1980-01-01" };

export class KitDialog {
  /** `tree()` gives `{ job, name, kind }` of what is on the stage; `onMade(job)` is called with jobs that write formats. */
  constructor(client, { tree, onMade, onProblem }) {
    Object.assign(this, { client, tree, onMade, onProblem });
    $("download").onclick = () => this.show();
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
      const onJob = ({ progress }) => fill(words, text("kit.making", { share: percent(progress) }));
      onJob({ progress: 0 });
      const files = program === "web" ? await this._page(job) : await this._files(program, kind, onJob);
      const readme = new TextEncoder().encode(KITS[program].readme(name));
      const contents = Object.fromEntries(files.map((file) => [file.name, file.bytes]));
      const { zipSync } = await import("fflate");
      const archive = zipSync({ "README.txt": readme, ...contents }, AS_THEY_ARE);
      saveBlob(fileName(name, `-${program}.zip`), new Blob([archive], { type: "application/zip" }));
    } catch (error) {
      $("kits").close();
      this.onProblem(error);
    }
    node.disabled = false;
    fill(words, before);
  }

  /** The artifacts of formats of the tree on the stage; with `own` parameters, which no earlier job wrote them with. */
  artifacts(formats, onJob, own = null) {
    const { job } = this.tree();
    const wanted = own ? { ...job, params: { ...job.params, ...own, formats: [] } } : job;
    const onMade = own ? () => {} : this.onMade; // the list of files is of the tree's own parameters
    return filesOf(this.client, wanted, formats, { onJob, onMade });
  }

  async _files(program, kind, onJob) {
    const files = await this.artifacts(formatsOf(program, kind), onJob, KITS[program].params?.[kind]);
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

/** A turbulent motion never repeats; a file that holds one period has the loop of the same wind. */
const LOOP = { wind_mode: "loop", num_frames: null };

/** The artifacts of a job's formats. Those that it has not are made by others, which `onJob` follows and `onMade` gets. */
export async function filesOf(client, { id, asset_id, preset, seed, params }, formats, { onJob, onMade }) {
  const { products } = await client.json("GET", "/v1/limits");
  const endless = products.filter(({ options }) => options.includes("wind_mode")).map(({ format }) => format);
  const fits = (format) => params.wind_mode !== "turbulent" || endless.includes(format);
  const missing = formats.filter((format) => !params.formats.includes(format));
  const from = missing.length < formats.length ? [id] : [];
  const requests = [
    { ...params, formats: missing.filter(fits) },
    { ...params, ...LOOP, formats: missing.filter((format) => !fits(format)) },
  ];
  for (const own of requests.filter((request) => request.formats.length)) {
    const job = await client.createJob({ type: "animate", asset_id, preset, seed, params: own });
    await client.wait(job.id, { onJob });
    onMade(job);
    from.push(job.id);
  }
  const lists = await Promise.all(from.map((one) => client.artifacts(one)));
  const files = new Map(lists.flat().map((file) => [file.name, file]));
  const names = products.filter(({ format }) => formats.includes(format)).map((product) => product.file_name);
  return names.map((name) => files.get(name)).filter(Boolean);
}

/** Formats for a program, of a mesh or of a cloud; null where it takes none. */
const formatsOf = (program, kind) => KITS[program][kind === "cloud" ? "cloud" : "mesh"] ?? null;
