// The model's answer to all winds, asked for behind a tree that moves: how much stronger each mode is in which wind.

import { hasEnded } from "../client.js";

/** Parameters of a job that its spectrum depends on. */
const OF_THE_SPECTRUM = [
  ["box_m", "still", "moving", "still_box_m", "moving_box_m", "tree", "splat_steps", "video_frames", "height_m"],
  ["marker_m", "scribbles", "only_plant", "wind", "num_steps", "period_s"],
].flat();

/**
 * The `wind_bands` of a job's motion. The job that computes them is the same for everyone who asks, comes after all others,
 * and is canceled with `signal`.
 */
export async function bandsOf(client, { asset_id, preset, seed, params, result }, signal) {
  const given = OF_THE_SPECTRUM.filter((name) => name in params).map((name) => [name, params[name]]);
  const request = { type: "diffuse", asset_id, preset, seed, priority: "low" };
  request.params = { ...Object.fromEntries(given), wind_bands: true };
  let job = /** @type {any} */ (null);
  signal.addEventListener("abort", () => !job || hasEnded(job) || client.cancel(job.id).catch(() => {}));
  const ended = async (asked) => {
    for await (job of client.watch((job = await asked).id, { signal }));
  };
  await ended(client.createJob(request, { key: `winds-${result.spectrum_id}`, signal }));
  if (job.state === "canceled") await ended(client.retry(job.id)); // who asked before has left
  return (await client.spectrum(job.result.spectrum_id)).wind_bands;
}

/** Whether a job of the list is one of these, for which nobody asked. */
export const isBehind = ({ type, priority }) => type === "diffuse" && priority === "low";
