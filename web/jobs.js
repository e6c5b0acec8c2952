// The list of jobs.

import { hasEnded } from "./client.js";
import { $, button, element } from "./page.js";

const KINDS = { animate: "Motion", diffuse: "Spectrum", voxelize: "Voxels", reconstruct: "Photos to a mesh" };
const AGAIN_MS = 2000;

export class JobList {
  constructor(client, { onOpen, onProblem }) {
    Object.assign(this, { client, onOpen, onProblem });
    this.dialog = $("jobs");
    this.names = new Map(); // of assets
    this.dialog.querySelector(".close").onclick = () => this.dialog.close();
    $("more-jobs").onclick = () => {
      this.limit = Math.min(this.limit + 20, 100);
      this._load();
    };
  }

  async show() {
    this.limit = 20;
    if (!(await this._load())) return;
    this.dialog.showModal();
    const again = setInterval(() => (this.dialog.open ? this._load() : clearInterval(again)), AGAIN_MS);
  }

  async _load() {
    try {
      const { data, next_cursor: next } = await this.client.jobs({ limit: this.limit });
      await Promise.all(data.map(({ asset_id: id }) => this._name(id)));
      this._fill(data);
      $("more-jobs").hidden = !next || this.limit >= 100;
      return true;
    } catch (error) {
      this.dialog.close();
      this.onProblem(error);
      return false;
    }
  }

  async _name(id) {
    if (this.names.has(id)) return;
    const asset = await this.client.asset(id).catch(() => null); // an asset that has expired leaves its jobs
    this.names.set(
      id,
      asset ? (asset.kind === "photos" ? `${asset.parts.length} photos` : asset.parts[0].name) : "Upload expired",
    );
  }

  _fill(data) {
    const focused = document.activeElement?.dataset?.key;
    const items = data.length ? data.map((job) => this._item(job)) : [element("li", {}, "No jobs yet.")];
    $("job-list").replaceChildren(...items);
    if (focused) $("job-list").querySelector(`[data-key="${focused}"]`)?.focus();
  }

  _item(job) {
    const wind = job.params?.wind ? ` · ${job.params.wind.speed_m_s} m/s` : "";
    const when = new Date(job.created_at).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
    const state = job.state === "running" ? `running, ${Math.round(job.progress * 100)} %` : job.state;
    const actions = element("span", { className: "actions" });
    const act = (name, onclick) => {
      const made = button(name, onclick);
      made.dataset.key = `${name} ${job.id}`;
      made.setAttribute("aria-label", `${name} ${this.names.get(job.asset_id)}, ${when}`);
      actions.append(made);
    };
    if (!hasEnded(job)) act("Cancel", () => this._do(this.client.cancel(job.id)));
    if (hasEnded(job) && job.state !== "succeeded") act("Retry", () => this._do(this.client.retry(job.id)));
    act("Open", () => {
      this.dialog.close();
      this.onOpen(job);
    });
    const why = job.error ? element("small", {}, `${job.error.title}: ${job.error.detail}`) : "";
    return element(
      "li",
      { className: job.state },
      element(
        "span",
        {},
        element("b", {}, this.names.get(job.asset_id) ?? ""),
        ` ${KINDS[job.type] ?? job.type}${wind}`,
      ),
      actions,
      element("small", {}, element("span", { className: "state" }, state), ` · ${when}`),
      why,
    );
  }

  async _do(promise) {
    try {
      await promise;
      await this._load();
    } catch (error) {
      this.dialog.close();
      this.onProblem(error);
    }
  }
}
