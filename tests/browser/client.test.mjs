import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { test } from "node:test";
import { Modes as Reference } from "../../recipes/modes_reference.mjs";
import { Client, hasEnded, Problem, seconds } from "../../web/client.js";
import { carried, Modes } from "../../web/motion/modes.js";
import { readTensors } from "../../web/motion/tensors.js";

const base = process.env.SERVICE_URL;
const file = (path) => ({ name: path.split("/").pop(), content: new Blob([readFileSync(path)]) });
const tree = file(process.env.TREE);
const large = file(process.env.LARGE);
const client = new Client({ base });
const request = (asset) => ({
  type: "animate",
  asset_id: asset.id,
  params: { formats: ["glb"], num_steps: 1, wind: { speed_m_s: 6 } },
});
let done;

test("a tree goes in and comes out swaying", async () => {
  const shares = [];
  const asset = await client.upload([tree], { onProgress: (share) => shares.push(share) });
  assert.deepEqual([shares[0], shares.at(-1)], [0, 1]);
  const key = `the same ${process.pid}`;
  const job = await client.createJob(request(asset), { key });
  assert.equal((await client.createJob(request(asset), { key })).id, job.id, "one key is one job");
  const seen = [];
  done = await client.wait(job.id, { onJob: (now) => seen.push(now) });
  assert.equal(seen.at(-1).state, "succeeded");
  const progress = seen.map((now) => now.progress);
  assert.deepEqual(
    progress,
    [...progress].sort((a, b) => a - b),
  );
  const made = await client.artifacts(job.id);
  const glb = made.find(({ name }) => name === "tree.glb");
  assert.equal((await client.bytes(glb.url)).byteLength, glb.bytes);
  assert.ok((await client.jobs({ limit: 1 })).data.length === 1);
});

test("a job is followed by polling where events do not come through", async () => {
  const asked = [];
  const fetching = (url, options) => {
    asked.push(url);
    if (url.endsWith("/events")) return Promise.reject(new TypeError("cut off"));
    return fetch(url, options);
  };
  const polling = new Client({ base, fetch: fetching });
  const job = await polling.createJob({ ...request({ id: done.asset_id }), seed: 5 });
  const end = await polling.wait(job.id);
  assert.ok(hasEnded(end));
  assert.ok(asked.some((url) => url.endsWith("/events")));
  assert.ok(asked.filter((url) => url.endsWith(`/v1/jobs/${job.id}`)).length > 1);
});

test("a large upload goes on at the byte that was reached", async () => {
  const pieces = [];
  const memory = new Map();
  const storage = {
    getItem: (k) => memory.get(k) ?? null,
    setItem: (k, v) => memory.set(k, v),
    removeItem: (k) => memory.delete(k),
  };
  let cut = 0;
  const breaking = async (url, options) => {
    if (options.method === "PATCH") {
      pieces.push(Number(options.headers["Upload-Offset"]));
      if (pieces.length >= 2 && cut < 3) {
        // half of a piece arrives, then the line breaks
        if (cut++ === 0) await fetch(url, { ...options, body: options.body.slice(0, options.body.size / 2) });
        throw new TypeError("cut off");
      }
    }
    return fetch(url, options);
  };
  const asset = await new Client({ base, storage, fetch: breaking }).upload([large]);
  assert.equal(cut, 3);
  assert.equal(asset.parts[0].bytes, large.content.size);
  const half = 8 * 2 ** 20 * 1.5;
  assert.ok(pieces.includes(half), `${pieces}`);
  assert.equal(pieces.filter((offset) => offset === 0).length, 1, "nothing is sent twice");
  assert.equal(memory.size, 0);
});

test("an upload goes on in another session", async () => {
  const memory = new Map();
  const other = { name: "again.obj", content: new Blob([large.content, "\n# again\n"]) };
  const storage = {
    getItem: (k) => memory.get(k) ?? null,
    setItem: (k, v) => memory.set(k, v),
    removeItem: (k) => memory.delete(k),
  };
  let sent = 0;
  const stopping = new AbortController();
  const first = (url, options) => {
    if (options.method === "PATCH" && ++sent === 2) stopping.abort(new Error("the page was closed"));
    return fetch(url, options);
  };
  await assert.rejects(new Client({ base, storage, fetch: first }).upload([other], { signal: stopping.signal }));
  const offsets = [];
  const second = (url, options) => {
    if (options.method === "PATCH") offsets.push(Number(options.headers["Upload-Offset"]));
    return fetch(url, options);
  };
  const asset = await new Client({ base, storage, fetch: second }).upload([other]);
  assert.equal(asset.parts[0].bytes, other.content.size);
  assert.ok(offsets[0] >= 8 * 2 ** 20, `${offsets}`);
});

