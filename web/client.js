// The service's HTTP interface for JavaScript: browsers, and node from 20 on. No dependencies, no DOM.
//
//   const client = new Client({ base: "http://localhost:8000" });
//   const asset = await client.upload([file], { onProgress: (share) => {} });
//   const job = await client.createJob({ type: "animate", asset_id: asset.id });
//   const done = await client.wait(job.id, { onJob: (job) => {} });
//   for (const file of await client.artifacts(done.id)) { const bytes = await client.bytes(file.url); }

const AWAY = new Set([408, 429, 502, 503, 504]); // worth another try
const ENDED = new Set(["succeeded", "failed", "canceled", "aborted"]);
const RETRIES = 4;
const FIRST_EVENT_MS = 5000; // later than this a proxy holds events back
const LONGEST_WAIT_S = 60;
const PIECE = 8 * 1024 * 1024; // bytes of an upload that are sent at once

/** What the service says is wrong: RFC 9457. `retryAfterS` is null where it told none. */
export class Problem extends Error {
  constructor(body, { status = body.status ?? 0, retryAfterS = null } = {}) {
    super(body.detail || body.title || `HTTP ${status}`);
    this.name = "Problem";
    Object.assign(this, body, { status, retryAfterS });
    this.title = body.title ?? "The service did not answer as expected";
    this.detail = body.detail ?? "";
    this.suggestion = body.suggestion ?? "";
    this.code = body.code ?? "unknown";
  }
}

export const hasEnded = (job) => ENDED.has(job.state);

export class Client {
  /** `key` is sent as a bearer token where it is set; `kept` (localStorage) remembers uploads that were cut off. */
  constructor({
    base = "",
    key = null,
    kept = null,
    fetch = globalThis.fetch.bind(globalThis),
    WebSocket = globalThis.WebSocket,
  } = {}) {
    Object.assign(this, { base: base.replace(/\/$/, ""), key, kept, _fetch: fetch, _WebSocket: WebSocket });
  }

  // ---- requests

