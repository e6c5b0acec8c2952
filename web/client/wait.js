// Waiting, and trying again while the service is away.

import { isAway } from "./problem.js";

const LONGEST_PAUSE_MS = 10_000;

/** Resolve after `ms`; reject as soon as the signal aborts. */
export function sleep(ms, signal) {
  return new Promise((resolve, reject) => {
    if (signal?.aborted) return reject(signal.reason);
    const timer = setTimeout(resolve, ms);
    const abort = () => {
      clearTimeout(timer);
      reject(signal.reason);
    };
    signal?.addEventListener("abort", abort, { once: true });
  });
}

/**
 * Run `task` until the service can be reached. `onAway(problem)` is called after each break, `onAway(null)` once the
 * service answers again. Other errors are thrown.
 */
export async function patiently(task, { signal, onAway = () => {} } = /** @type {any} */ ({})) {
  for (let attempt = 0; ; attempt++) {
    try {
      const result = await task();
      if (attempt) onAway(null);
      return result;
    } catch (error) {
      if (signal?.aborted || !isAway(error)) throw error;
      onAway(error);
      await sleep(Math.min(1000 * 2 ** attempt, LONGEST_PAUSE_MS), signal);
    }
  }
}
