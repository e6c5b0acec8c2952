// The page's logic that needs no browser: states, sessions, which files belong together.

import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { register } from "node:module";
import { test } from "node:test";
import { Client, Problem, patiently } from "../../web/client.js";
import { Gust } from "../../web/draw/gust.js";
import { Resolution } from "../../web/draw/resolution.js";
import { bandGains, powerLaw } from "../../web/motion/bands.js";
import { forestMotions, forestPlaces, gustAt } from "../../web/motion/company.js";
import { carriedPoint } from "../../web/motion/grip.js";
import { verticesNear } from "../../web/motion/hang.js";
import { ringing, swayFrequency } from "../../web/motion/local.js";
import { Modes } from "../../web/motion/modes.js";
import { equilibrium, Pin } from "../../web/motion/pin.js";
import { binSizes, displaced, swingBones } from "../../web/motion/swing.js";
import { relativePaths, sortFiles, treesAmong } from "../../web/page/bundles.js";
import { proposals, SizeDoubt, warningsOf } from "../../web/page/doubt.js";
import { readDrop } from "../../web/page/drop.js";
import { checkContent } from "../../web/page/first_bytes.js";
import { Machine, TRANSITIONS } from "../../web/page/machine.js";
import { fileName, shortened, stem } from "../../web/page/names.js";
import { Session } from "../../web/page/session.js";
import { StrokeList } from "../../web/page/stroke_list.js";
import de from "../../web/texts/de.js";
import en from "../../web/texts/en.js";
import KITS from "../../web/texts/kits.js";

// what is drawn imports three.js by its bare name, for which the page has an import map
const three = new URL("../../web/vendor/three-0.187.0/", import.meta.url).href;
const bare = `export function resolve(name, context, next) {
  const [start, at] = name === "three" ? ["three", "three.module.js"] : ["three/", ""];
  return next(name.startsWith(start) ? "${three}" + at + name.slice(start.length) : name, context);
}`;
register(`data:text/javascript,${encodeURIComponent(bare)}`);
const { THREE, softenFoliage, seenBox, readDropped, Stage, KitDialog } = await (async () => ({
  THREE: await import("three"),
  ...(await import("../../web/draw/foliage.js")),
  ...(await import("../../web/page/kits.js")),
  ...(await import("../../web/draw/surface.js")),
  ...(await import("../../web/draw/dropped.js")),
  ...(await import("../../web/draw/stage.js")),
}))();

const limits = {
  mesh_formats: ["obj", "ply", "glb", "gltf"],
  cloud_formats: ["ply", "splat", "spz", "txt", "xyz"],
  film_formats: ["mp4", "mov", "m4v"],
};
const file = (path, size = 10) => ({ name: path.split("/").pop(), path, size, lastModified: 0 });
const paths = (bundles) => bundles.map((bundle) => bundle.map(({ path }) => path).sort());
const away = () => new Problem({ code: "unreachable" });

test("every state is reached, and can be left for the welcome", () => {
  const states = new Set(Object.values(TRANSITIONS).flatMap((events) => Object.values(events)));
  assert.deepEqual([...states].sort(), Object.keys(TRANSITIONS).sort());
  for (const [state, events] of Object.entries(TRANSITIONS)) assert.equal(events.leave, "welcome", state);
});

test("an event that leads nowhere is an error, and a new beginning forgets the facts", () => {
  const machine = new Machine();
  assert.throws(() => machine.send("started"), /welcome/);
  machine.send("upload", { name: "oak" });
  machine.send("accepted", { asset: 1 });
  assert.deepEqual(machine.facts, { name: "oak", asset: 1 });
  machine.send("open", { job: 2 });
  assert.deepEqual([machine.state, machine.facts], ["queued", { job: 2 }]);
});

test("two models are two trees, each with its own companions", () => {
  const files = ["a/scene.gltf", "a/scene.bin", "a/textures/leaf.png", "b/oak.obj", "b/oak.mtl", "b/.DS_Store"].map(
    (p) => file(p),
  );
  assert.deepEqual(paths(sortFiles(files, limits).bundles), [
    ["a/scene.bin", "a/scene.gltf", "a/textures/leaf.png"],
    ["b/oak.mtl", "b/oak.obj"],
  ]);
});

test("names are relative to the model's folder", () => {
  const [bundle] = sortFiles([file("oak/textures/leaf.png"), file("oak/scene.gltf")], limits).bundles;
  assert.deepEqual(
    relativePaths(bundle).map(({ path }) => path),
    ["scene.gltf", "textures/leaf.png"],
  );
  assert.equal(stem("oak/scene.gltf"), "oak");
  assert.equal(stem("birch.tree.glb"), "birch.tree");
});

test("a splat and a mesh in its place are one tree, two meshes are not", () => {
  assert.equal(sortFiles([file("tree.splat"), file("tree.glb")], limits).bundles.length, 1);
  assert.equal(sortFiles([file("one.glb"), file("two.glb")], limits).bundles.length, 2);
});

