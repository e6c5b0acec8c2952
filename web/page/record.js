// Pictures and videos of the view: what the canvas shows beside the panels, on the page's sky or on nothing.

import { $, fill, saveBlob } from "./dom.js";
import { fileName } from "./names.js";
import { percent, text } from "./texts.js";
import { webm } from "./webm.js";

const FPS = 30;
const KEY_FRAMES = 60; // frames from one to the next
const BITS_PER_S = 10e6;
const LOOPS_A_TURN = 3; // of a turntable: a whole turn in one loop is too fast
const ENDLESS_S = 10; // of wind that has no loop
const QUEUE = 4; // frames that wait for the encoder

export class Recorder {
  /** `name()` is that of the tree, for the files. */
  constructor(stage, player, { name, onProblem }) {
    Object.assign(this, { stage, player });
    this.recording = false;
    $("save-picture").onclick = () =>
      this.picture().then((blob) => saveBlob(fileName(name(), ".png"), blob), onProblem);
    $("save-video").onclick = () => {
      if (this.recording)
        this.recording = false; // the second press gives it up
      else this.video().then((blob) => blob && saveBlob(fileName(name(), ".webm"), blob), onProblem);
    };
    $("save-video").hidden = !globalThis.VideoEncoder; // only browsers of late, over https or on localhost
  }

  get _isTransparent() {
    return document.body.dataset.background === "none" || !this.stage.surroundings.ground.visible;
  }

  /** The view as PNG; its background is transparent where that is chosen, or the ground hidden. */
  picture() {
    const copy = this._copier();
    this.stage.drawNow();
    copy();
    return new Promise((resolve) => copy.canvas.toBlob(resolve, "image/png"));
  }

  /**
   * One loop as WebM, or three with a turntable, which turns once: the frame after the last is the first. It takes as
   * long as drawing and encoding do. Null where it was given up.
   */
  async video() {
    const { stage, player } = this;
    const { tree } = player;
    const goesOn = () => this.recording && player.tree === tree; // another tree may have been opened
    const turning = stage.controls.autoRotate;
    const loops = turning ? LOOPS_A_TURN : 1;
    const seconds = player.turbulent ? ENDLESS_S : loops * player.period;
    const count = Math.round(seconds * FPS);
    const copy = this._copier();
    const encoder = new Encoder(copy.canvas);
    const began = player.seconds;
    this.recording = true;
    Object.assign(stage.controls, { autoRotate: false, enableDamping: false });
    try {
      for (let n = 0; n < count && goesOn(); n++) {
        player.scripted = { phase: ((n * loops) / count) % 1, seconds: began + (n * seconds) / count };
        player.advance(0);
        if (turning) stage.controls.rotateLeft((2 * Math.PI) / count);
        stage.drawNow();
        copy();
        await encoder.add(copy.canvas, (1e6 * n * seconds) / count, n % KEY_FRAMES === 0);
        fill($("save-video"), text("record.stop", { share: percent(n / count) }));
      }
      return goesOn() ? await encoder.finish(1000 * seconds) : null;
    } finally {
      this.recording = false;
      player.scripted = null;
      Object.assign(stage.controls, { autoRotate: turning, enableDamping: true });
      fill($("save-video"), text("record.video"));
    }
  }

  /** A function that copies the free part of the stage into a canvas of its own. */
  _copier() {
    const { canvas: source, margins } = this.stage;
    const { left = 0, right = 0, top = 0, bottom = 0 } = margins;
    const part = [left, top, source.clientWidth - left - right, source.clientHeight - top - bottom];
    const ratio = Math.min(devicePixelRatio, 2);
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = part.slice(2).map((length) => 2 * Math.floor((length * ratio) / 2)); // for encoders
    const pen = canvas.getContext("2d");
    const sky = pen.createLinearGradient(0, 0, 0, canvas.height);
    const { color, backgroundColor } = getComputedStyle($("sky"));
    const plain = document.body.dataset.background === "plain";
    sky.addColorStop(0, plain ? backgroundColor : color);
    sky.addColorStop(0.72, backgroundColor);
    const copy = () => {
      const scale = source.width / source.clientWidth;
      pen.clearRect(0, 0, canvas.width, canvas.height);
      pen.fillStyle = sky;
      if (!this._isTransparent) pen.fillRect(0, 0, canvas.width, canvas.height);
      const [x, y, width, height] = part.map((length) => length * scale);
      pen.drawImage(source, x, y, width, height, 0, 0, canvas.width, canvas.height);
    };
    return Object.assign(copy, { canvas });
  }
}

/** Frames of one size to a WebM file. */
class Encoder {
  constructor({ width, height }) {
    this.width = width;
    this.height = height;
    this.frames = [];
    this.problem = null;
    this.encoder = new VideoEncoder({
      output: (chunk) => {
        const bytes = new Uint8Array(chunk.byteLength);
        chunk.copyTo(bytes);
        this.frames.push({ bytes, time_ms: chunk.timestamp / 1000, isKey: chunk.type === "key" });
      },
      error: (error) => {
        this.problem = error;
      },
    });
    this.encoder.configure({ codec: "vp8", width, height, bitrate: BITS_PER_S, framerate: FPS });
  }

  async add(canvas, timestamp, keyFrame) {
    const frame = new VideoFrame(canvas, { timestamp: Math.round(timestamp) });
    this.encoder.encode(frame, { keyFrame });
    frame.close();
    do await new Promise(requestAnimationFrame);
    while (this.encoder.encodeQueueSize > QUEUE && !this.problem);
    if (this.problem) throw this.problem;
  }

  async finish(duration_ms) {
    await this.encoder.flush();
    const { width, height, frames } = this;
    return webm({ codec: "V_VP8", width, height, duration_ms, frames });
  }
}