test("a problem is the service's own", async () => {
  await assert.rejects(client.job("01ARZ3NDEKTSV4RRFFQ69G5FAX"), (problem) => {
    assert.ok(problem instanceof Problem);
    assert.deepEqual([problem.status, problem.code], [404, "not-found"]);
    assert.ok(problem.title && problem.suggestion && problem.request_id);
    return true;
  });
  const away = new Client({ base: "http://127.0.0.1:1" });
  await assert.rejects(away.json("POST", "/v1/jobs", {}), ({ code }) => code === "unreachable");
});

test("Retry-After is honoured", async () => {
  const times = [];
  const server = createServer((_, response) => {
    times.push(performance.now());
    const busy = times.length < 3;
    response.writeHead(busy ? 503 : 200, {
      "Content-Type": "application/problem+json",
      ...(busy && { "Retry-After": "1" }),
    });
    response.end(JSON.stringify(busy ? { title: "Too many jobs wait", code: "queue-full" } : { ok: true }));
  });
  await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
  try {
    const waiting = new Client({ base: `http://127.0.0.1:${server.address().port}` });
    assert.deepEqual(await waiting.json("POST", "/v1/jobs", {}), { ok: true });
  } finally {
    server.close();
  }
  assert.ok(times[1] - times[0] > 950 && times[2] - times[1] > 950, `${times}`);
  assert.equal(seconds("Sat, 21 Nov 2026 00:00:10 GMT", Date.parse("2026-11-21T00:00:00Z")), 10);
  assert.equal(seconds("nonsense"), null);
  assert.equal(seconds("-3"), 0);
});

test("modes are those of the reference", async () => {
  const id = done.result.spectrum_id;
  const modes = new Modes(await client.modes(id));
  const reference = new Reference(await client.modes(id, { shapes: true })); // the page leaves out what surfaces say
  const top = modes.centres.reduce((best, z, i) => (i % 3 === 2 && z > modes.centres[best] ? i : best), 2);
  const voxel = (top - 2) / 3;
  const height = modes.centres[top];
  const answer = await client.interact({
    spectrum_id: id,
    num_frames: 1,
    start: "held",
    forces: [{ kind: "drag", at: { voxel }, displacement_m: [0.1 * height, 0, 0] }],
  });
  const [{ locality, bend }] = answer.groups;
  const weights = await client.reach(id, locality);
  assert.ok(Math.abs(weights[voxel] - 1) < 1e-6);
  const poses = modes.poses([{ seed: voxel, bend: bend[0] }]);
  const still = new Float64Array(reference.bone_foot_m.length);
  const expected = reference.poses(still, reference.bends(voxel, bend[0]));
  for (let b = 0; b < reference.bone_parent.length; b++) {
    const x = [0.3, -0.2, height];
    const foot = reference.bone_foot_m.subarray(3 * b, 3 * b + 3);
    const there = carried(poses, reference.joint_of_bone[b], x);
    for (let i = 0; i < 3; i++) {
      const R = expected.rotation.subarray(9 * b + 3 * i, 9 * b + 3 * i + 3);
      const wanted =
        R[0] * (x[0] - foot[0]) + R[1] * (x[1] - foot[1]) + R[2] * (x[2] - foot[2]) + expected.place[3 * b + i];
      assert.ok(Math.abs(there[i] - wanted) < 1e-4 * height, `${b} ${i}: ${there[i]} ${wanted}`);
    }
  }
});

test("a surface and the mesh before it", async () => {
  const moving = readTensors(await client.surface(done.result.spectrum_id));
  const still = readTensors(await client.assetSurface(done.asset_id));
  assert.deepEqual(moving.tensors.vertices, still.tensors.vertices);
  assert.deepEqual(moving.shape.turn_shapes, [moving.shape.turn_parent[0], 16, 3, 2]);
  assert.equal(moving.metadata.format, "tree-surface");
});

test("a push answers, and settles", async () => {
  const frames = [];
  const id = done.result.spectrum_id;
  const push = await new Promise((resolve, reject) => {
    const push = client.push(id, {
      damping_ratio: 1,
      onProblem: reject,
      onFrame: ({ frame, groups }) => {
        if (groups.length) frames.push(groups[0].bend[0]); // the last one, before rest, has none
        if (frames.length === 20) push.release();
        setTimeout(() => push.drawn(frame), 60); // slower than the service
      },
      onRest: () => resolve(push),
    });
    push.drag({ voxel: 40 }, [0.2, 0, 0]);
  });
  push.close();
  assert.ok(frames.length > 25);
  const sizes = frames.map((turn) => Math.hypot(...turn));
  assert.ok(sizes[19] > sizes[0] && sizes.at(-1) < 0.1 * sizes[19], `${sizes}`);
});