test("photos are one tree; notes beside a model are no scan; nothing is no tree", () => {
  const photos = Array.from({ length: 9 }, (_, i) => file(`p/${i}.jpg`));
  assert.equal(sortFiles(photos, limits).bundles.length, 1);
  assert.deepEqual(paths(sortFiles([file("readme.txt"), file("oak.glb")], limits).bundles), [
    ["oak.glb", "readme.txt"],
  ]);
  assert.equal(sortFiles([file("scan.txt")], limits).bundles.length, 1);
  assert.deepEqual(paths(sortFiles([file("readme.txt"), file("Walk.MOV")], limits).bundles), [["Walk.MOV"]]);
  assert.deepEqual(sortFiles([file("a.doc"), file("b.pdf")], limits).bundles, []);
  assert.equal(sortFiles([file("oak.glb", 0)], limits).empty.length, 1);
});

test("what holds no tree is said to hold none, and one file is sent even where nothing is known of formats", () => {
  assert.throws(() => treesAmong([], limits), { code: "empty-folder" });
  assert.throws(() => treesAmong([file("oak/.DS_Store")], limits), { code: "empty-folder" });
  assert.throws(() => treesAmong([file("oak.glb", 0)], limits), { code: "empty-file", name: "oak.glb" });
  assert.throws(() => treesAmong([file("a.doc"), file("b.pdf")], limits), { code: "no-model", n: 2 });
  assert.deepEqual(paths(treesAmong([file("oak.glb")], null)), [["oak.glb"]]);
});

test("a dropped folder is read whole, with its paths", async () => {
  const leaf = (name) => ({ name, isFile: true, file: (resolve) => resolve({ name }) });
  const folder = (name, children) => {
    const batches = [...children.map((child) => [child]), []];
    return { name, isDirectory: true, createReader: () => ({ readEntries: (resolve) => resolve(batches.shift()) }) };
  };
  const tree = folder("oak", [leaf("scene.gltf"), folder("textures", [leaf("leaf.png")])]);
  const files = await readDrop({ items: [{ webkitGetAsEntry: () => tree }], files: [] });
  assert.deepEqual(
    files.map(({ path }) => path),
    ["oak/scene.gltf", "oak/textures/leaf.png"],
  );
});

test("a folder that cannot be read is an error", async () => {
  const broken = {
    name: "oak",
    isDirectory: true,
    createReader: () => ({ readEntries: (_, reject) => reject(new Error("gone")) }),
  };
  await assert.rejects(readDrop({ items: [{ webkitGetAsEntry: () => broken }], files: [] }), /gone/);
});

// ---- sessions

const job = (state, more = {}) => ({
  id: "J1",
  asset_id: "A1",
  type: "animate",
  state,
  stages: [],
  result: null,
  params: {},
  ...more,
});
const moving = { result: { spectrum_id: "S1" } };
const silent = {
  clear() {},
  photos() {},
  dropped: async () => {},
  poster: async () => {},
  rest: async () => {},
  motion: async () => {},
  products: async () => {},
  showMesh() {},
};

function begin({ jobs = [], ...client } = {}) {
  const states = [];
  const machine = new Machine((state, _, before) => state !== before && states.push(state));
  const fake = {
    upload: async () => ({ id: "A1", kind: "mesh", parts: [{ name: "oak.glb" }] }),
    asset: async () => ({ id: "A1", kind: "mesh", parts: [{ name: "oak.glb" }] }),
    job: async () => jobs[0],
    createJob: async () => job("queued"),
    watch: async function* () {
      yield* jobs;
    },
    ...client,
  };
  return { session: new Session(fake, machine, silent), machine, states };
}

test("a tree goes from its files to its motion", async () => {
  const { session, states } = begin({
    jobs: [job("queued"), job("running"), job("running", moving), job("succeeded", moving)],
  });
  await session.upload([], { name: "oak" });
  assert.deepEqual(states, ["uploading", "queued", "running", "moving"]);
});

/** Let pauses of a test last a tenth of their time. */
function hurry(t) {
  const start = globalThis.setTimeout;
  globalThis.setTimeout = (call, ms, ...given) => start(call, ms / 10, ...given);
  t.after(() => {
    globalThis.setTimeout = start;
  });
}

test("a service that goes away keeps the card, and the job goes on", { timeout: 30_000 }, async (t) => {
  hurry(t);
  let breaks = 2;
  const watch = async function* () {
    yield job("running");
    if (breaks-- > 0) throw away();
    yield job("succeeded", moving);
  };
  const { session, machine, states } = begin({ watch });
  const seen = [];
  const { onChange } = machine;
  machine.onChange = (...change) => {
    onChange(...change);
    seen.push(Boolean(machine.facts.away));
  };
  await session.upload([], { name: "oak" });
  assert.deepEqual(states, ["uploading", "queued", "running", "moving"]);
  assert.ok(seen.includes(true), "the break is shown");
  assert.equal(machine.facts.away, null);
});

