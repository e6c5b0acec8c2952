// The card of a job that is on its way, and the tab's title.

import { hasEnded } from "../client.js";
import { $, element, fill, keyedChildren } from "./dom.js";
import { shortened } from "./names.js";
import { duration, length, number, percent, text, textOrNull } from "./texts.js";

/** Show what the facts of the machine say. */
export function showProgress(state, { name, job, share = 0, away, files, asset, drawing }) {
  const visible = state === "uploading" || state === "queued" || state === "running";
  $("progress").hidden = !visible;
  if (!visible) return;
  const count = (files ?? asset?.parts)?.length;
  const title = name || (count ? text("tree.photos", { n: number(count) }) : text("tree.one"));
  $("progress-title").title = title;
  fill($("progress-title"), shortened(title));
  fill($("progress-eta"), away ? "" : etaWords(job));
  $("away").hidden = !away;
  const stages = [{ name: "upload", state: share < 1 && !job ? "running" : "succeeded", progress: share }];
  const all = [...(state === "uploading" || !job ? stages : []), ...(job?.stages ?? [])];
  const unmeasured = drawing ? "draw" : state === "uploading" && share >= 1 && !job ? "read" : null;
  if (unmeasured) all.push({ name: unmeasured, state: "running", progress: null });
  const names = all.map((stage) => stage.name);
  keyedChildren($("stages"), names, newStage);
  for (const stage of all) showStage($("stages").querySelector(`[data-key="${stage.name}"]`), stage);
}

function etaWords(job) {
  if (!job || hasEnded(job)) return "";
  if (job.state === "queued" && job.queue_position) return text("progress.before", { n: number(job.queue_position) });
  return job.eta_s ? text("progress.eta", { time: duration(job.eta_s) }) : "";
}

function newStage(name) {
  const bar = element("progress", { max: 1 });
  bar.setAttribute("aria-label", text(`stage.${name}`));
  return element("li", {}, element("span", {}, text(`stage.${name}`)), element("span", { className: "status" }), bar);
}

function showStage(item, { state, progress, cached }) {
  item.className = state;
  const bar = item.querySelector("progress");
  if (progress === null)
    bar.removeAttribute("value"); // it is not known how far it is
  else bar.value = state === "succeeded" ? 1 : progress;
  const running = state === "running";
  const words = cached ? text("stage.cached") : running ? percent(bar.value) : textOrNull(`stage.${state}`);
  fill(item.querySelector(".status"), progress === null ? "" : (words ?? state));
}

/** "45 % · Oak", "Oak is ready": what a tab in the background says. */
export function tabTitle(state, { name, job, share = 0 }) {
  const page = "DynamicTree";
  const tree = `\u2068${shortened(name || text("tree.one"))}\u2069`; // whichever way it is written
  if (state === "uploading") return `${percent(share)} · ${tree} · ${page}`;
  if (state === "queued") return `${text("title.queued")} · ${tree} · ${page}`;
  if (state === "running") return `${percent(job?.progress ?? 0)} · ${tree} · ${page}`;
  if (state === "failed") return `${text("title.failed")} · ${page}`;
  if (state === "moving") return `${job && hasEnded(job) ? "✓ " : ""}${tree} · ${page}`;
  return page;
}

/** What the dropped file says of the height; nothing for null. */
export function showDraftHeight(height) {
  const words = height === null ? "" : text("draft.height", { height: length(height), person: length(1.75) });
  fill($("height-note"), words);
}
