// Following a job: server-sent events, and polling where a proxy does not let them through.

import { Problem, seconds } from "./problem.js";
import { hasEnded } from "./states.js";
import { sleep } from "./wait.js";

const FIRST_EVENT_MS = 5000; // a proxy that buffers is noticed after this
const LONGEST_WAIT_S = 60;

/**
 * Yield the job whenever it changes, until it has ended. With `again` set to false, a request that does not get through
 * throws at once.
 */
export async function* watchJob(client, id, { signal, events = true, again = true } = /** @type {any} */ ({})) {
  let job = null;
  if (events) {
    try {
      for await (job of readEvents(client, id, signal)) yield job;
    } catch (error) {
      if (signal?.aborted || (error instanceof Problem && error.status >= 400 && error.status < 500)) throw error;
    }
    if (job && hasEnded(job)) return;
  }
  for (let etag = null; ; ) {
    const headers = etag ? { "If-None-Match": etag } : {};
    const response = await client.send("GET", `/v1/jobs/${id}`, { headers, signal, again });
    if (response.status !== 304) yield (job = await response.json());
    if (hasEnded(job)) return;
    etag = response.headers.get("ETag");
    const pauseS = seconds(response.headers.get("Retry-After")) ?? 1;
    await sleep(1000 * Math.min(pauseS, LONGEST_WAIT_S), signal);
  }
}

async function* readEvents(client, id, signal) {
  signal?.throwIfAborted();
  const stream = new AbortController();
  const timer = setTimeout(() => stream.abort(new Error("no event came")), FIRST_EVENT_MS);
  try {
    const headers = { Accept: "text/event-stream" };
    const both = AbortSignal.any([stream.signal, ...(signal ? [signal] : [])]);
    const response = await client.send("GET", `/v1/jobs/${id}/events`, { headers, signal: both, again: false });
    let text = "";
    for (const reader = response.body.pipeThrough(new TextDecoderStream()).getReader(); ; ) {
      const { value, done } = await reader.read();
      if (done) return;
      const events = (text + value).split("\n\n");
      text = events.pop();
      for (const event of events) {
        const data = event.split("\n").filter((line) => line.startsWith("data:"));
        if (!data.length) continue;
        clearTimeout(timer);
        yield JSON.parse(data.map((line) => line.slice(5)).join("\n"));
      }
    }
  } finally {
    clearTimeout(timer);
    stream.abort(); // releases the connection where the reader stopped early
  }
}