test("an upload goes on after a break", { timeout: 30_000 }, async (t) => {
  hurry(t);
  let attempts = 0;
  const upload = async () => {
    if (attempts++ === 0) throw away();
    return { id: "A1", kind: "mesh", parts: [{ name: "oak.glb" }] };
  };
  const { session, states } = begin({ upload, jobs: [job("succeeded", moving)] });
  await session.upload([], { name: "oak" });
  assert.equal(attempts, 2);
  assert.equal(states.at(-1), "moving");
});

test("try again runs a job that has ended as a new job", async () => {
  const retried = [];
  const retry = async (id) => {
    retried.push(id);
    return job("queued", { id: "J2" });
  };
  const watch = async function* (id) {
    assert.equal(id, "J2", "a job that has ended does not change any more");
    yield job("succeeded", { id, ...moving });
  };
  const { session, machine, states } = begin({ retry, watch, jobs: [job("canceled")] });
  await session.open("J1");
  assert.deepEqual([machine.state, machine.facts.problem.code], ["failed", "job-canceled"]);
  await session.retry();
  assert.deepEqual(retried, ["J1"]);
  assert.deepEqual(states, ["queued", "failed", "queued", "moving"]);
  assert.equal(session.jobId, "J2");
});

test("a refused upload is tried again with the same files", async () => {
  const given = [];
  const upload = async (files) => {
    given.push(files);
    throw new Problem({ code: "unsupported-format" }, { status: 415 });
  };
  const { session, machine } = begin({ upload });
  const files = [file("oak.doc")];
  await session.upload(files, { name: "oak" });
  assert.equal(machine.state, "failed");
  await session.retry();
  assert.deepEqual(given, [files, files]);
});

test("a job that made voxels only ends, and offers motion", async () => {
  const { session, machine } = begin({ jobs: [job("succeeded", { type: "voxelize", result: { voxels_id: "V" } })] });
  await session.open("J1");
  assert.deepEqual([machine.state, machine.facts.problem.code], ["failed", "no-motion"]);
  assert.ok(machine.facts.problem.offersMotion);
});

test("a failure of the files leaves the tree moving", async () => {
  const { session, machine } = begin({
    jobs: [job("running", moving), job("failed", { ...moving, error: { code: "disk-full", title: "full" } })],
  });
  let shown = 0;
  session.scene = { ...silent, showMesh: () => shown++ };
  await session.open("J1");
  assert.deepEqual([machine.state, machine.facts.problem.code, shown], ["moving", "disk-full", 1]);
});

test("what was left does not come back", async () => {
  let answer;
  const upload = () =>
    new Promise((resolve) => {
      answer = resolve;
    });
  const { session, machine, states } = begin({ upload, jobs: [job("succeeded", moving)] });
  const done = session.upload([], { name: "oak" });
  session.leave();
  answer({ id: "A1", kind: "mesh", parts: [] });
  await done;
  assert.deepEqual([machine.state, states], ["welcome", ["uploading", "welcome"]]);
});

test("only breaks of the connection are waited out", async () => {
  await assert.rejects(
    patiently(() => Promise.reject(new Problem({ code: "not-found" }, { status: 404 }))),
    { code: "not-found" },
  );
});

test("the job that is shown was deleted: the card says so, and its tree is gone", async () => {
  const { session, machine } = begin({ jobs: [job("succeeded", moving)] });
  await session.open("J1");
  session.deleted();
  assert.deepEqual([machine.state, machine.facts.problem.code], ["failed", "job-deleted"]);
});

test("every language has every text, and each format is told", () => {
  const keys = Object.keys(en).sort();
  assert.deepEqual(Object.keys(de).sort(), keys);
  const { schemas } = JSON.parse(readFileSync("openapi/openapi.json", "utf8")).components;
  for (const format of schemas.ProductPayload.properties.format.enum) {
    assert.ok(keys.includes(`format.${format}`) && keys.includes(`format.${format}.for`), format);
  }
});

// ---- drawing

test("in software the first frames have fewer pixels already, never so few as blocks, and a still picture all", () => {
  const resolution = new Resolution(2, true);
  for (let now = 0; now < 6000; now += 300) resolution.next(now);
  assert.ok(resolution.scale === 0.6 && resolution.shadowEvery === 2);
  assert.ok(!resolution.sharp && resolution.settles(6300));
  for (let now = 0; now < 1200; now += 10) resolution.next(now);
  assert.equal(resolution.scale, 1, "it is not slow after all");
});

test("slow frames get fewer pixels, quick ones all of them, a still picture is drawn in full", () => {
  const resolution = new Resolution();
  let now = 0;
  const frames = (count, ms) => {
    for (let i = 0; i < count; i++) resolution.next((now += ms));
  };
  frames(60, 120);
  assert.ok(resolution.scale <= 0.5 && !resolution.sharp && resolution.shadowEvery > 1);
  assert.ok(!resolution.settles(now + 100) && resolution.settles(now + 300));
  frames(120, 10);
  assert.ok(resolution.scale === 1 && resolution.sharp);
  frames(20, 1100);
  assert.equal(resolution.scale, 0.5, "frames of more than a second are slow, no pauses");
  frames(120, 10);
  for (let i = 0; i < 20; i++) {
    resolution.pause();
    frames(1, 1100);
  }
  assert.equal(resolution.scale, 1, "a still picture costs nothing");
});

