// The page: wires states, scene, panels and addresses together. What is drawn has begun in page/begin.js.

import { Client, Problem } from "./client.js";
import { remoteSource } from "./motion/remote.js";
import { frames, hand, live, player, scene, stage } from "./page/begin.js";
import { relativePaths, treesAmong } from "./page/bundles.js";
import { CompanyPanel, makeOther } from "./page/company.js";
import { $, ask, fill, paintRanges } from "./page/dom.js";
import { watchDrops } from "./page/drop.js";
import { linkedJob } from "./page/example.js";
import { Files } from "./page/files.js";
import { JobList } from "./page/jobs.js";
import { watchKeys } from "./page/keyboard.js";
import { layOut, showHint } from "./page/layout.js";
import { LightPanel } from "./page/light.js";
import { Machine } from "./page/machine.js";
import { hideProblem, showNotice, showProblem } from "./page/problem.js";
import { showProgress, tabTitle } from "./page/progress.js";
import { buildPushPanel } from "./page/push_panel.js";
import { Recorder } from "./page/record.js";
import { watchRoom } from "./page/room.js";
import { Session, stem } from "./page/session.js";
import { buildSettings } from "./page/settings.js";
import { ShareDialog } from "./page/share.js";
import { length, number, text } from "./page/texts.js";
import { currentTheme, onSystemTheme, switchTheme } from "./page/theme.js";
import { TreeForm } from "./page/tree_form.js";
import { ViewPanel } from "./page/views.js";
import { buildWelcome, exampleFile, showFormats } from "./page/welcome.js";
import { WindPanel } from "./page/wind.js";

const client = new Client({ key: sessionStorage.getItem("key"), storage: globalThis.localStorage });
const limits = client.json("GET", "/v1/limits");
const machine = new Machine(onState);
scene.connect(client, { onMotion, onComplete: showViews, onDraft, onClear });
const session = new Session(client, machine, scene, { onJob: (id) => setAddress(`#job=${id}`), onKey: askKey });
const files = new Files(client, { onProblem: (error) => onProblem(error) });
const jobs = new JobList(client, {
  onOpen: (id) => open(id),
  onDeleted: (id) => id === session.jobId && session.deleted(),
  onProblem: (error) => onProblem(error, () => jobs.show()),
});
const company = new CompanyPanel(stage, player, {
  otherMotion: (run) => makeOther(client, scene, machine.facts.job, run),
  onProblem,
});
const wind = new WindPanel(stage, player, { onMake: makeForWind, onEndless: () => company.takeWind(), onProblem });
const views = new ViewPanel(stage, player);
const form = new TreeForm(stage, { onApply: remake, tree: () => scene.tree });

// ---- states

let shownProblem = null; // one that was closed stays closed

function onState(state, facts, before) {
  document.body.dataset.state = state;
  document.title = tabTitle(state, facts);
  showProgress(state, facts);
  if (facts.job) files.follow(facts.job, facts.name);
  if (state !== "welcome") form.set(facts);
  if (state !== "welcome") leaveLive();
  else if (before && !linkedJob()) live.show().catch(() => {}); // the page works without it
  if (state === "failed" && facts.problem !== shownProblem)
    showProblem(facts.problem, isGone(facts.problem) ? null : () => session.retry());
  shownProblem = facts.problem;
  if (state === "moving" && facts.problem) showProblem(facts.problem, () => session.retry());
  if (state !== before || state === "queued") layOut(stage, state);
  if (state === "moving" && before !== "moving") showHint();
}

const isGone = ({ code }) => code === "job-deleted" || code === "expired";

function leaveLive() {
  live.leave();
  delete document.body.dataset.live;
}

const treeName = () => machine.facts.name || text("tree.one");

function onMotion(tree, spectrum, job) {
  hand.take(tree, remoteSource(client, spectrum.id, tree.modes.V));
  player.start(tree, spectrum);
  wind.start(() => client.wind(spectrum.id)).catch((error) => onProblem(error));
  showViews();
  const { name } = machine.facts;
  const voxels = text("caption.voxels", { n: number(spectrum.num_voxels) });
  fill($("caption"), [name || text("tree.one"), length(stage.height), voxels].join(" · "));
  files.follow(job, name);
}

