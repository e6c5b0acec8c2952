// Buttons for a headset or a phone's camera: WebXR where the browser has it, else the phone's own viewer of files.

import { canShow, immerse } from "../draw/immersive.js";
import { $, element, fill } from "./dom.js";
import { percent } from "./texts.js";

const VIEWER = "intent://arvr.google.com/scene-viewer/1.0";
const PACKAGE = "com.google.android.googlequicksearchbox";
const HOUR_S = 3600;

export class Immersion {
  /** `kits` makes files where they are missing; `name()` is that of the tree. */
  constructor(client, { stage, player, kits, name, onProblem }) {
    Object.assign(this, { client, kits, name });
    for (const kind of ["vr", "ar"]) {
      const show = () => immerse(stage, kind, { onSelect: () => player.blow() }).catch(onProblem);
      canShow(kind).then((can) => {
        if (can) Object.assign($(`show-${kind}`), { hidden: false, onclick: show });
        else if (kind === "ar" && phoneFormat()) this._offerFile(phoneFormat(), onProblem);
      });
    }
  }

  _offerFile(format, onProblem) {
    Object.assign($("show-ar"), { hidden: false, onclick: () => this._openFile(format).catch(onProblem) });
  }

  /** Give a phone's own viewer the tree: it must be able to read the address without a key. */
  async _openFile(format) {
    const words = $("show-ar").textContent;
    const [{ url }] = await this.kits.artifacts([format], ({ progress }) => fill($("show-ar"), percent(progress)));
    fill($("show-ar"), words);
    const open = this.client.key ? (await this.client.link(url, HOUR_S)).url : url;
    element(
      "a",
      { href: addressFor(format, new URL(open, location.href), this.name()), rel: "ar" },
      element("img", { alt: "" }),
    ).click();
  }
}

/** What the phone's own viewer plays: Quick Look, Android's Scene Viewer; null elsewhere. */
export function phoneFormat({ relList } = document.createElement("a"), { userAgent } = navigator) {
  if (relList.supports("ar")) return "usd-skinned";
  return /android/i.test(userAgent) ? "glb" : null;
}

/** What opens a file in the phone's viewer. */
export function addressFor(format, file, name) {
  if (format === "usd-skinned") return file.href;
  const query = new URLSearchParams({ file: file.href, mode: "ar_preferred", title: name });
  return `${VIEWER}?${query}#Intent;scheme=${file.protocol.slice(0, -1)};package=${PACKAGE};action=android.intent.action.VIEW;end;`;
}