test("what is let go swings about its rest, less far each time", () => {
  assert.equal(ringing(0, 2, 0.13), 1);
  const swing = Array.from({ length: 400 }, (_, i) => ringing(i / 100, 2, 0.13));
  assert.ok(Math.abs(swing[1] - 1) < 0.01, "it begins without velocity");
  assert.ok(Math.min(...swing) < -0.5 && Math.min(...swing) > -1);
  const crossings = swing.filter((x, i) => i && x * swing[i - 1] < 0).length;
  assert.ok(Math.abs(crossings - 16) <= 1, `${crossings} crossings in four seconds at 2 Hz`);
  assert.ok(Math.abs(swing.at(-1)) < 0.01);
});

test("a forest: nine copies whose gust travels with the wind, each turned back by its yaw", () => {
  const places = forestPlaces(6);
  assert.equal(places.length, 9);
  for (const [i, { x, y }] of places.entries()) {
    for (const other of [{ x: 0, y: 0 }, ...places.slice(0, i)]) assert.ok(Math.hypot(x - other.x, y - other.y) > 4);
  }
  const now = { K: 3, phase: 0.2, period: 4, direction_rad: 0, made: { gust: 0.3 } };
  const wind = { speed: 5, gains: [1, 1, 1], turn: 0.5 };
  const [near, far] = forestMotions(
    [
      { x: 0, y: 7, yaw: 0 },
      { x: 10, y: 0, yaw: 2 },
    ],
    now,
    wind,
  ); // prettier-ignore
  const later = forestMotions([{ x: 0, y: 0, yaw: 0 }], { ...now, phase: 0.2 - 10 / 5 / 4 }, wind)[0];
  assert.deepEqual([far.q, far.air], [later.q, later.air], "10 m downwind it comes 2 s later");
  assert.ok(near.q[2] !== far.q[2]);
  assert.ok(Math.abs(far.turn - (0.5 - 2)) < 1e-12);
  const mean = Array.from({ length: 64 }, (_, i) => gustAt(i / 64)).reduce((sum, gust) => sum + gust / 64, 0);
  assert.ok(Math.abs(mean - 1) < 1e-9);
});

test("gains are the model's at its speeds, rise between them, and stay above the last", () => {
  const bands = {
    speeds_m_s: [0, 1, 4, 20],
    gains: [
      [0, 0],
      [0.1, 0.2],
      [0.7, 0.6],
      [5, 4],
    ],
  }; // prettier-ignore
  bands.speeds_m_s.forEach((speed, b) => {
    assert.deepEqual(bandGains(bands, speed), bands.gains[b]);
  });
  const swept = Array.from({ length: 121 }, (_, i) => bandGains(bands, i / 4));
  swept.slice(1).forEach((gains, i) => {
    for (const k of [0, 1]) assert.ok(gains[k] >= swept[i][k] && gains[k] - swept[i][k] < 0.15, `${(i + 1) / 4} m/s`);
  });
  assert.deepEqual(bandGains(bands, 30), [5, 4]);
  const law = powerLaw(2, 6);
  assert.equal(bandGains(law, 6)[1], 1);
  assert.ok(Math.abs(bandGains(law, 12)[1] - 2 ** 1.4) < 1e-12);
  assert.ok(Math.abs(bandGains(law, 24)[1] - 2 ** 2.4) < 1e-12, "linear above 12 m/s");
});

test("a voxel whose vertex moves in one bin alone sways at its frequency", () => {
  const surface = bent();
  const K = 2;
  surface.turn_shapes.fill(0);
  surface.turn_shapes[6 * (2 * K + 1)] = 100; // the upper bone, bin 1
  const modes = { K, frequencies_hz: [0, 0.5] };
  assert.equal(swayFrequency({ surface, modes, vertexOf: [2] }, 0), 0.5);
});

test("a stroke stays on its photo, keeps its distance between points, and can be taken back", () => {
  const strokes = new StrokeList();
  assert.deepEqual(strokes.params, { scribbles: null, only_plant: true });
  strokes.begin("a.jpg", true, [0.5, 1.4]);
  for (let i = 0; i <= 10_000; i++) strokes.extend([0.5 + i / 30_000, 0.5]);
  strokes.begin("b.jpg", false, [0.25, -0.1]);
  const { scribbles, only_plant: alone } = strokes.params;
  assert.equal(alone, false);
  assert.deepEqual(scribbles[1], { photo: "b.jpg", plant: false, points: [[0.25, 0]] });
  const { points } = scribbles[0];
  assert.deepEqual(points.slice(0, 2), [
    [0.5, 1],
    [0.5, 0.5],
  ]);
  const steps = points.slice(2).map(([x], i) => x - points[i + 1][0]);
  assert.ok(Math.min(...steps) >= 0.004 && Math.max(...steps) < 0.0042);
  strokes.undo("a.jpg");
  strokes.undo("a.jpg");
  assert.deepEqual(
    strokes.all.map(({ photo }) => photo),
    ["b.jpg"],
  );
});

