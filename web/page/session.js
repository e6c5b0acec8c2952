// One tree from its files to its motion: upload, job, products. Breaks of the connection are waited out.

import { randomKey } from "../client/keys.js";
import { hasEnded, Problem, patiently } from "../client.js";
import { keepName, nameOf } from "./names.js";

/** Files that the first job writes; others are written when they are wanted. */
const FIRST_FORMATS = { mesh: ["glb"], cloud: ["splat"], photos: ["glb", "splat"] };

export class Session {
  /**
   * `scene` draws: `clear()`, `photos(files)`, `dropped(files, run)`, `learned(job, signal)`, `rest(asset, signal)`, `motion(job, signal, options)`, `products(job, signal)`, `showMesh()`.
   * `onJob(id)` is called with the job that is followed; `onKey(again)` where the service requires an API key.
   */
  constructor(client, machine, scene, { onJob = () => {}, onKey = () => {} } = {}) {
    Object.assign(this, { client, machine, scene, onJob, onKey });
    this.run = new AbortController();
  }

  get jobId() {
    return this.machine.facts.job?.id ?? null;
  }

  // ---- beginnings

  /** `reading` are options of the upload (`upAxis`, `unitM`), `request` fields of the job (`seed`, `params`). */
  upload(files, { name, reading = {}, request = {} }) {
    const again = () => this.upload(files, { name, reading, request });
    return this._begin("upload", { name, files, reading, share: 0 }, again, async (run) => {
      this.scene.photos(files);
      this.scene.dropped(files, run).catch(() => {}); // only a preview
      const onProgress = (share) => run.update({ share });
      const send = () => this.client.upload(files, { ...reading, signal: run.signal, onProgress });
      const asset = await patiently(send, run);
      keepName(asset, name);
      run.signal.throwIfAborted();
      await this._animate(asset, request, run);
    });
  }

  /** Upload files and start their job without showing it. */
  async uploadInBackground(files) {
    const asset = await patiently(() => this.client.upload(files));
    return this._createJob(asset, {});
  }

  open(jobId) {
    const again = () => this.open(jobId);
    return this._begin("open", { name: "", job: null }, again, async (run) => {
      const job = await patiently(() => this.client.job(jobId), run);
      const asset = await this.client.asset(job.asset_id).catch(() => null); // it may have expired
      run.update({ job, asset, name: asset ? nameOf(asset) : "" });
      // a cloud's points also stand in for its Gaussians, which come last
      if (asset && (asset.kind === "cloud" || !job.result?.spectrum_id)) this._showRest(asset, run);
      await this._follow(jobId, run, job);
    });
  }

  /** Make the motion of the same asset with other fields: `seed`, `params`. */
  animate(request) {
    const { asset, name, files, reading } = this.machine.facts;
    const again = () => this.animate(request);
    return this._begin("open", { name, asset, files, reading }, again, (run) => {
      if (files) this.scene.photos(files);
      return this._animate(asset, request, run);
    });
  }

  /** Make the motion of the same tree in another wind. */
  animateIn(wind) {
    const { seed, preset, params } = this.machine.facts.job;
    return this.animate({ seed, preset, params: { ...params, wind: { ...params.wind, ...wind } } });
  }

  /** Make the tree again as its form says: the files read otherwise, or another motion of what was read. */
  remake({ reading, request, newUpload }) {
    const { files, name, reading: before, job } = this.machine.facts;
    if (job) this.client.cancel(job.id).catch(() => {}); // it may have ended
    return newUpload
      ? this.upload(files, { name, reading: { ...before, ...reading }, request })
      : this.animate(request);
  }

  /** After a failure: run the job that has ended again, or do what was refused again. */
  retry() {
    const { job, problem } = this.machine.facts;
    if (problem?.offersMotion) return this.animate({});
    if (!job || !hasEnded(job)) return this.again();
    const again = () => this.retry();
    return this._begin("open", { ...this.machine.facts, problem: null }, again, async (run) => {
      const next = await patiently(() => this.client.retry(job.id), run);
      run.update({ job: next });
      await this._follow(next.id, run);
    });
  }

