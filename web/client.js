// The service's HTTP interface for JavaScript: browsers, and node from 20 on. No dependencies, no DOM.
//
//   const client = new Client({ base: "http://localhost:8000" });
//   const asset = await client.upload([file], { onProgress: (share) => {} });
//   const job = await client.createJob({ type: "animate", asset_id: asset.id });
//   const done = await client.wait(job.id, { onJob: (job) => {} });
//   for (const file of await client.artifacts(done.id)) { const bytes = await client.bytes(file.url); }

import { randomKey } from "./client/keys.js";
import { asProblem, isTemporary, Problem, readProblem } from "./client/problem.js";
import { Push } from "./client/push.js";
import { uploadFiles } from "./client/upload.js";
import { sleep } from "./client/wait.js";
import { watchJob } from "./client/watch.js";

export { isAway, Problem, seconds } from "./client/problem.js";
export { Push } from "./client/push.js";
export { hasEnded, hasStill } from "./client/states.js";
export { patiently } from "./client/wait.js";

const RETRIES = 4;
const LONGEST_WAIT_S = 60;

export class Client {
  /** `key` is sent as a bearer token; `storage` (localStorage) remembers uploads that were cut off. */
  constructor(
    { base = "", key = null, storage = null, fetch, WebSocket = globalThis.WebSocket } = /** @type {any} */ ({}),
  ) {
    const sender = fetch ?? globalThis.fetch.bind(globalThis);
    Object.assign(this, { base: base.replace(/\/$/, ""), key, storage, WebSocket, _fetch: sender });
  }

  withFetch(fetch) {
    return new Client({ base: this.base, storage: this.storage, WebSocket: this.WebSocket, fetch });
  }

  // ---- requests

  /** A successful response, or a thrown Problem. Requests that are safe to repeat are repeated while it is away. */
  async send(
    method,
    path,
    { body, headers = {}, signal, again = method === "GET" || method === "HEAD" } = /** @type {any} */ ({}),
  ) {
    const sent = { ...headers, ...(this.key && { Authorization: `Bearer ${this.key}` }) };
    for (let attempt = 0; ; attempt++) {
      let waitS = Math.min(2 ** attempt / 2, 8);
      try {
        const response = await this._fetch(this.base + path, { method, body, headers: sent, signal });
        if (response.ok || response.status === 304) return response;
        const problem = await readProblem(response);
        // 429 and 503 come before anything is done, so that every request may be repeated
        const harmless = again || response.status === 429 || response.status === 503;
        if (!isTemporary(response.status) || !harmless || attempt === RETRIES) throw problem;
        waitS = problem.retryAfterS ?? waitS;
      } catch (error) {
        const final = error instanceof Problem || signal?.aborted || !again || attempt === RETRIES;
        if (final) throw asProblem(error, signal);
      }
      await sleep(Math.min(waitS, LONGEST_WAIT_S) * 1000, signal);
    }
  }

  async json(method, path, content, options = {}) {
    const headers = { Accept: "application/json", ...options.headers };
    if (content !== undefined) headers["Content-Type"] = "application/json";
    const body = content === undefined ? undefined : JSON.stringify(content);
    const response = await this.send(method, path, { ...options, body, headers });
    return response.status === 204 ? null : response.json();
  }

  async bytes(path, options) {
    return (await this.send("GET", path, options)).arrayBuffer();
  }

  // ---- assets

  /** Create an asset; options `kind`, `upAxis`, `unitM`, `signal`, `onProgress(share)`. See client/upload.js. */
  upload(files, options) {
    return uploadFiles(this, files, options);
  }

  asset(id) {
    return this.json("GET", `/v1/assets/${id}`);
  }

  // ---- jobs

  /** The key makes a request that is sent twice one job. */
  createJob(request, { key = randomKey(), signal, again = true } = /** @type {any} */ ({})) {
    return this.json("POST", "/v1/jobs", request, { headers: { "Idempotency-Key": key }, again, signal });
  }

  job(id) {
    return this.json("GET", `/v1/jobs/${id}`);
  }

  cancel(id) {
    return this.json("POST", `/v1/jobs/${id}/cancel`, undefined, { again: true });
  }

  /** Run a job that has ended again, as a new job. */
  retry(id) {
    return this.json("POST", `/v1/jobs/${id}/retry`);
  }

  /** Forget a job that has ended, with its files. */
  deleteJob(id) {
    return this.json("DELETE", `/v1/jobs/${id}`);
  }

  /** One page: `{ data, next_cursor }`, newest first. */
  jobs({ limit = 20, cursor, state, type } = /** @type {any} */ ({})) {
    const query = Object.entries({ limit, cursor, state, type }).filter(([, value]) => value !== undefined);
    return this.json("GET", `/v1/jobs?${new URLSearchParams(query)}`);
  }

  async artifacts(jobId) {
    return (await this.json("GET", `/v1/jobs/${jobId}/artifacts`)).artifacts;
  }

  /** Async iterator over the job's changes until it has ended; see client/watch.js. */
  watch(id, options) {
    return watchJob(this, id, options);
  }

  /** The job once it has succeeded; a thrown Problem (with `job`) where it ended otherwise. */
  async wait(id, { signal, onJob = () => {}, events } = /** @type {any} */ ({})) {
    let job = null;
    for await (job of this.watch(id, { signal, events })) onJob(job);
    if (job.state === "succeeded") return job;
    throw Object.assign(new Problem(job.error ?? { title: `The job is ${job.state}`, code: job.state }), { job });
  }

  // ---- spectra and pushes

  spectrum(id) {
    return this.json("GET", `/v1/spectra/${id}`);
  }

  /** `{ url, expires_at }`: an address that opens a file without a key, for a while. */
  link(path, expires_s) {
    return this.json("POST", "/v1/links", { path, expires_s });
  }

  wind(id, { seed = 0 } = {}) {
    return this.json("GET", `/v1/spectra/${id}/wind?seed=${seed}`);
  }

  /** Without `shapes` a fifth of the bytes: the bones of the surface say how voxels move. */
  modes(id, { shapes = false, ...options } = /** @type {any} */ ({})) {
    return this.bytes(`/v1/spectra/${id}/modes?shapes=${shapes}`, options);
  }

  surface(id, options) {
    return this.bytes(`/v1/spectra/${id}/surface`, options);
  }

  assetSurface(id, options) {
    return this.bytes(`/v1/assets/${id}/surface`, options);
  }

  /** How much each voxel takes part in a group, [V] in 0 to 1. */
  async reach(id, { seed_voxel, falloff_m }) {
    const query = new URLSearchParams({ seed_voxel, falloff_m });
    const bytes = new Uint8Array(await this.bytes(`/v1/spectra/${id}/reach?${query}`));
    return Float32Array.from(bytes, (byte) => byte / 255);
  }

  interact(request) {
    return this.json("POST", "/v1/interact", request, { again: true });
  }

  push(spectrumId, options = {}) {
    return new Push(this, spectrumId, options);
  }
}