test("a stroke and their number stay as small as the service takes them", () => {
  const strokes = new StrokeList([{ photo: "a.jpg", plant: true, points: [[0, 0]] }]);
  for (let i = 0; i < 5000; i++) strokes.extend([i % 2, (i % 97) / 97]);
  assert.ok(strokes.all[0].points.length <= 1000 && strokes.all[0].points.length > 400);
  for (let i = 0; i < 300; i++) strokes.begin("a.jpg", true, [0.1, 0.1]);
  assert.ok(strokes.isFull);
  assert.equal(strokes.params.scribbles.length, 200);
});

/** Three joints 1 m above each other on the ground, a voxel at the end of each. */
function pole() {
  return Object.assign(Object.create(Modes.prototype), {
    ...{ J: 4, V: 4, K: 1, voxelSize: 0.1 },
    joint_parent: [-1, 0, 1, 2],
    joint_place_m: Float32Array.from([0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 2]),
    joint_give: [0, 1 / 3, 1 / 2, 1],
    joint_of_voxel: [0, 1, 2, 3],
    centres: Float32Array.from([0, 0, 0, 0, 0, 1, 0, 0, 2, 0, 0, 3]),
  });
}

const distance = (a, b) => Math.hypot(...a.map((x, i) => x - b[i]));

test("a pull holds the point that is drawn, whichever joints carry it", () => {
  const modes = pole();
  const leaf = { voxel: 2, rest: [0.1, 0, 2.6], joints: [1, 2, 3, 0], weights: [0.3, 0.5, 0.2, 0] };
  const pin = new Pin(modes, leaf);
  const target = [0.9, 0.3, 2.3];
  for (let frame = 0; frame < 3; frame++) pin.hold([], leaf.rest, target);
  assert.ok(distance(carriedPoint(modes.poses([pin.group]), leaf, leaf.rest), target) < 0.002);
});

test("a pull along a crooked stem straightens it, to just below its length", () => {
  const crooked = [0, 0, 0, 0, 0, 0, 0.25, 0, 1, -0.1, 0.2, 2];
  const modes = Object.assign(pole(), { joint_place_m: Float32Array.from(crooked) });
  const tip = { voxel: 3, rest: [0, 0, 3], joints: [3, 2, 0, 0], weights: [0.55, 0.45, 0, 0] };
  for (const high of [3.05, 3.075]) {
    const pin = new Pin(modes, tip);
    for (let frame = 0; frame < 20; frame++) pin.hold([], tip.rest, [0, 0, high]);
    const at = carriedPoint(modes.poses([pin.group]), tip, tip.rest);
    assert.ok(distance(at, [0, 0, high]) < 0.005, `${high}: ${at}`);
  }
});

test("its answers are those of the service", () => {
  // tests/modal/test_laws_of_the_pull.py reads the same file
  for (const { name, segments_m, give, target_m, bend, reached_m } of JSON.parse(
    readFileSync("tests/modal/pulls.json", "utf8"),
  )) {
    const still = bend.map(() => [0, 0, 0]);
    const pull = equilibrium({ segments: segments_m, give }, target_m, { bend: still, rounds: 120 });
    assert.ok(distance(pull.reached, reached_m) < 1e-5, `${name}: ${pull.reached}`);
    for (const [i, k] of pull.bend.entries()) assert.ok(distance(k, bend[i]) < 1e-5, `${name} ${i}: ${k} ${bend[i]}`);
  }
});

test("a place in the very joint of its bone is carried by the joints below", () => {
  const modes = pole();
  modes.centres = Float32Array.from([0, 0, 0, 0, 0, 1, 0, 0, 2, 0, 0, 2]);
  const joint = { voxel: 3, rest: [0, 0, 2], joints: [3, 0, 0, 0], weights: [1, 0, 0, 0] };
  const pin = new Pin(modes, joint);
  for (let frame = 0; frame < 5; frame++) pin.hold([], joint.rest, [0.5, 0, 1.9]);
  assert.ok(distance(carriedPoint(modes.poses([pin.group]), joint, joint.rest), [0.5, 0, 1.9]) < 0.005);
});

