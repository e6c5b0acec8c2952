// Doubts, said beside the tree: about its size, with one click where the unit tells, and about what photos show of it.

import { $, button, element, fill } from "./dom.js";
import { length, text } from "./texts.js";

/** Metres in what a file may count in. */
const UNITS_M = { m: 1, cm: 0.01, mm: 0.001, in: 0.0254, ft: 0.3048 };
const USUAL_M = [0.1, 120]; // of plants
const TIMES = [10, 100, 1000]; // what was made too small was converted once too often

/** Heights of a tree of `height_m` that was read with `scale` metres a unit, were it of other units: `{ unit, height_m }`. */
export function proposals(height_m, scale) {
  const others = Object.entries(UNITS_M).filter(([, metres]) => Math.abs(metres / scale - 1) > 1e-6);
  const read = ([unit, metres]) => ({ unit, height_m: (height_m / scale) * metres });
  return [...others.map(read), ...TIMES.map((times) => read([`× ${times}`, times * scale]))]
    .filter(({ height_m: high }) => high >= USUAL_M[0] && high <= USUAL_M[1] && Math.abs(high / height_m - 1) > 1e-6)
    .filter(({ unit }, _, all) => unit in UNITS_M || all.every((one) => !(one.unit in UNITS_M)));
}

/** What the service warns of in `report`, the artifact of a tree from photos. */
export async function warningsOf(client, report) {
  return JSON.parse(new TextDecoder().decode(await client.bytes(report.url))).warnings ?? [];
}

export class SizeDoubt {
  /** `onHeight(height_m)` makes the tree again with another height; `onChange()` once the card comes or goes. */
  constructor({ onHeight, onChange }) {
    Object.assign(this, { onHeight, onChange, asset: null, dismissed: null });
  }

  /** Show it where the service doubts the size of `asset`, or lacks textures; without `files` the size can only be said. */
  set({ asset, files }) {
    if (asset === this.asset) return;
    this.asset = asset;
    $("doubt").hidden = true;
    const codes = asset?.summary.warnings?.map(({ code }) => code) ?? [];
    if (files && codes.includes("texture-missing")) this.say([text("doubt.textures")]);
    if (!codes.includes("size-doubtful") || this.dismissed === asset.id) return;
    const { height_m, extent_m, source_scale: scale = 1 } = asset.summary;
    const high = height_m ?? extent_m[2];
    const keep = button(text("doubt.keep", { height: length(high) }), () => {
      this.dismissed = asset.id;
      this._close();
    });
    const chips = (files ? proposals(high, scale) : []).map(({ unit, height_m: other }) =>
      button(`${unit}: ${length(other)}`, () => this.onHeight(other)),
    );
    this._show(text(files ? "doubt.words" : "doubt.reread", { height: length(high) }), [...chips, keep]);
  }

  /** Sentences until they are read. */
  say(sentences) {
    this._show(sentences.join("\n"), [button(text("doubt.read"), () => this._close())]);
  }

  _show(words, chips) {
    fill($("doubt-words"), words);
    $("doubt-chips").replaceChildren(...chips.map((chip) => element("li", {}, chip)));
    $("doubt").hidden = false;
    this.onChange();
  }

  _close() {
    $("doubt").hidden = true;
    this.onChange();
  }
}