  /** A response that is ok, or a thrown Problem. What may be sent twice is sent again where the service is away. */
  async send(method, path, { body, headers = {}, signal, again = method === "GET" || method === "HEAD" } = {}) {
    const sent = { ...headers };
    if (this.key) sent.Authorization = `Bearer ${this.key}`;
    for (let attempt = 0; ; attempt++) {
      let waitS = Math.min(2 ** attempt / 2, 8);
      try {
        const response = await this._fetch(this.base + path, { method, body, headers: sent, signal });
        if (response.ok || response.status === 304) return response;
        const problem = await readProblem(response);
        // 429 and 503 are told before anything is done, so that every request may come again
        const harmless = again || response.status === 429 || response.status === 503;
        if (!AWAY.has(response.status) || !harmless || attempt === RETRIES) throw problem;
        waitS = problem.retryAfterS ?? waitS;
      } catch (error) {
        if (error instanceof Problem || signal?.aborted || !again || attempt === RETRIES)
          throw asProblem(error, signal);
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

  // ---- uploads

  /** One mesh or splat and what it names, or photos: `File`s, or `{ name, content: Blob }`. Large ones go in pieces. */
  async upload(files, { kind, upAxis, unitM, signal, onProgress = () => {} } = {}) {
    const options = Object.entries({ kind, up_axis: upAxis, unit_m: unitM }).filter(([, value]) => value !== undefined);
    const all = files.map((file) => ({
      name: file.name,
      content: file.content ?? file,
      changed: file.lastModified ?? 0,
    }));
    const total = all.reduce((sum, { content }) => sum + content.size, 0);
    onProgress(0);
    let asset;
    if (total > PIECE) {
      const ids = [];
      let before = 0;
      for (const file of all) {
        ids.push(await this._inPieces(file, { signal, onProgress: (bytes) => onProgress((before + bytes) / total) }));
        before += file.content.size;
      }
      asset = await this.json(
        "POST",
        "/v1/assets",
        { upload_ids: ids, ...Object.fromEntries(options) },
        { again: true, signal },
      );
      for (const file of all) this.kept?.removeItem(keptKey(file));
    } else {
      const form = new FormData();
      for (const { name, content } of all) form.append("file", content, name);
      for (const [name, value] of options) form.append(name, String(value));
      asset = await (await this._post("/v1/assets", form, { signal, onProgress })).json();
    }
    onProgress(1);
    return asset;
  }

  /** tus: after a break it goes on at the byte that was reached, and after a reload too where `kept` is a Storage. */
  async _inPieces(file, { signal, onProgress }) {
    const { content } = file;
    const headers = { "Tus-Resumable": "1.0.0" };
    let { path, offset } = (await this._begun(file, headers, signal)) ?? {};
    if (!path) {
      const told = {
        ...headers,
        "Upload-Length": String(content.size),
        "Upload-Metadata": `filename ${base64(file.name)}`,
      };
      path = (await this.send("POST", "/v1/uploads", { headers: told, signal })).headers.get("Location");
      offset = 0;
      this.kept?.setItem(keptKey(file), path);
    }
    for (let failures = 0; offset < content.size; onProgress(offset)) {
      const sent = { ...headers, "Content-Type": "application/offset+octet-stream", "Upload-Offset": String(offset) };
      try {
        const response = await this.send("PATCH", path, {
          headers: sent,
          body: content.slice(offset, offset + PIECE),
          signal,
        });
        [offset, failures] = [Number(response.headers.get("Upload-Offset")), 0];
      } catch (error) {
        const gone =
          error.status >= 400 &&
          error.status < 500 &&
          error.code !== "upload-offset-conflict" &&
          !AWAY.has(error.status);
        if (signal?.aborted || gone || ++failures > RETRIES) throw error;
        await sleep(500 * 2 ** failures, signal);
        offset = Number((await this.send("HEAD", path, { headers, signal })).headers.get("Upload-Offset"));
      }
    }
    return path.split("/").pop();
  }

  /** Where an earlier try at the same file stands. */
  async _begun(file, headers, signal) {
    const path = this.kept?.getItem(keptKey(file));
    if (!path) return null;
    const response = await this.send("HEAD", path, { headers, signal }).catch(() => null);
    if (Number(response?.headers.get("Upload-Length")) !== file.content.size) return null;
    return { path, offset: Number(response.headers.get("Upload-Offset")) };
  }

  /** Only XMLHttpRequest tells how much has gone out; where there is none (node) it is fetch. */
  async _post(path, form, { signal, onProgress }) {
    if (typeof XMLHttpRequest === "undefined") return this.send("POST", path, { body: form, signal });
    const through = async () => {
      const response = await new Promise((resolve, reject) => {
        const request = new XMLHttpRequest();
        request.open("POST", this.base + path);
        if (this.key) request.setRequestHeader("Authorization", `Bearer ${this.key}`);
        request.upload.onprogress = (event) => event.lengthComputable && onProgress(event.loaded / event.total);
        request.onload = () => resolve(asResponse(request));
        request.onerror = () => reject(new TypeError("the upload was cut off"));
        request.onabort = () => reject(signal.reason);
        signal?.addEventListener("abort", () => request.abort());
        request.send(form);
      });
      return response;
    };
    return new Client({ base: this.base, fetch: through }).send("POST", path, { signal });
  }

  asset(id) {
    return this.json("GET", `/v1/assets/${id}`);
  }

  // ---- jobs

  /** The key makes a request that is sent twice one job. */
  createJob(request, { key = randomKey(), signal } = {}) {
    return this.json("POST", "/v1/jobs", request, { headers: { "Idempotency-Key": key }, again: true, signal });
  }

  job(id) {
    return this.json("GET", `/v1/jobs/${id}`);
  }
  cancel(id) {
    return this.json("POST", `/v1/jobs/${id}/cancel`, undefined, { again: true });
  }
  retry(id, body = {}) {
    return this.json("POST", `/v1/jobs/${id}/retry`, body);
  }

  /** One page: `{ data, next_cursor }`, newest first. */
  jobs({ limit = 20, cursor, state, type } = {}) {
    const asked = Object.entries({ limit, cursor, state, type }).filter(([, value]) => value !== undefined);
    return this.json("GET", `/v1/jobs?${new URLSearchParams(asked)}`);
  }

  async artifacts(jobId) {
    return (await this.json("GET", `/v1/jobs/${jobId}/artifacts`)).artifacts;
  }

  /** The job whenever it changes, until it has ended: events, and polling where they do not come through. */
  async *watch(id, { signal, events = true } = {}) {
    let last = null;
    if (events) {
      try {
        for await (const job of this._events(id, signal)) yield (last = job);
      } catch (error) {
        if (signal?.aborted || (error instanceof Problem && error.status >= 400 && error.status < 500)) throw error;
      }
      if (last && hasEnded(last)) return;
    }
    for (let etag = null; ; ) {
      const headers = etag ? { "If-None-Match": etag } : {};
      const response = await this.send("GET", `/v1/jobs/${id}`, { headers, signal });
      if (response.status !== 304) yield (last = await response.json());
      if (hasEnded(last)) return;
      etag = response.headers.get("ETag");
      await sleep(1000 * Math.min(seconds(response.headers.get("Retry-After")) ?? 1, LONGEST_WAIT_S), signal);
    }
  }

  /** The job once it has succeeded; a thrown Problem (with `job`) where it ended otherwise. */
  async wait(id, { signal, onJob = () => {}, events } = {}) {
    let job = null;
    for await (job of this.watch(id, { signal, events })) onJob(job);
    if (job.state === "succeeded") return job;
    throw Object.assign(new Problem(job.error ?? { title: `The job is ${job.state}`, code: job.state }), { job });
  }

  async *_events(id, signal) {
    signal?.throwIfAborted();
    const late = new AbortController();
    const timer = setTimeout(() => late.abort(new Error("no event came")), FIRST_EVENT_MS);
    const abort = () => late.abort(signal.reason);
    signal?.addEventListener("abort", abort);
    try {
      const headers = { Accept: "text/event-stream" };
      const response = await this.send("GET", `/v1/jobs/${id}/events`, { headers, signal: late.signal, again: false });
      const decoder = new TextDecoder();
      let text = "";
      for (const reader = response.body.getReader(); ; ) {
        const { value, done } = await reader.read();
        if (done) return;
        text += decoder.decode(value, { stream: true });
        for (let end; (end = text.indexOf("\n\n")) >= 0; text = text.slice(end + 2)) {
          const told = text
            .slice(0, end)
            .split("\n")
            .filter((line) => line.startsWith("data:"));
          if (!told.length) continue;
          clearTimeout(timer);
          yield JSON.parse(told.map((line) => line.slice(5)).join("\n"));
        }
      }
    } finally {
      clearTimeout(timer);
      signal?.removeEventListener("abort", abort);
      late.abort(); // gives the connection back where the reader stopped early
    }
  }

  // ---- spectra and pushes

  spectrum(id) {
    return this.json("GET", `/v1/spectra/${id}`);
  }
  modes(id, options) {
    return this.bytes(`/v1/spectra/${id}/modes`, options);
  }
  surface(id, options) {
    return this.bytes(`/v1/spectra/${id}/surface`, options);
  }
  assetSurface(id, options) {
    return this.bytes(`/v1/assets/${id}/surface`, options);
  }

  /** How much each voxel takes part in a group, [V] in 0 to 1. */
  async reach(id, { seed_voxel, falloff_m }) {
    const asked = new URLSearchParams({ seed_voxel, falloff_m });
    const bytes = new Uint8Array(await this.bytes(`/v1/spectra/${id}/reach?${asked}`));
    return Float32Array.from(bytes, (byte) => byte / 255);
  }

  interact(request) {
    return this.json("POST", "/v1/interact", request, { again: true });
  }

  /** A tree to push as long as one likes; see Push. */
  push(spectrumId, options = {}) {
    return new Push(this, spectrumId, options);
  }
}

/** /v1/interact/stream. Opens with the first push, and anew after the service has let go of a client that was still. */
export class Push {
  constructor(client, spectrumId, { onFrame = () => {}, onRest = () => {}, onProblem = () => {}, ...open } = {}) {
    Object.assign(this, { client, spectrumId, onFrame, onRest, onProblem, _open: open, _socket: null, _waiting: [] });
  }

  /** Pull a point by so many metres, and hold it. `at` is one of `{ voxel }`, `{ point_m }`, `{ vertex }`. */
  drag(at, displacement_m) {
    this._force({ kind: "drag", at, displacement_m });
  }
  knock(at, impulse_n_s) {
    this._force({ kind: "impulse", at, impulse_n_s });
  }
  release(kind = "drag") {
    if (this._socket) this._say({ type: "release", kind });
  }

  /** Tell which frame was drawn; without it at most eight come. */
  drawn(frame) {
    if (this._socket?.readyState === 1) this._say({ type: "ack", frame });
  }

  close() {
    const socket = this._socket;
    this._socket = null;
    socket?.close();
  }

  _force(force) {
    this._socket ??= this._connect();
    this._busy = true;
    this._say({ type: "force", force });
  }

  _connect() {
    const base = this.client.base || globalThis.location.origin;
    const protocols = this.client.key ? ["dynamictree", `bearer.${this.client.key}`] : [];
    const socket = new this.client._WebSocket(`${base.replace(/^http/, "ws")}/v1/interact/stream`, protocols);
    const gone = () => {
      if (this._socket !== socket) return;
      this._socket = null;
      this._waiting = [];
      this._busy = false;
      this.onRest();
    };
    socket.onopen = () => {
      socket.send(JSON.stringify({ type: "open", spectrum_id: this.spectrumId, ...this._open }));
      for (const message of this._waiting.splice(0)) socket.send(message);
    };
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      if (message.type === "frame") this.onFrame(message);
      else if (message.type === "rest") {
        this._busy = false;
        this.onRest(message);
      } else if (message.type === "problem") this.onProblem(new Problem(message));
    };
    // a line that breaks while nothing moves is opened again by the next push
    socket.onerror = () =>
      this._busy &&
      this.onProblem(
        new Problem({
          title: "The push did not get through",
          detail: "The connection that carries pushes was closed.",
          code: "stream-closed",
          suggestion: "Try again.",
        }),
      );
    socket.onclose = gone;
    return socket;
  }

  _say(message) {
    const text = JSON.stringify(message);
    if (this._socket.readyState === 1) this._socket.send(text);
    else this._waiting.push(text);
  }
}

async function readProblem(response) {
  const retryAfterS = seconds(response.headers.get("Retry-After"));
  const isJson = /json/.test(response.headers.get("Content-Type") ?? "");
  const body = isJson ? await response.json().catch(() => ({})) : {};
  return new Problem(body.title ? body : { title: `HTTP ${response.status}`, code: "unknown" }, {
    status: response.status,
    retryAfterS,
  });
}

function asProblem(error, signal) {
  if (error instanceof Problem || signal?.aborted) return error;
  const told = {
    title: "The service cannot be reached",
    detail: error.message,
    code: "unreachable",
    suggestion: "Look whether it runs, then try again.",
  };
  return new Problem(told);
}

/** Seconds of a Retry-After header, which is a number or a date. */
export function seconds(header, now = Date.now()) {
  if (!header) return null;
  const number = Number(header);
  if (Number.isFinite(number)) return Math.max(number, 0);
  const date = Date.parse(header);
  return Number.isNaN(date) ? null : Math.max((date - now) / 1000, 0);
}

function asResponse(request) {
  const headers = new Headers();
  for (const name of ["Content-Type", "Retry-After", "Location"]) {
    const value = request.getResponseHeader(name);
    if (value !== null) headers.set(name, value);
  }
  return new Response(request.responseText, { status: request.status, headers });
}

function sleep(ms, signal) {
  return new Promise((resolve, reject) => {
    if (signal?.aborted) return reject(signal.reason);
    const timer = setTimeout(resolve, ms);
    signal?.addEventListener(
      "abort",
      () => {
        clearTimeout(timer);
        reject(signal.reason);
      },
      { once: true },
    );
  });
}

const keptKey = ({ name, content, changed }) => `upload ${name} ${content.size} ${changed}`;
const base64 = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text)));

/** crypto.randomUUID is there only on https and localhost. */
function randomKey() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}