test("what is let go leaves the hand slowly, and goes all the way, on a slow machine and behind a late service", () => {
  const modes = pole();
  const tip = { voxel: 3, rest: [0, 0, 3], joints: [3, 0, 0, 0], weights: [1, 0, 0, 0] };
  const pin = new Pin(modes, tip);
  const [held, still] = [[0.9, 0.3, 2.7], []];
  for (let frame = 0; frame < 3; frame++) pin.hold(still, tip.rest, held);
  const late = [structuredClone(pin.group)]; // the service's answer to the pull comes after the release
  const places = [carriedPoint(modes.poses([pin.group]), tip, tip.rest)];
  const go = (groups, seconds) => {
    const left = pin.fade(groups, tip.rest, seconds);
    places.push(carriedPoint(modes.poses([...groups, pin.group]), tip, tip.rest));
    return left;
  };
  go(still, 0.5); // half a second in the hand
  go(late, 1 / 60);
  while (go(still, 1 / 60));
  const steps = places.slice(1).map((place, i) => distance(place, places[i]));
  assert.ok(steps[0] < 0.01 * distance(held, tip.rest), `it jumps by ${steps[0]}`);
  assert.ok(steps[1] < 0.5 * Math.max(...steps) && distance(places[2], held) < 0.1, `${steps[1]}`);
  assert.ok(distance(places.at(-1), tip.rest) < 0.01 && places.length < 90);
});

/** A stem of two bones, the upper one of a vertex that hangs half on its parent. */
const bent = () => ({
  turn_parent: Int32Array.from([-1, 0, 1]),
  turn_foot_m: Float32Array.from([0, 0, 0, 0, 0, 0, 0.2, 0.1, 1.5]),
  turn_direction: Float32Array.from([0, 0, 1, 0, 0, 1, 0, 0, 1]),
  turn_step_rad: Float32Array.from([2e-6, 2e-6, 3e-6]),
  turn_shapes: Int16Array.from({ length: 36 }, (_, i) => (i < 12 ? 0 : ((i * 7919) % 6000) - 3000)),
  turn_bone: Int32Array.from([1, 2, 2]),
  turn_share: Float32Array.from([0, 0.5, 0]),
  vertices: Float32Array.from([0.1, 0, 0.7, 0.3, 0.2, 1.9, -0.2, 0.4, 3]),
});

test("the size of a bin is how far small turns of the bones move a vertex", () => {
  const surface = bent();
  const swings = new Float32Array(8 * surface.turn_parent.length);
  const moved = (...q) => {
    swingBones(surface, { q, turn: 0 }, swings);
    return [0, 1, 2].map((v) => Math.hypot(...displaced(surface, v, swings)));
  };
  const [real, imaginary] = [moved(0, 0, 1, 0), moved(0, 0, 0, 1)];
  binSizes(surface, 1, [0, 1, 2]).forEach((size, v) => {
    assert.ok(size > 0.0002, "it moves");
    assert.ok(Math.abs(size - Math.hypot(real[v], imaginary[v])) < 0.02 * size, `${v}`);
  });
});

test("a voxel moves with the vertex in it, or with the nearest one", () => {
  const modes = { V: 2, voxelSize: 0.5, origin: [-1, -1, 0] };
  modes.coords = Int16Array.from([2, 2, 3, 2, 2, 0]); // the second vertex lies in the first voxel
  modes.centres = Float32Array.from(modes.coords, (step, i) => modes.origin[i % 3] + (step + 0.5) * modes.voxelSize);
  assert.deepEqual([...verticesNear(modes, bent().vertices)], [1, 0]);
});

// ---- names, sizes, first bytes, gusts

test("a name of any length and script stays a name, on the page and in file systems", () => {
  const long = "Baum ".repeat(50);
  assert.ok([...new Intl.Segmenter().segment(shortened(long))].length <= 48);
  assert.ok(shortened(long).startsWith("Baum") && shortened(long).includes("…"));
  assert.equal(fileName("Oak 🌳", ".glb"), "Oak 🌳.glb");
  assert.equal(fileName("שלום עץ", ".png"), "שלום עץ.png");
  assert.equal(fileName('../a:b"c', "-preview.png"), "abc-preview.png");
  assert.equal(fileName("...", ".glb"), "tree.glb");
  assert.ok(Buffer.byteLength(fileName("🌳".repeat(100), "-tree.spectrum.safetensors")) <= 255);
});

test("what the report of photos warns of is said beside the tree until it is read", async () => {
  const bytes = async () => new TextEncoder().encode('{"warnings": ["no photo was taken in 130 degrees"]}').buffer;
  const warnings = await warningsOf({ bytes }, { url: "/v1/artifacts/1" });
  const nodes = {};
  function take(...inner) {
    this.inner = inner;
  }
  const node = () => ({ hidden: true, append: take, replaceChildren: take });
  globalThis.document = { getElementById: (id) => (nodes[id] ??= node()), createElement: node };
  new SizeDoubt({ onChange() {} }).say(warnings);
  assert.deepEqual([nodes.doubt.hidden, nodes["doubt-words"].textContent], [false, warnings[0]]);
  nodes["doubt-chips"].inner[0].inner[0].onclick();
  assert.equal(nodes.doubt.hidden, true);
  delete globalThis.document;
});

