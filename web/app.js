// The page: wires states, scene, panels and addresses together. What is drawn has begun in page/begin.js.

import { Client, Problem } from "./client.js";
import { remoteSource } from "./motion/remote.js";
import { bandsOf } from "./page/all_winds.js";
import { isPhotos, relativePaths, treesAmong } from "./page/bundles.js";
import { CompanyPanel } from "./page/company.js";
import { $, ask, describe, fill, paintRanges } from "./page/dom.js";
import { SizeDoubt } from "./page/doubt.js";
import { watchDrops } from "./page/drop.js";
import { linkedJob, setAddress } from "./page/example.js";
import { Files } from "./page/files.js";
import { checkContent } from "./page/first_bytes.js";
import { Immersion } from "./page/immersion.js";
import { JobList } from "./page/jobs.js";
import { watchKeys } from "./page/keyboard.js";
import { KitDialog } from "./page/kits.js";
import { layOut, showHint } from "./page/layout.js";
import { LightPanel } from "./page/light.js";
import { Machine } from "./page/machine.js";
import { nameTag, stem } from "./page/names.js";
import { hideProblem, showNotice, showProblem, wayOut } from "./page/problem.js";
import { showDraftHeight, showProgress, tabTitle } from "./page/progress.js";
import { Recorder } from "./page/record.js";
import { watchRoom } from "./page/room.js";
import { Session } from "./page/session.js";
import { buildSettings } from "./page/settings.js";
import { ShareDialog } from "./page/share.js";
import { buildSound } from "./page/sound.js";
import { length, number, percent, text } from "./page/texts.js";
import { dress, onSystemTheme, switchTheme } from "./page/theme.js";
import { TreeForm } from "./page/tree_form.js";
import { ViewPanel } from "./page/views.js";
import { buildWelcome, exampleFile, showFormats } from "./page/welcome.js";
import { WindPanel } from "./page/wind.js";

export class App {
  /** `parts` are those that page/begin.js made: stage, hand, player, scene, live. */
  constructor(parts) {
    Object.assign(this, parts);
    const { stage, player, scene, fetch } = parts;
    const onProblem = (error) => this.onProblem(error);
    const name = () => this.treeName;
    this.client = new Client({ key: sessionStorage.getItem("key"), storage: globalThis.localStorage, fetch });
    this.limits = this.client.json("GET", "/v1/limits");
    this.machine = new Machine((...change) => this.onState(...change));
    this.shownProblem = null; // one that was closed stays closed
    scene.connect(this.client, {
      onMotion: (...motion) => this.onMotion(...motion),
      onComplete: (...motion) => this.onComplete(...motion),
      onDraft: showDraftHeight,
      onClear: () => this.onClear(),
    });
    this.session = new Session(this.client, this.machine, scene, {
      onJob: (id) => setAddress(`#job=${id}`),
      onKey: (again) => this.askKey(again),
    });
    const products = () => this.limits.then((limits) => limits.products);
    this.files = new Files(this.client, { products, onDoubts: (all) => this.doubt.say(all), onProblem });
    this.jobs = new JobList(this.client, {
      onOpen: (id) => this.open(id),
      onDeleted: (id) => id === this.session.jobId && this.session.deleted(),
      onProblem: (error) => this.onProblem(error, () => this.jobs.show()),
    });
    this.company = new CompanyPanel(stage, player);
    this.wind = new WindPanel(stage, player, { onMake: (wind) => this.session.animateIn(wind), onProblem });
    this.views = new ViewPanel(stage, player);
    this.form = new TreeForm(stage, { onApply: (wanted) => this.session.remake(wanted), tree: () => scene.tree });
    this.doubt = new SizeDoubt({
      onHeight: (height_m) => this.form.makeHigh(height_m),
      onChange: () => layOut(stage, this.machine.state),
    });
    new ShareDialog(this.client, { tree: () => ({ job: this.machine.facts.job, name: name() }), onProblem });
    const kits = new KitDialog(this.client, {
      tree: () => ({ job: this.machine.facts.job, name: name(), kind: this.machine.facts.asset?.kind }),
      onMade: (job) => this.files.made(job),
      onProblem,
    });
    new Immersion(this.client, { stage, player, kits, name, onProblem });
    new LightPanel(stage);
    new Recorder(stage, player, { name, onProblem });
    this._buildPushPanel(parts.hand);
    this._watch(parts);
    paintRanges();
    this.look();
    if (!linkedJob()) this.onState("welcome", {}, null);
    buildSound(() => player.motion);
    parts.onDraw = () => this.company.place();
    this.route();
    document.body.dataset.ready = "true";
  }

