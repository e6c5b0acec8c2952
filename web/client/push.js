// /v1/interact/stream: forces go to the service, modal coordinates come back.

import { Problem } from "./problem.js";

/** One tree that can be pushed. The socket opens with the first push, and again after the service has closed it. */
export class Push {
  constructor(client, spectrumId, { onFrame = () => {}, onRest = () => {}, onProblem = () => {}, ...open } = {}) {
    Object.assign(this, { client, spectrumId, onFrame, onRest, onProblem });
    this._open = open;
    this._socket = null;
    this._queue = [];
  }

  /** Displace a point by so many metres until `release`. `at` is one of `{ voxel }`, `{ point_m }`, `{ vertex }`. */
  drag(at, displacement_m) {
    this._force({ kind: "drag", at, displacement_m });
  }

  knock(at, impulse_n_s) {
    this._force({ kind: "impulse", at, impulse_n_s });
  }

  release(kind = "drag") {
    if (this._socket) this._send({ type: "release", kind });
  }

  /** Acknowledge a frame that was drawn; without acknowledgements at most eight frames come. */
  drawn(frame) {
    if (this._socket?.readyState === 1) this._send({ type: "ack", frame });
  }

  close() {
    const socket = this._socket;
    this._socket = null;
    socket?.close();
  }

  _force(force) {
    this._socket ??= this._connect();
    this._busy = true;
    this._send({ type: "force", force });
  }

  _connect() {
    const base = this.client.base || globalThis.location.origin;
    const protocols = this.client.key ? ["dynamictree", `bearer.${this.client.key}`] : [];
    const url = `${base.replace(/^http/, "ws")}/v1/interact/stream`;
    const socket = new this.client.WebSocket(url, protocols);
    socket.onopen = () => {
      socket.send(JSON.stringify({ type: "open", spectrum_id: this.spectrumId, ...this._open }));
      for (const message of this._queue.splice(0)) socket.send(message);
    };
    socket.onmessage = ({ data }) => this._receive(JSON.parse(data));
    // a connection that breaks while nothing moves is opened again by the next push
    socket.onerror = () => this._busy && this.onProblem(closedProblem());
    socket.onclose = () => {
      if (this._socket !== socket) return;
      this._socket = null;
      this._queue = [];
      this._busy = false;
      this.onRest();
    };
    return socket;
  }

  _receive(message) {
    if (message.type === "frame") this.onFrame(message);
    else if (message.type === "problem") this.onProblem(new Problem(message));
    else if (message.type === "rest") {
      this._busy = false;
      this.onRest(message);
    }
  }

  _send(message) {
    const content = JSON.stringify(message);
    if (this._socket.readyState === 1) this._socket.send(content);
    else this._queue.push(content);
  }
}

function closedProblem() {
  return new Problem({
    title: "The push did not get through",
    detail: "The connection that carries pushes was closed.",
    code: "stream-closed",
    suggestion: "Try again.",
  });
}
