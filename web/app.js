// The page: files in, progress, the tree. What it knows of the service is in client.js, of the motion in modes.js.

import { Client, Problem } from "./client.js";
import { Files } from "./files.js";
import { Hand } from "./hand.js";
import { JobList } from "./jobs.js";
import { Modes, windCoordinates, windGain } from "./modes.js";
import { isWorthLoading, readMorphs } from "./morphs.js";
import { $, ask, button, degrees, element, fill, hideProblem, setTheme, showProblem } from "./page.js";
import { Stage } from "./stage.js";
import { readSurface } from "./surface.js";
import { Tree } from "./tree.js";

const EXAMPLES = [
  { file: "round-broadleaf", name: "Broadleaf", height: "10.3 m" },
  { file: "weeping", name: "Weeping", height: "9.7 m" },
  { file: "conical-conifer", name: "Conifer", height: "8.0 m" },
];
const STAGES = {
  upload: "Upload",
  reconstruct: "Photos to a tree",
  voxelize: "Find the voxels",
  diffuse: "Give it motion",
  animate: "Write the files",
};
const EASE_S = 0.6; // in which wind follows its slider
const SHOWN_SHARE = 0.05; // of the height: a mode alone is enlarged to this

const client = new Client({ key: sessionStorage.getItem("key"), kept: localStorage });
const stage = newStage();
const hand = new Hand(stage, client, { onGrab: showGrip, onProblem: showProblem });
const files = new Files(client, { onProblem: fail });
const jobs = new JobList(client, {
  onOpen: (job) => open(job.id),
  onProblem: (error) => fail(error, null, () => jobs.show()),
});
const still = matchMedia("(prefers-reduced-motion: reduce)");

let run = new AbortController(); // of what is being opened; a new one ends it
let tree = null;
let shown = null; // { job, spectrum }
const motion = { playing: true, phase: 0, gain: 0, wanted: 1, turn: 0, alone: null };

// ---- from files to a tree

async function begin(given, { example } = {}) {
  if (!given.length) return;
  const { signal } = restart();
  setMode("waiting");
  const stages = [{ name: "upload", state: "running", progress: 0 }];
  const name = given.length === 1 ? given[0].name : `${given.length} files`;
  showProgress(example ?? name, stages);
  try {
    const asset = await client.upload(given, {
      signal,
      onProgress: (share) => {
        stages[0].progress = share;
        showProgress(example ?? name, stages);
      },
    });
    showAtRest(asset, signal);
    const job = await client.createJob(
      { type: "animate", asset_id: asset.id, params: { formats: FIRST_FORMATS[asset.kind] } },
      { signal },
    );
    await follow(job.id, signal, example ?? name);
  } catch (error) {
    fail(error, signal, () => begin(given, { example }));
  }
}

const FIRST_FORMATS = { mesh: ["glb"], cloud: ["splat"], photos: ["glb", "splat"] }; // more are made when asked for

async function open(jobId) {
  const { signal } = restart();
  setMode("waiting");
  try {
    const job = await client.job(jobId);
    const asset = await client.asset(job.asset_id).catch(() => null);
    if (signal.aborted) return;
    if (asset && !job.result?.spectrum_id) showAtRest(asset, signal);
    await follow(jobId, signal, asset ? nameOf(asset) : "Tree");
  } catch (error) {
    fail(error, signal, () => open(jobId));
  }
}

const nameOf = (asset) =>
  asset.parts.length > 1 && asset.kind === "photos"
    ? `${asset.parts.length} photos`
    : asset.parts[0].name.replace(/\.[a-z]+$/i, "");

/** Watch a job; show its tree as soon as there is a spectrum, its files once they are written. */
async function follow(jobId, signal, name) {
  history.replaceState(null, "", `#job=${jobId}`);
  let job = null;
  let moving = null;
  for await (job of client.watch(jobId, { signal })) {
    const at = job.result?.spectrum_id;
    if (at && !moving) moving = showMoving(job, at, signal, name);
    if (!at) showProgress(name, job.stages, job);
    files.follow(job);
  }
  if (moving) await moving;
  if (job.state === "succeeded") return showFiles(job, signal);
  throw Object.assign(
    new Problem(job.error ?? { title: `The job is ${job.state}`, suggestion: "Start it again.", code: job.state }),
    { job },
  );
}