  _watch({ stage, hand, player }) {
    const { client, session } = this;
    const layAgain = () => layOut(stage, this.machine.state);
    watchRoom(layAgain);
    $("new").onclick = () => this.leave();
    $("cancel").onclick = () => this.leave({ cancel: true });
    $("problem-close").onclick = () => (this.machine.state === "failed" ? this.leave() : hideProblem());
    $("open-jobs").onclick = () => this.jobs.show();
    const onProblem = (error) => this.onProblem(error);
    $("mark-plant").onclick = async () =>
      (await import("./page/strokes.js")).cutPlant(client, session).catch(onProblem);
    $("theme").onclick = () => {
      switchTheme();
      this.look();
    };
    onSystemTheme(() => this.look());
    addEventListener("resize", layAgain);
    for (const name of ["popstate", "hashchange"]) addEventListener(name, () => this.route());
    const onFiles = (given) => this.begin(given);
    watchDrops({ onFiles, onProblem: () => showProblem(new Problem({ code: "unreadable-drop" })) });
    watchKeys({ stage, hand, player });
    buildSettings();
    const onExample = async (example) => this.start([await exampleFile(example)], text(example.name));
    buildWelcome({ onFiles, onExample });
    this.limits.then(showFormats, () => {});
  }

  /** How fast what is pushed comes to rest, and a push for those who use no pointer. */
  _buildPushPanel(hand) {
    const damping = $("damping");
    describe(damping, $("damping-out"), text("push.natural"));
    damping.oninput = () => describe(damping, $("damping-out"), percent(Number(damping.value) / 100));
    damping.onchange = () => hand.setDamping(Number(damping.value) / 100);
    $("knock").onclick = () => hand.knock();
  }

  // ---- states

  onState(state, facts, before) {
    document.body.dataset.state = state;
    document.title = tabTitle(state, facts);
    showProgress(state, facts);
    if (facts.job) this.files.follow(facts.job, facts.name).catch(() => {}); // the next state asks again
    this.doubt.set(state === "failed" ? {} : facts);
    if (state !== "welcome") {
      this.form.set(facts);
      this.live.leave();
      delete document.body.dataset.live;
    } else if (before && !linkedJob()) this.live.show().catch(() => {}); // the page works without it
    if (state === "failed" && facts.problem !== this.shownProblem)
      showProblem(facts.problem, wayOut(facts.problem, this.session));
    this.shownProblem = facts.problem;
    if (state === "moving" && facts.problem) showProblem(facts.problem, () => this.session.retry());
    layOut(this.stage, state);
    if (state === "moving" && before !== "moving") showHint();
  }

  get treeName() {
    return this.machine.facts.name || text("tree.one");
  }

  onMotion(tree, spectrum) {
    this.hand.take(tree, remoteSource(this.client, spectrum.id));
    this.player.start(tree, spectrum);
    this.wind.start(() => this.client.wind(spectrum.id)).catch((error) => this.onProblem(error));
    this.showViews();
    $("caption").replaceChildren(nameTag(this.treeName), ` · ${length(this.stage.height)}`);
  }

  /** All files are there: the service is free to compute what the slider of the wind says. */
  async onComplete(job, signal) {
    this.showViews();
    if (this.player.hasBands) return;
    const bands = await bandsOf(this.client, job, signal).catch(() => null); // the power law serves as well
    if (bands && !signal.aborted) this.wind.takeBands(bands);
  }

  showViews() {
    this.views.show();
    this.company.show();
  }

  onClear() {
    hideProblem();
    this.stage.surroundings.arrow.visible = false; // no wind blows until a tree moves
    this.hand.leave();
    this.player.stop();
    this.company.place();
    this.files.clear();
    this.form.clear();
    fill($("caption"), "");
  }

  onProblem(error, again = null) {
    if (error.status === 401) this.askKey(again ?? (() => {}));
    else showProblem(error, again);
  }

  async askKey(again) {
    const key = await ask($("key-dialog"), $("key"));
    if (!key) return;
    this.client.key = key;
    sessionStorage.setItem("key", key);
    again();
  }

  look() {
    dress(this.stage);
    this.wind.show();
    if (this.scene.tree?.moves) this.showViews();
  }

  // ---- beginnings

  /** Begin with files: the first tree is shown, the others run beside it. */
  async begin(given) {
    try {
      const [first, ...others] = treesAmong(given, await this.limits.catch(() => null));
      await this.start(first);
      if (others.length) showNotice(text("begin.others", { n: number(others.length + 1) }));
      for (const files of others.map(relativePaths)) {
        const sent = checkContent(files).then(() => this.session.uploadInBackground(files));
        sent.catch((error) => this.onProblem(error));
      }
    } catch (error) {
      showProblem(error);
    }
  }

  async start(bundle, name = bundle.length > 1 && isPhotos(bundle) ? "" : stem(bundle[0].path ?? bundle[0].name)) {
    const files = relativePaths(bundle);
    await checkContent(files);
    setAddress("#new", true);
    this.session.upload(files, { name });
  }

  open(jobId) {
    setAddress(`#job=${jobId}`, true);
    this.session.open(jobId);
  }

  // ---- addresses: #job=… opens a job, Back leads to the page before

  route() {
    const id = linkedJob();
    if (id && id !== this.session.jobId) this.session.open(id);
    else if (!id && this.machine.state !== "welcome") this.session.leave();
  }

  leave(options) {
    setAddress(location.pathname, true);
    this.session.leave(options);
  }
}