  /** The job that is shown was deleted: nothing of it can be asked for any more. */
  deleted() {
    this.run.abort();
    this.scene.clear();
    this.machine.send("failed", { problem: new Problem({ code: "job-deleted" }) });
  }

  /** Back to the welcome; a job goes on unless `cancel` is set. */
  leave({ cancel = false } = {}) {
    const { job } = this.machine.facts;
    if (cancel && job && !hasEnded(job)) this.client.cancel(job.id).catch(() => {}); // it may just have ended
    this.run.abort();
    this.scene.clear();
    this.machine.send("leave");
  }

  // ---- what a run does

  async _begin(event, facts, again, task) {
    this.run.abort();
    const controller = new AbortController();
    const { signal } = controller;
    const { machine } = this;
    this.run = controller;
    this.again = again;
    this.scene.clear();
    machine.send(event, facts);
    const update = (changes) => !signal.aborted && machine.update(changes);
    const send = (name, changes) => !signal.aborted && machine.send(name, changes);
    const onAway = (problem) => update({ away: problem });
    try {
      await task({ signal, update, send, onAway });
    } catch (error) {
      if (signal.aborted) return;
      if (error.status === 401) this.onKey(again);
      else if (machine.state === "moving") machine.update({ problem: error });
      else machine.send("failed", { problem: error });
    }
  }

  async _animate(asset, request, run) {
    run.send("accepted", { asset, share: 1, job: null });
    this._showRest(asset, run);
    const job = await this._createJob(asset, request, run);
    run.update({ job });
    await this._follow(job.id, run);
  }

  _createJob(asset, { params = {}, ...fields }, options) {
    const wanted = { formats: FIRST_FORMATS[asset.kind], ...params };
    const request = { type: "animate", asset_id: asset.id, ...fields, params: wanted };
    const key = randomKey(); // the same in each attempt: one job
    return patiently(() => this.client.createJob(request, { key, signal: options?.signal, again: false }), options);
  }

  _showRest(asset, { signal }) {
    this.scene.rest(asset, signal).catch(() => {}); // only a preview
  }

  /** Follow a job to its end; show its motion as soon as there is a spectrum, its files once they are written. */
  async _follow(jobId, run, known = null) {
    let job = /** @type {any} */ (null);
    let motion = null;
    this.onJob(jobId);
    const watch = async () => {
      // a break is reported at once, so the watch does not try again by itself
      const ended = known && hasEnded(known); // nothing of it will change
      for await (job of ended ? [known] : this.client.watch(jobId, { ...run, again: false })) {
        run.update({ job, away: null });
        if (job.result?.spectrum_id) {
          motion ??= this._showMotion(job, run);
          motion.catch(() => {}); // awaited below, unless the watch is left before
        } else if (job.state === "running") {
          run.send("started");
          if (this._ofPhotos) this.scene.learned(job, run.signal).catch(() => {}); // only a preview
        } else if (job.state === "queued" && this.machine.state === "running") run.send("waiting");
      }
    };
    await patiently(watch, run);
    await motion;
    if (motion && job.state !== "succeeded") this.scene.showMesh();
    if (job.state !== "succeeded") throw jobProblem(job);
    if (!motion) throw Object.assign(new Problem({ code: "no-motion" }), { offersMotion: true });
    await this.scene.products(job, run.signal);
  }

  get _ofPhotos() {
    return this.machine.facts.asset?.kind === "photos";
  }

  async _showMotion(job, run) {
    run.update({ drawing: true });
    await patiently(
      () => this.scene.motion(job, run.signal, { ofPhotos: this._ofPhotos, hasEnded: hasEnded(job) }),
      run,
    );
    run.send("moving", { drawing: false });
  }
}

const jobProblem = (job) => new Problem(job.error ?? { title: `The job is ${job.state}`, code: `job-${job.state}` });