/** Something to look at while the job runs. */
async function showAtRest(asset, signal) {
  if (asset.kind !== "mesh") return;
  const surface = await readSurface(await client.assetSurface(asset.id, { signal })).catch(() => null);
  if (!surface || signal.aborted || tree?.moves) return;
  tree ??= new Tree(stage);
  tree.setSurface(surface);
}

async function showMoving(job, spectrumId, signal, name) {
  const [spectrum, modes, surface] = await Promise.all([
    client.spectrum(spectrumId),
    client.modes(spectrumId).then((bytes) => new Modes(bytes)),
    client.surface(spectrumId).then(readSurface),
  ]);
  if (signal.aborted) return;
  tree ??= new Tree(stage);
  tree.setSurface(surface);
  tree.setModes(modes);
  hand.take(tree, spectrumId);
  shown = { job, spectrum, name };
  motion.gain = 0;
  motion.playing = !still.matches;
  motion.phase = 0;
  setMode("moving");
  $("progress").hidden = true;
  $("caption").textContent =
    `${name} · ${stage.height.toFixed(1)} m · ${spectrum.num_voxels.toLocaleString("en")} voxels`;
  setWind(spectrum.wind ?? { speed_m_s: 5, direction_deg: 0 });
  setView($("views").querySelector(":checked").value);
  showRest();
  showPlaying();
  hint();
}

/** What only the job's files tell: Gaussians of a cloud or of photos, else the own motion of a large mesh. */
async function showFiles(job, signal) {
  const made = await client.artifacts(job.id);
  const splat = made.find(({ name }) => name === "tree.animated-splat.safetensors");
  if (!tree?.moves || signal.aborted) return;
  const morphs = tree.hangsOnVoxels && !splat && made.find(isWorthLoading);
  if (splat) {
    const { readSplat } = await import("./splat.js");
    const read = readSplat(await client.bytes(splat.url, { signal }));
    if (!signal.aborted) await tree.setSplat(read);
  } else if (morphs) {
    const read = readMorphs(await client.bytes(morphs.url, { signal }), shown.spectrum.num_frames);
    if (signal.aborted) return;
    tree.setShapes(read);
    showMode();
  }
}

function restart() {
  run.abort();
  run = new AbortController();
  hideProblem();
  hand.leave();
  tree?.dispose();
  tree = shown = null;
  files.clear();
  $("caption").textContent = "";
  return run;
}

function toWelcome() {
  restart();
  history.replaceState(null, "", location.pathname);
  $("progress").hidden = true;
  setMode("welcome");
}

function fail(error, signal, again) {
  if (signal?.aborted || error.name === "AbortError") return;
  if (error.status === 401) return askKey(again);
  $("progress").hidden = true;
  if (!shown) setMode("welcome");
  showProblem(error, again && (error.retryable || error.code === "unreachable" || error.job) ? again : null);
}

async function askKey(again) {
  const key = await ask($("key-dialog"), $("key"));
  if (!key) return toWelcome();
  client.key = key;
  sessionStorage.setItem("key", key);
  again?.();
}

// ---- what is shown

function setMode(mode) {
  document.body.dataset.mode = mode;
  $("player").hidden = mode !== "moving";
  $("hint").hidden = mode !== "moving";
  layOut();
}

function showProgress(title, stages, job) {
  $("progress").hidden = false;
  const waits = job?.state === "queued" && job.queue_position;
  fill($("progress-title"), waits ? `${title}: ${job.queue_position} before it` : title);
  $("cancel").onclick = () => (job ? client.cancel(job.id).then(toWelcome, fail) : toWelcome());
  const items = stages.map(({ name, state, progress, cached }) => {
    const told = cached
      ? "known already"
      : state === "running"
        ? `${Math.round(progress * 100)} %`
        : state === "succeeded"
          ? "done"
          : state === "queued"
            ? ""
            : state;
    const bar = element("progress", { max: 1, value: state === "succeeded" ? 1 : progress });
    bar.setAttribute("aria-label", STAGES[name] ?? name);
    return element(
      "li",
      { className: state === "queued" ? "waiting" : state },
      element("span", {}, STAGES[name] ?? name),
      element("span", {}, told),
      bar,
    );
  });
  $("stages").replaceChildren(...items);
}

