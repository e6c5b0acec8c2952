// The panel's company: the tree alone, beside itself in another wind or in other gusts, or in a forest of its own kind.

import { Problem } from "../client.js";
import { $, describe, fill } from "./dom.js";
import { percent, speed, text } from "./texts.js";

const SEEDS = 2 ** 31;

export class CompanyPanel {
  /** `otherMotion({ signal, onProgress })` makes the same tree's motion in other gusts, see `makeOther`. */
  constructor(stage, player, { otherMotion, onProblem }) {
    Object.assign(this, { stage, player, otherMotion, onProblem });
    $("company").onchange = $("pair-kinds").onchange = () => this.show();
    $("other-speed").oninput = () => this.show();
  }

  /** Another tree begins: of it no motion but its own is known. */
  clear() {
    this.run?.abort();
    this.other?.field.dispose();
    this.run = this.other = null;
    choose("speed");
    this.place();
  }

  show() {
    const { player, other } = this;
    if (!player.tree?.moves) return;
    const gaussians = Boolean(player.tree.hidden); // they have no copies
    const kind = gaussians ? "one" : $("company").querySelector(":checked").value;
    const gusts = $("pair-kinds").querySelector(":checked").value === "gusts";
    const right = Number($("other-speed").value);
    $("company").hidden = gaussians;
    $("pair-box").hidden = kind !== "pair";
    $("other-speed").hidden = $("other-speed-label").hidden = gusts;
    $("pair-note").hidden = !gusts;
    describe($("other-speed"), $("other-speed-out"), speed(right));
    if (kind === "pair" && gusts && !other) this._make();
    if (other) fill($("pair-note"), text("pair.made"));
    player.setCompany(kind, gusts ? null : right, kind === "pair" && gusts ? other : null);
  }

  /** Ask the model for the other gusts, once a tree. */
  async _make() {
    if (this.run) return;
    const run = new AbortController();
    const { signal } = run;
    this.run = run;
    fill($("pair-note"), text("pair.waiting"));
    const onProgress = (share) =>
      !signal.aborted && fill($("pair-note"), text("pair.making", { share: percent(share) }));
    try {
      const other = await this.otherMotion({ signal, onProgress });
      if (signal.aborted) return other.field.dispose();
      this.other = other;
      await this.takeWind();
    } catch (error) {
      if (signal.aborted) return;
      choose("speed");
      this.onProblem(error);
    }
    this.run = null;
    this.show();
  }

  /** The other motion's endless wind, where the tree's own is played. */
  async takeWind() {
    const { other, player } = this;
    if (other && player.turbulent) other.turbulent ??= await other.wind();
  }

  /** What stands under each of the two; once a drawn frame. */
  place() {
    const { company, tree, speed: own, otherSpeed, other } = this.player;
    const named = company === "pair" && tree?.copies?.mesh.visible && (other || otherSpeed !== null);
    $("plates").hidden = !named;
    if (!named) return;
    const words = other ? [text("pair.left"), text("pair.right")] : [speed(own), speed(otherSpeed)];
    const places = [{ x: 0, y: 0 }, ...tree.copies.places];
    const { min, max } = tree.box;
    [...$("plates").children].forEach((plate, i) => {
      const { x, y } = places[i];
      const at = this.stage.onScreen([(min.x + max.x) / 2 + x, (min.y + max.y) / 2 + y, min.z]);
      fill(plate, words[i]);
      plate.style.transform = `translate(-50%, 14px) translate(${at.x}px, ${at.y}px)`;
    });
  }
}

const choose = (kind) => {
  $("pair-kinds").querySelector(`[value=${kind}]`).checked = true;
};

/** The motion of the same tree in the same wind with the next seed, by a job of its own: see Scene.otherMotion. */
export async function makeOther(client, scene, job, { signal, onProgress }) {
  const { asset_id, preset, seed, params } = job;
  const request = { type: "animate", asset_id, preset, seed: (seed + 1) % SEEDS, params };
  let made = await client.createJob(request, { signal });
  for await (made of client.watch(made.id, { signal })) {
    onProgress(made.progress);
    if (made.result?.spectrum_id) return scene.otherMotion(made.result.spectrum_id, signal);
  }
  throw new Problem(made.error ?? { code: `job-${made.state}` });
}
