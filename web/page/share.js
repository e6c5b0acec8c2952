// Sharing a tree: its link, and the code that shows it on another page.

import { $, fill } from "./dom.js";
import { partsOf, signedParts } from "./parts.js";
import { showNotice } from "./problem.js";
import { date, text } from "./texts.js";

const LONGEST_S = 7 * 86_400; // the service signs for no longer

export class ShareDialog {
  /** `tree()` gives `{ job, name }` of what is on the stage. */
  constructor(client, { tree, onProblem }) {
    Object.assign(this, { client, tree });
    $("share").onclick = () => this.show().catch(onProblem);
    for (const what of ["link", "embed"]) $(`copy-${what}`).onclick = () => copy($(`share-${what}`));
  }

  async show() {
    const { job, name } = this.tree();
    const { fragment, expires_at: end } = await this._fragment(job);
    $("share-link").value = `${location.origin}${location.pathname}#job=${job.id}`;
    $("share-embed").value = embedCode(location.origin, fragment, name);
    fill($("share-note"), end ? text("share.expires", { date: date(end) }) : text("share.open"));
    $("share-dialog").showModal();
  }

  /** What /embed is to show: the job, or signed addresses where the service wants a key. */
  async _fragment(job) {
    if (!this.client.key) return { fragment: `job=${job.id}`, expires_at: null };
    const { parts, expires_at } = await signedParts(this.client, await partsOf(this.client, job), LONGEST_S);
    return { fragment: new URLSearchParams(parts).toString(), expires_at };
  }
}

/** HTML that shows a tree on any page that the service allows; see embed/README.md. */
export function embedCode(origin, fragment, name) {
  const quoted = (words) => words.replace(/[&"<>]/g, (sign) => `&#${sign.codePointAt(0)};`);
  const script = `<script type="module" src="${origin}/web/embed/dynamic-tree.js"></script>`;
  return `${script}\n<dynamic-tree src="${quoted(`${origin}/embed#${fragment}`)}" aria-label="${quoted(name)}"></dynamic-tree>`;
}

async function copy(field) {
  field.select();
  try {
    await navigator.clipboard.writeText(field.value);
    showNotice(text("share.copied"));
  } catch {
    showNotice(text("share.select")); // clipboards need https or localhost, and permission
  }
}