/** The tree stands in the middle of what the panels leave free. */
function layOut() {
  const moving = document.body.dataset.mode === "moving";
  const wide = innerWidth > 760;
  stage.clear({
    right: moving && wide ? 320 : 0,
    top: 56,
    bottom: moving ? 84 : document.body.dataset.mode === "waiting" ? 190 : 0,
  });
}

function hint() {
  const box = $("hint");
  box.classList.remove("going");
  fill(
    box,
    matchMedia("(pointer: coarse)").matches
      ? "Pull a branch and let go"
      : "Pull a branch and let go. Drag beside the tree to turn it.",
  );
  setTimeout(() => box.classList.add("going"), 7000);
}

function showGrip(point, pointer) {
  const grip = $("grip");
  grip.hidden = !point;
  $("stage").classList.toggle("holding", Boolean(point));
  if (!point) return;
  $("hint").classList.add("going");
  const { x, y } = stage.onScreen(point);
  grip.style.transform = `translate(${x}px, ${y}px)`;
  const [dx, dy] = [pointer.x - x, pointer.y - y];
  const line = grip.firstElementChild;
  line.style.width = `${Math.max(Math.hypot(dx, dy) - 11, 0)}px`;
  line.style.transform = `rotate(${Math.atan2(dy, dx)}rad) translateX(11px)`;
}

// ---- wind

function setWind({ speed_m_s: speed, direction_deg: direction }) {
  $("speed").value = speed;
  $("direction").value = ((direction + 540) % 360) - 180;
  showWind();
}

function showWind() {
  const made = shown?.spectrum.wind ?? { speed_m_s: 5, direction_deg: 0 };
  const speed = Number($("speed").value);
  const direction = Number($("direction").value);
  fill($("speed-out"), `${speed.toFixed(1)} m/s`);
  fill($("direction-out"), degrees(direction));
  const turn = ((direction - made.direction_deg + 540) % 360) - 180;
  motion.wanted = windGain(speed, made.speed_m_s);
  motion.turn = (turn * Math.PI) / 180;
  const sameSpeed = Math.abs(speed - made.speed_m_s) < 0.01;
  const turned = Math.abs(turn) >= 0.01;
  const same = sameSpeed && !turned;
  fill(
    $("wind-note"),
    same
      ? "The wind that this motion was made for."
      : `A preview: the same motion${sameSpeed ? "" : `, ${motion.wanted.toFixed(motion.wanted < 10 ? 1 : 0)} times as far (speed to the power 1.4)`}${turned ? `, turned by ${degrees(Math.abs(turn))}` : ""}.`,
  );
  $("make-wind").hidden = same;
  stage.wind(direction, speed / 12, accent());
  paintRanges();
}

async function makeForWind() {
  const { job, name } = shown;
  const wind = { ...job.params.wind, speed_m_s: Number($("speed").value), direction_deg: Number($("direction").value) };
  const { signal } = run;
  try {
    const made = await client.createJob({
      type: "animate",
      asset_id: job.asset_id,
      preset: job.preset,
      seed: job.seed,
      params: { ...job.params, wind },
    });
    showProgress(name, made.stages, made);
    await open(made.id);
  } catch (error) {
    fail(error, signal, makeForWind);
  }
}

// ---- views

function setView(view) {
  $("mode-box").hidden = view !== "modes";
  tree?.setView(view);
  showMode();
}

