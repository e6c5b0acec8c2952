// The tree behind the welcome: it sways and answers a pull before anything is uploaded, and no job is made for it.

import { fetchExample } from "./example.js";
import { standParts } from "./parts.js";

export class LiveTree {
  /** `files` are those of the tree, or null; `onMotion({ tree, source, spectrum })` is called once it stands. */
  constructor(scene, files, { onMotion }) {
    Object.assign(this, { scene, files, onMotion });
    this.visit = 0;
  }

  /** Put it on the empty stage; what is opened in the meantime has precedence. */
  async show() {
    const visit = ++this.visit;
    this.files ??= fetchExample();
    const standing = await standParts(this.scene, await this.files, () => visit === this.visit);
    if (standing) this.onMotion(standing);
  }

  leave() {
    this.visit++;
  }
}