test("a doubtful size is proposed in the units that make a plant of it", () => {
  const heights = Object.fromEntries(proposals(2470, 1).map(({ unit, height_m }) => [unit, height_m]));
  assert.deepEqual(Object.keys(heights), ["cm", "mm", "in"]);
  assert.ok(Math.abs(heights.cm - 24.7) < 1e-9);
  assert.deepEqual(
    proposals(0.0247, 0.001).map(({ unit }) => unit),
    ["m", "cm", "in", "ft"],
  );
  assert.deepEqual(
    proposals(0.024, 1).map(({ unit }) => unit),
    ["× 10", "× 100", "× 1000"],
  );
});

test("what is no tree is told by its first bytes, before it is sent", async () => {
  const file = (name, ...parts) => [{ name, content: new Blob(parts) }];
  const glb = Buffer.alloc(2000, 1);
  glb.write("glTF");
  glb.writeUInt32LE(2, 4);
  glb.writeUInt32LE(5000, 8);
  await assert.rejects(checkContent(file("oak.glb", glb)), { code: "cut-off", size: 2000, whole: 5000 });
  await assert.rejects(checkContent(file("oak.ply", Buffer.alloc(1_000_000))), { code: "zeros" });
  const zip = ["PK\u0003\u0004[Content_Types].xml", "x".repeat(100_000)];
  await assert.rejects(checkContent(file("oak.docx", ...zip, "word/document.xml")), { code: "foreign", kind: "docx" });
  await assert.rejects(checkContent(file("oak.glb", "<!DOCTYPE html><title>")), { code: "foreign", kind: "html" });
  await checkContent(file("oak.3mf", ...zip, "3D/3dmodel.model"));
  await checkContent(file("oak.obj", "v 0 0 0\n"));
  glb.writeUInt32LE(2000, 8);
  await checkContent(file("oak.glb", glb));
});

test("a gust comes from one side, is stronger than the wind, and leaves the wind alone", () => {
  const crown = { angle: 0, middle: { x: 0, y: 0 }, radius: 4, speed_m_s: 5 };
  const gust = new Gust({ ...crown, first: true });
  const late = ({ gust: [x, y, t] }, px) => t - x * px - y * 0;
  const early = gust.after(0.5);
  assert.ok(late(early, -4) > 0 && late(early, 4) < 0, "it reaches the windward side first");
  assert.ok(early.calm < 1 && early.gust[3] > 0.5);
  while (!gust.isOver) gust.after(0.1);
  assert.deepEqual(gust.after(0.1), { gust: [0, 0, 0, 0], calm: 1 });
  assert.ok(new Gust({ ...crown, speed_m_s: 20 }).isOver, "a storm needs none");
});

test("a watcher that is stopped hears of no job", async () => {
  const client = new Client({ fetch: async () => new Response('data: {"state": "succeeded"}\n\n') });
  const jobs = [];
  const watching = async () => {
    for await (const job of client.watch("id", { signal: AbortSignal.abort() })) jobs.push(job);
  };
  await assert.rejects(watching(), { name: "AbortError" });
  assert.deepEqual(jobs, []);
});

test("a trunk is no foliage where each face has corners of its own, as in a flat-shaded mesh", () => {
  const trunk = new THREE.BoxGeometry(0.5, 0.5, 8, 1, 1, 40).toNonIndexed();
  const { array: vertices, count: N } = trunk.attributes.position;
  const own = trunk.attributes.normal.array.slice();
  const box = new THREE.Box3().setFromBufferAttribute(trunk.attributes.position);
  softenFoliage(trunk, { N, vertices, faces: Uint32Array.from({ length: N }, (_, v) => v), box });
  assert.deepEqual(new Set(trunk.attributes.color.array), new Set([220]));
  assert.deepEqual(trunk.attributes.normal.array, own);
});

test("an island three times as wide as its tree is seen whole", () => {
  const points = [
    [-0.5, -0.5, 0],
    [0.5, 0.5, 1.2],
    [-1.5, -1.5, -0.4],
    [1.5, 1.5, 0],
  ];
  const whole = new THREE.Box3().setFromPoints(points.map((point) => new THREE.Vector3(...point)));
  const surface = { vertices: Float32Array.from(points.flat()), still: Uint8Array.of(0, 0, 1, 1), N: 4 };
  assert.ok(seenBox(surface, whole).equals(whole));
});

test("a PLY mesh that does not say which way is up is not drawn before the service has found out", async () => {
  const draft = (comment) => {
    const head = `ply\nformat ascii 1.0\n${comment}element vertex 3\nproperty float x\nproperty float y\nproperty float z\n`;
    const rest = "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 2 0\n3 0 1 2\n";
    return readDropped([{ name: "tree.ply", path: "tree.ply", content: new Blob([head, rest]) }]);
  };
  assert.equal(await draft(""), null);
  const { box } = await draft("comment up_axis +Y\n");
  assert.equal(box.max.z - box.min.z, 2);
});

