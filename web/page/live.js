// The tree behind the welcome: it sways and answers a pull before anything is uploaded, and no job is made for it.

import { EXAMPLE, fetchParts, standParts } from "./parts.js";

export class LiveTree {
  /** `files` are those of `prefetch`, if it was called; `onMotion({ tree, source, spectrum })` is called once it stands. */
  constructor(scene, client, { onMotion, files = null }) {
    Object.assign(this, { scene, client, onMotion, files });
    this.visit = 0;
  }

  /** Begin to load it, while the page is still being set up. */
  static prefetch(client) {
    const files = fetchParts(client, EXAMPLE);
    files.catch(() => {}); // the page works without it
    return files;
  }

  /** Put it on the empty stage; what is opened in the meantime has precedence. */
  async show() {
    const visit = ++this.visit;
    this.files ??= LiveTree.prefetch(this.client);
    const standing = await standParts(this.scene, await this.files, () => visit === this.visit);
    if (standing) this.onMotion(standing);
  }

  leave() {
    this.visit++;
  }
}
