// The dialog that shows photos of a reconstruction, and takes strokes on them: "plant" and "not the plant".

import { readTensors } from "../motion/tensors.js";
import { $, fill } from "./dom.js";
import { StrokeList } from "./stroke_list.js";
import { number, text } from "./texts.js";

const FILE = "photos.safetensors";
const WIDTH = 0.012; // of a line, of the photo's longer side
const COLOURS = { true: "#1f9d55", false: "#c2255c" };
const KEY_STEP = 0.02; // of the photo, by an arrow key
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** Ask on photos of the tree that is shown what the plant is, and begin the job that cuts it out. */
export async function cutPlant(client, session) {
  const { job } = session.machine.facts;
  const params = await askStrokes(client, job);
  const { formats: _, ...before } = job.params;
  if (params) session.animate({ seed: job.seed, preset: job.preset, params: { ...before, ...params } });
}

/** The `params` that cut the plant out, or null where the dialog was closed. */
async function askStrokes(client, job) {
  const photos = await loadPhotos(client, job);
  const { scribbles, only_plant: alone } = job.params;
  const marking = new Marking(photos, new StrokeList(scribbles ?? []));
  const first = photos.findIndex(({ name }) => marking.strokes.on(name).length);
  await marking.show(Math.max(first, 0));
  $("strokes-whole").hidden = !scribbles && !alone;
  $("strokes").showModal();
  return marking.answer();
}

async function loadPhotos(client, job) {
  const file = (await client.artifacts(job.id)).find(({ name }) => name === FILE);
  const { tensors, metadata } = readTensors(await client.bytes(file.url));
  return JSON.parse(metadata.photos).map((name, i) => ({ name, content: tensors[`photo_${i}`] }));
}

class Marking {
  constructor(photos, strokes) {
    this.photos = photos;
    this.strokes = strokes;
    this.picture = this.cross = null;
    this.canvas = $("strokes-photo");
    this.canvas.onpointerdown = (event) => this._down(event);
    this.canvas.onpointermove = (event) => this._move(event);
    this.canvas.onpointerup = this.canvas.onpointercancel = () => {
      this.pointer = null;
    };
    this.canvas.onkeydown = (event) => this._key(event);
    $("strokes-before").onclick = () => this.show(this.at - 1);
    $("strokes-next").onclick = () => this.show(this.at + 1);
    $("strokes-undo").onclick = () => {
      this.strokes.undo(this.name);
      this._draw();
    };
  }

  get name() {
    return this.photos[this.at].name;
  }

  /** Whether the next stroke is on the plant. */
  get plant() {
    return $("strokes-kind").querySelector(":checked").value === "plant";
  }

  async show(index) {
    this.at = (index + this.photos.length) % this.photos.length;
    const { at, canvas } = this;
    const picture = await createImageBitmap(new Blob([this.photos[at].content], { type: "image/jpeg" }));
    if (at !== this.at) return;
    Object.assign(this, { picture, cross: null, pointer: null });
    Object.assign(canvas, { width: picture.width, height: picture.height });
    canvas.style.setProperty("--ratio", picture.width / picture.height);
    this._draw();
  }

  /** Resolves with the parameters of the button that was pressed, with null when the dialog closes. */
  answer() {
    const dialog = $("strokes");
    return new Promise((resolve) => {
      const finish = (params) => {
        resolve(params);
        dialog.close();
      };
      $("strokes-cut").onclick = () => finish(this.strokes.params);
      $("strokes-whole").onclick = () => finish({ scribbles: null, only_plant: false });
      dialog.onclose = () => finish(null);
    });
  }

  // ---- drawing by pointer and by keys

  _place({ clientX, clientY }) {
    const box = this.canvas.getBoundingClientRect();
    return [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
  }

  _down(event) {
    if (event.button !== 0 || this.strokes.isFull || this.pointer) return;
    this.pointer = event.pointerId;
    this.canvas.setPointerCapture(event.pointerId);
    this.strokes.begin(this.name, this.plant, this._place(event));
    this._draw();
  }

  _move(event) {
    if (event.pointerId !== this.pointer) return;
    for (const part of event.getCoalescedEvents?.() ?? [event]) this.strokes.extend(this._place(part));
    this._draw();
  }

  /** For those who use no pointer: arrows move a cross, space or Enter marks what is under it. */
  _key(event) {
    const arrow = ARROWS[event.key];
    if (!arrow && event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    this.cross ??= [0.5, 0.5];
    if (arrow) this.cross = this.cross.map((x, i) => Math.min(Math.max(x + KEY_STEP * arrow[i], 0), 1));
    else this.strokes.begin(this.name, this.plant, this.cross);
    this._draw();
  }

  // ---- what is seen

  _draw() {
    const { canvas, picture, photos, at, strokes } = this;
    const own = strokes.on(this.name);
    const context = canvas.getContext("2d");
    context.drawImage(picture, 0, 0);
    for (const { plant, points } of own) this._line(context, points, plant);
    if (this.cross) this._cross(context);
    const words = text("strokes.nth", { n: number(at + 1), all: number(photos.length) });
    fill($("strokes-nth"), `${words} · ${text("strokes.count", { n: number(own.length) })}`);
    canvas.setAttribute("aria-label", `${words}. ${text("strokes.canvas")}`);
    $("strokes-undo").disabled = !own.length;
    fill($("strokes-note"), text(strokes.isFull ? "strokes.full" : "strokes.note")); // as high before as after a stroke
  }

  /** White below, the colour of its kind above; what is not the plant is dashed. */
  _line(context, points, plant) {
    const { width, height } = this.canvas;
    const thick = WIDTH * Math.max(width, height);
    const path = new Path2D();
    for (const [x, y] of [points[0], ...points]) path.lineTo(x * width, y * height);
    context.lineCap = context.lineJoin = "round";
    drawTwice(context, path, ["#fff", 1.7 * thick], [COLOURS[plant], thick, plant ? [] : [1.2 * thick, 1.9 * thick]]);
  }

  _cross(context) {
    const { width, height } = this.canvas;
    const [x, y] = [this.cross[0] * width, this.cross[1] * height];
    const reach = 0.03 * Math.max(width, height);
    const path = new Path2D(`M${x - reach} ${y}h${2 * reach}M${x} ${y - reach}v${2 * reach}`);
    drawTwice(context, path, ["#fff", 5], ["#000", 2]);
  }
}

/** Draw a path below and above, each with its colour, width and dashes. */
function drawTwice(context, path, ...lines) {
  for (const [colour, width, dashes = []] of lines) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dashes);
    context.stroke(path);
  }
}