test("what the panels leave free is filled anew, however small the steps in which it changes", () => {
  const canvas = { clientWidth: 390, clientHeight: 490 };
  const surroundings = { backdrop: { uniforms: { share: {} } }, bringArrowNear() {} };
  const seen = new THREE.Box3(new THREE.Vector3(-8, -8, 0), new THREE.Vector3(8, 8, 13));
  const controls = { target: new THREE.Vector3(), update() {} };
  const own = {
    canvas,
    surroundings,
    seen,
    controls,
    camera: new THREE.PerspectiveCamera(),
    resolution: {},
    _setSize() {},
  };
  const stage = Object.assign(Object.create(Stage.prototype), own);
  const distance = () => stage.camera.position.distanceTo(controls.target);
  stage.home();
  for (const bottom of [10, 60, 110]) stage.clear({ bottom });
  const far = distance();
  stage.home();
  assert.equal(far, distance());
});

test("software draws a coarser map of shadows while the tree moves", () => {
  const mapSize = { setScalar: (px) => Object.assign(mapSize, { px }) };
  const stage = Object.assign(Object.create(Stage.prototype), {
    soft: true,
    canvas: { clientWidth: 9, clientHeight: 9 },
    surroundings: { sun: { shadow: { mapSize } } },
    renderer: { shadowMap: {}, render() {} },
    prepare() {},
    _setSize() {},
  });
  for (const [scale, shadow, px] of [[0.6, true, 768], [1, false, 768], [1, true, 1024]]) {
    stage._render(scale, shadow);
    assert.equal(mapSize.px, px);
  }
});

test("a tree of a folder keeps the folder's name when it is opened again", async () => {
  const kept = new Map();
  globalThis.localStorage = {
    getItem: (name) => kept.get(name) ?? null,
    setItem: (name, value) => kept.set(name, value),
  };
  const asset = { id: "A1", kind: "mesh", parts: [{ name: "scene.gltf" }] };
  const jobs = [job("succeeded", moving)];
  const { session, machine } = begin({ jobs, upload: async () => asset, asset: async () => asset });
  await session.upload([], { name: "maple" });
  await session.open("J1");
  delete globalThis.localStorage;
  assert.equal(machine.facts.name, "maple");
});

/** A dialog of kits of one tree, and the jobs that it asks for: `J2` and so on. */
function kitsOf(job) {
  const asked = [];
  const client = {
    createJob: async (request) => ({ id: `J${1 + asked.push(request)}` }),
    wait: async () => {},
    json: async () => ({
      products: [
        { format: "splat-ply", file_name: "splat.ply.zip", options: ["wind_mode"] },
        { format: "glb", file_name: "tree.glb", options: [] },
        { format: "alembic", file_name: "tree.abc", options: ["wind_mode"] },
      ],
    }),
    artifacts: async (job) => ["splat.ply.zip", "tree.glb", "tree.abc"].map((name) => ({ name, url: job })),
    bytes: async (url) => new TextEncoder().encode(url),
  };
  const dialog = Object.assign(Object.create(KitDialog.prototype), { client, onMade() {}, tree: () => ({ job }) });
  return { dialog, asked };
}

test("the kit for Blender has the mesh of a splat and one frame, whatever the job has written", async () => {
  const job = { id: "J1", asset_id: "A", params: { formats: ["splat-ply"], wind_mode: "turbulent", fps: 30 } };
  const { dialog, asked } = kitsOf(job);
  const [file] = await dialog._files("blender", "cloud", () => {});
  assert.equal(new TextDecoder().decode(file.bytes), "J2");
  const one = { wind_mode: "loop", num_frames: 1, loop: false };
  assert.deepEqual(asked.map((request) => request.params), [{ fps: 30, ...one, formats: ["glb", "splat-ply"] }]);
});

test("a kit of a turbulent motion has the loop of its wind in files that hold one period", async () => {
  const job = { id: "J1", asset_id: "A", params: { formats: ["png"], wind_mode: "turbulent", num_frames: 500 } };
  const { dialog, asked } = kitsOf(job);
  const [glb, alembic] = await dialog.artifacts(["glb", "alembic"], () => {});
  assert.deepEqual([glb, alembic].map(({ name }) => name), ["tree.glb", "tree.abc"]);
  assert.deepEqual(asked.map((request) => request.params), [
    { ...job.params, formats: ["alembic"] },
    { ...job.params, wind_mode: "loop", num_frames: null, formats: ["glb"] },
  ]);
});

test("the README of a kit names its engine's files of the wind, and in it nothing that is not there", () => {
  const wind = readdirSync(new URL("../../dynamictree/export/wind_shaders", import.meta.url));
  for (const program of ["unity", "unreal", "godot"]) {
    const named = KITS[program].readme("oak").match(/[\w-]+\.(glb|exr|gd|gdshader|hlsl|shader)\b/g);
    const there = wind.filter((name) => name.startsWith(`wind-${program}`));
    for (const name of ["tree.glb", "tree-bones.glb", ...there]) assert.ok(named.includes(name), `${program}: ${name}`);
    const all = [...there, "tree.glb", "tree-bones.glb", "bones.exr"];
    for (const name of named) assert.ok(all.includes(name), `${program}: ${name}`);
    assert.doesNotMatch(KITS[program].readme("oak"), /README/);
  }
});