function showMode() {
  if (!tree?.moves) return;
  const k = Number($("mode").value);
  const on = document.body.dataset.mode === "moving" && tree.view === "modes";
  $("mode").max = tree.modes.K - 1;
  tree.setShown(on ? k : null);
  fill($("mode-out"), `${k}: ${tree.modes.frequencies_hz[k].toFixed(2)} Hz`);
  const most = tree.largest[k];
  const alone = on && $("mode-alone").checked;
  const times = Math.max(1, (SHOWN_SHARE * stage.height) / most);
  motion.alone = alone ? { k, times } : null;
  fill(
    $("mode-most"),
    `${most >= 0.01 ? `${(most * 100).toFixed(1)} cm` : `${(most * 1000).toFixed(1)} mm`}${alone && times > 1.05 ? `, shown ${times.toFixed(times < 10 ? 1 : 0)} times` : ""}`,
  );
  paintRanges();
}

const showRest = () => tree?.mesh && tree.setGhost($("rest").checked, accent());

/** The accent as the theme has it now: light-dark() is only resolved in a used colour. */
function accent() {
  const link = element("a", { href: "#" });
  document.body.append(link);
  const colour = getComputedStyle(link).color;
  link.remove();
  return colour;
}

// ---- time

function setPlaying(playing) {
  motion.playing = playing;
  showPlaying();
}

function showPlaying() {
  $("play").dataset.playing = motion.playing;
  $("play").setAttribute("aria-label", motion.playing ? "Pause" : "Play");
}

function showTime() {
  const period = shown.spectrum.period_s;
  $("time").value = motion.phase;
  $("time").setAttribute("aria-valuetext", `${(motion.phase * period).toFixed(1)} seconds`);
  fill($("clock"), `${(motion.phase * period).toFixed(2)} / ${period.toFixed(2)} s`);
  paintRange($("time"));
}

function paintRange(input) {
  const share = (input.value - input.min) / (input.max - input.min);
  input.style.setProperty("--share", `${share * 100}%`);
}

function paintRanges() {
  document.querySelectorAll("input[type=range]").forEach(paintRange);
}

let last = performance.now();
function eachFrame(now) {
  const seconds = Math.min((now - last) / 1000, 0.5);
  last = now;
  stage.controls.update();
  if (tree?.moves && shown) advance(seconds);
  if (stage.stale) {
    tree?.prepare(stage.renderer);
    stage.draw();
    document.body.dataset.frames = Number(document.body.dataset.frames ?? 0) + 1;
  }
  hand.tick();
  requestAnimationFrame(eachFrame);
}

function advance(seconds) {
  const { spectrum } = shown;
  if (motion.playing) motion.phase = (motion.phase + seconds / spectrum.period_s) % 1;
  const easing = Math.abs(motion.gain - motion.wanted) > 1e-3;
  motion.gain = easing
    ? motion.gain + (motion.wanted - motion.gain) * (1 - Math.exp(-seconds / (EASE_S / 2)))
    : motion.wanted;
  const q = coordinates();
  const before = advance.before;
  const key = `${motion.phase} ${motion.gain} ${motion.turn} ${JSON.stringify(motion.alone)}`;
  if (key !== before || hand.moving || tree.groups.length) tree.move(q, motion.turn, hand.groups);
  if (key !== before) showTime();
  advance.before = key;
}

function coordinates() {
  const { K } = tree.modes;
  if (!motion.alone) return windCoordinates(K, motion.phase, motion.gain);
  const { k, times } = motion.alone;
  const q = new Float32Array(2 * K);
  // slowed to a beat that the eye follows, still whole turns a loop
  const turns = Math.min(k, 3);
  q[2 * k] = times * Math.cos(2 * Math.PI * turns * motion.phase);
  q[2 * k + 1] = times * Math.sin(2 * Math.PI * turns * motion.phase);
  return q;
}

// ---- wiring

function newStage() {
  try {
    return new Stage($("canvas"));
  } catch (error) {
    document.body.dataset.mode = "welcome";
    showProblem(
      new Problem({
        title: "This browser cannot draw the tree",
        detail: `WebGL 2 is needed: ${error.message}.`,
        suggestion:
          "Try another browser, or switch on hardware acceleration. Uploads and downloads over /v1 work without it.",
        code: "no-webgl",
      }),
    );
    throw error;
  }
}

