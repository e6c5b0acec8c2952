// The list of jobs: live, without rebuilding what has not changed.

import { hasEnded, hasStill } from "../client.js";
import { isBehind } from "./all_winds.js";
import { $, button, element, fill, keyedChildren } from "./dom.js";
import { nameOf, nameTag } from "./names.js";
import { readStill } from "./still.js";
import { date, duration, number, percent, speed, text } from "./texts.js";

const REFRESH_MS = 2000;
const PAGE = 20;
const CERTAIN_MS = 15_000; // in which a second press deletes

export class JobList {
  /** `onOpen(id)`, `onDeleted(id)`: a job was opened or deleted; `onProblem(problem)`. */
  constructor(client, { onOpen, onDeleted, onProblem }) {
    Object.assign(this, { client, onOpen, onDeleted, onProblem });
    this.dialog = $("jobs");
    this.names = new Map(); // of assets
    $("more-jobs").onclick = () => this._loadEarlier();
    $("job-filter").onchange = () => this._restart();
  }

  async show() {
    if (!(await this._restart())) return;
    this.dialog.showModal();
    const timer = setInterval(() => (this.dialog.open ? this._refresh() : clearInterval(timer)), REFRESH_MS);
  }

  async _restart() {
    this.jobs = new Map(); // newest first
    this.cursor = null;
    return this._refresh();
  }

  /** The first page anew, and single jobs of later pages that still run. */
  _refresh() {
    return this._try(async () => {
      const { data, next_cursor: next } = await this.client.jobs({ limit: PAGE, state: this._state });
      const later = [...this.jobs.values()].filter((job) => !data.some(({ id }) => id === job.id));
      if (!later.length) this.cursor = next;
      const oldest = data.at(-1)?.id ?? "";
      const running = later.filter((job) => !hasEnded(job) && job.id < oldest);
      const updated = new Map(
        (await Promise.all(running.map(({ id }) => this.client.job(id)))).map((job) => [job.id, job]),
      );
      const older = later.filter(({ id }) => id < oldest).map((job) => updated.get(job.id) ?? job);
      this._set([...data, ...older]);
      await this._show();
    });
  }

  _loadEarlier() {
    return this._try(async () => {
      const page = await this.client.jobs({ limit: PAGE, cursor: this.cursor, state: this._state });
      this.cursor = page.next_cursor;
      this._set([...this.jobs.values(), ...page.data]);
      await this._show();
    });
  }

  get _state() {
    return $("job-filter").value || undefined;
  }

  _set(jobs) {
    this.jobs = new Map(jobs.filter((job) => !isBehind(job)).map((job) => [job.id, job]));
  }

  async _try(task) {
    try {
      await task();
      return true;
    } catch (error) {
      if (this.dialog.open && error.code === "unreachable") return false; // the next refresh may reach it
      this.dialog.close();
      this.onProblem(error);
      return false;
    }
  }

  async _show() {
    const unnamed = new Set([...this.jobs.values()].map((job) => job.asset_id).filter((id) => !this.names.has(id)));
    await Promise.all([...unnamed].map((id) => this._name(id)));
    keyedChildren($("job-list"), [...this.jobs.keys()], (id) => this._newItem(this.jobs.get(id)));
    for (const job of this.jobs.values()) this._update(job);
    $("no-jobs").hidden = this.jobs.size > 0;
    $("more-jobs").hidden = !this.cursor;
  }

  async _name(assetId) {
    const asset = await this.client.asset(assetId).catch(() => null); // an asset may expire before its jobs
    const name = asset && (nameOf(asset) || text("tree.photos", { n: number(asset.parts.length) }));
    this.names.set(assetId, name ?? text("jobs.expired"));
  }

  _newItem(job) {
    const name = this.names.get(job.asset_id);
    const wind = job.params?.wind ? ` · ${speed(job.params.wind.speed_m_s)}` : "";
    const open = button(text("jobs.open"), () => this._open(job.id), { className: "open" });
    const cancel = button(text("jobs.cancel"), () => this._act(this.client.cancel(job.id)), { className: "cancel" });
    const retry = button(text("jobs.retry"), () => this._act(this.client.retry(job.id)), { className: "retry" });
    const remove = button(text("jobs.delete"), () => this._delete(job.id, remove), { className: "delete" });
    for (const node of [open, cancel, retry, remove]) nameFully(node, `${name}, ${date(job.created_at)}`);
    const title = element("b", {}, nameTag(name));
    const picture = element("img", { alt: "", width: 56, height: 56 });
    const state = element("small", { className: "state" });
    const line = element("small", {}, state, ` · ${date(job.created_at)}`);
    const words = element("div", { className: "words" }, title, ` · ${text(`job.${job.type}`)}${wind}`, line);
    words.append(element("small", { className: "why" }));
    return element("li", {}, picture, words, element("span", { className: "actions" }, remove, cancel, retry, open));
  }

  _update(job) {
    const item = $("job-list").querySelector(`[data-key="${job.id}"]`);
    const ended = hasEnded(job);
    item.className = job.state;
    fill(item.querySelector(".state"), stateWords(job));
    fill(item.querySelector(".why"), job.error ? `${job.error.title}: ${job.error.detail}` : "");
    item.querySelector(".cancel").hidden = ended;
    item.querySelector(".delete").hidden = !ended;
    item.querySelector(".retry").hidden = !ended || job.state === "succeeded";
    if (hasStill(job)) this._showPicture(job.id, item.querySelector("img"));
  }

  async _showPicture(id, picture) {
    if (picture.dataset.of) return;
    picture.dataset.of = id;
    const still = await readStill(this.client, id).catch(() => null);
    if (still) picture.src = URL.createObjectURL(still);
  }

  /** The first press asks, the second deletes. */
  _delete(id, node) {
    const ask = (asks) => {
      node.classList.toggle("asks", asks);
      node.textContent = text(asks ? "jobs.delete-really" : "jobs.delete");
      nameFully(node, node.dataset.of);
    };
    if (!node.classList.contains("asks")) {
      ask(true);
      node.onblur = () => ask(false);
      setTimeout(() => ask(false), CERTAIN_MS);
      return null;
    }
    return this._try(async () => {
      await this.client.deleteJob(id).catch(unlessGone);
      this.jobs.delete(id);
      this.onDeleted(id);
      await this._refresh();
      this.dialog.querySelector(".close").focus(); // the pressed button is gone
    });
  }

  _open(id) {
    this.dialog.close();
    this.onOpen(id);
  }

  _act(promise) {
    return this._try(() => promise.then(() => this._refresh()));
  }
}

/** The accessible name of a button of the list: what it does, and to which job. */
function nameFully(node, of) {
  node.dataset.of = of;
  const words = node.textContent;
  node.setAttribute("aria-label", `${words}${words.endsWith("?") ? "" : ":"} ${of}`);
}

function unlessGone(problem) {
  if (problem.status !== 410) throw problem;
}

function stateWords(job) {
  const words = text(`state.${job.state}`);
  if (hasEnded(job)) return words;
  const parts = [job.state === "running" ? `${words}, ${percent(job.progress)}` : words];
  if (job.eta_s) parts.push(text("progress.eta", { time: duration(job.eta_s) }));
  return parts.join(", ");
}