function showViews() {
  views.show();
  company.show();
}

function onDraft(height) {
  const words = height === null ? "" : text("draft.height", { height: length(height), person: length(1.75) });
  fill($("height-note"), words);
}

function onClear() {
  hideProblem();
  hand.leave();
  player.stop();
  company.clear();
  files.clear();
  form.clear();
  fill($("caption"), "");
}

function onProblem(error, again = null) {
  if (error.status === 401) askKey(again ?? (() => {}));
  else showProblem(error, again);
}

async function askKey(again) {
  const key = await ask($("key-dialog"), $("key"));
  if (!key) return;
  client.key = key;
  sessionStorage.setItem("key", key);
  again();
}

// ---- beginnings

/** Begin with files: the first tree is shown, the others run beside it. */
async function begin(given) {
  try {
    const [first, ...others] = treesAmong(given, await limits.catch(() => null));
    start(first);
    if (others.length) showNotice(text("begin.others", { n: number(others.length + 1) }));
    for (const bundle of others) session.uploadInBackground(relativePaths(bundle)).catch((error) => onProblem(error));
  } catch (error) {
    showProblem(error);
  }
}

function start(bundle, name = bundle.length > 1 && isPhotos(bundle) ? "" : stem(bundle[0].path ?? bundle[0].name)) {
  setAddress("#new", true);
  session.upload(relativePaths(bundle), { name });
}

const isPhotos = (bundle) => bundle.every(({ name }) => /\.(jpe?g|png|webp|heic)$/i.test(name));

function open(jobId) {
  setAddress(`#job=${jobId}`, true);
  session.open(jobId);
}

function makeForWind(value, bands = false) {
  const { job } = machine.facts;
  const params = { ...job.params, wind: { ...job.params.wind, ...value } };
  if (bands) params.wind_bands = true;
  session.animate({ seed: job.seed, preset: job.preset, params });
}

function remake({ reading, request, newUpload }) {
  const { files: given, name, reading: before, job } = machine.facts;
  if (job) client.cancel(job.id).catch(() => {}); // it may have ended
  if (newUpload) session.upload(given, { name, reading: { ...before, ...reading }, request });
  else session.animate(request);
}

// ---- addresses: #job=… opens a job, Back leads to the page before

function setAddress(hash, push = false) {
  if (location.hash === hash) return;
  if (push) history.pushState(null, "", hash);
  else history.replaceState(null, "", hash);
}

function route() {
  const id = linkedJob();
  if (id && id !== session.jobId) session.open(id);
  else if (!id && machine.state !== "welcome") session.leave();
}

function leave(options) {
  setAddress(location.pathname, true);
  session.leave(options);
}

// ---- wiring

function look() {
  stage.look(currentTheme());
  wind.show();
  if (scene.tree?.moves) showViews();
}

new ShareDialog(client, { tree: () => ({ job: machine.facts.job, name: treeName() }), onProblem });
new LightPanel(stage);
new Recorder(stage, player, { name: treeName, onProblem });
watchRoom(() => layOut(stage, machine.state));
$("new").onclick = () => leave();
$("cancel").onclick = () => leave({ cancel: true });
$("problem-close").onclick = () => (machine.state === "failed" ? leave() : hideProblem());
$("open-jobs").onclick = () => jobs.show();
$("mark-plant").onclick = async () => (await import("./page/strokes.js")).cutPlant(client, session).catch(onProblem);
$("theme").onclick = () => {
  switchTheme();
  look();
};
onSystemTheme(look);
addEventListener("resize", () => layOut(stage, machine.state));
addEventListener("popstate", route);
addEventListener("hashchange", route);
watchDrops({ onFiles: begin, onProblem: () => showProblem(new Problem({ code: "unreadable-drop" })) });
watchKeys({ stage, hand, player });
buildSettings();
buildWelcome({
  onFiles: begin,
  onExample: async (example) => start([await exampleFile(example)], text(example.name)),
});
limits.then(showFormats, () => {});
buildPushPanel(hand);
paintRanges();
look();
onState("welcome", {}, null);
frames.onDraw = () => company.place();
route();
document.body.dataset.ready = "true";