function wire() {
  $("choose").onclick = () => $("files").click();
  $("files").onchange = () => {
    begin([...$("files").files]);
    $("files").value = "";
  };
  $("new").onclick = toWelcome;
  $("open-jobs").onclick = () => jobs.show();
  $("theme").onclick = () => {
    setTheme(true);
    look();
  };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", look);
  for (const id of ["speed", "direction"]) $(id).oninput = showWind;
  $("make-wind").onclick = makeForWind;
  $("views").onchange = (event) => setView(event.target.value);
  $("mode").oninput = $("mode-alone").onchange = showMode;
  $("rest").onchange = showRest;
  $("knock").onclick = () => hand.knock();
  $("damping").oninput = () => {
    fill($("damping-out"), `${$("damping").value} %`);
    paintRange($("damping"));
  };
  $("damping").onchange = () => hand.setDamping(Number($("damping").value) / 100);
  fill($("damping-out"), "by foliage");
  paintRange($("damping"));
  $("play").onclick = () => setPlaying(!motion.playing);
  $("time").oninput = () => {
    setPlaying(false);
    motion.phase = Number($("time").value) % 1;
  };
  addEventListener("resize", layOut);
  addEventListener("keydown", onKey);
  wireDrop();
  $("examples").replaceChildren(...EXAMPLES.map(exampleItem));
  client.json("GET", "/v1/limits").then(tellFormats, () => {});
}

function exampleItem({ file, name, height }) {
  const picture = element("img", {
    src: `./web/examples/${file}.webp`,
    alt: "",
    width: 128,
    height: 128,
    loading: "lazy",
  });
  const start = button("", async () => {
    const response = await fetch(`./web/examples/${file}.glb`);
    begin([new File([await response.blob()], `${file}.glb`)], { example: name });
  });
  start.append(picture, element("span", {}, name), element("small", {}, height));
  return element("li", {}, start);
}

function tellFormats(limits) {
  const list = (names) => names.map((name) => name.toUpperCase()).join(", ");
  const parts = [`Mesh: ${list(limits.mesh_formats)}`];
  parts.push(`splat or scan: ${list(limits.cloud_formats)}`);
  parts.push(`or ${limits.min_photos} to ${limits.max_photos} photos all around one tree`);
  fill($("formats"), parts.join("; "));
}

function wireDrop() {
  let depth = 0;
  const veil = (shownNow) => {
    $("veil").hidden = !shownNow;
  };
  addEventListener("dragenter", (event) => {
    event.preventDefault();
    if (event.dataTransfer?.types.includes("Files")) veil(++depth > 0);
  });
  addEventListener("dragleave", () => veil((depth = Math.max(depth - 1, 0)) > 0));
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    veil((depth = 0));
    begin([...event.dataTransfer.files]);
  });
}

function onKey(event) {
  if (document.querySelector("dialog[open]") || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape") return hand.held ? hand.letGo() : hideProblem();
  if (event.target.matches?.("input, button, summary, a, select") || !tree) return;
  const step = 0.12;
  const keys = {
    ArrowLeft: () => stage.orbit(-step, 0),
    ArrowRight: () => stage.orbit(step, 0),
    ArrowUp: () => stage.orbit(0, step),
    ArrowDown: () => stage.orbit(0, -step),
    "+": () => stage.orbit(0, 0, 0.9),
    "=": () => stage.orbit(0, 0, 0.9),
    "-": () => stage.orbit(0, 0, 1.1),
    Home: () => stage.home(),
    " ": () => tree.moves && setPlaying(!motion.playing),
    p: () => hand.knock(),
    P: () => hand.knock(),
  };
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
}

function look() {
  stage.look(setTheme(false));
  if (shown) {
    showWind();
    showRest();
  }
}

wire();
look();
setMode("welcome");
paintRanges();
requestAnimationFrame(eachFrame);
const linked = new URLSearchParams(location.hash.slice(1)).get("job");
if (linked) open(linked);
