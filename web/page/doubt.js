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

  /** Show it where the service doubts the size of `asset`; without `files` it can only be said. */
  set({ asset, files }) {
    if (asset === this.asset) return;
    this.asset = asset;
    const doubted = asset?.summary.warnings?.some(({ code }) => code === "size-doubtful");
    $("doubt").hidden = !doubted || this.dismissed === asset.id;
    if ($("doubt").hidden) return this.onChange();
    const { height_m, extent_m, source_scale: scale = 1 } = asset.summary;
    const high = height_m ?? extent_m[2];
    fill($("doubt-words"), text(files ? "doubt.words" : "doubt.reread", { height: length(high) }));
    const keep = button(text("doubt.keep", { height: length(high) }), () => {
      this.dismissed = asset.id;
      this._close();
    });
    const chips = (files ? proposals(high, scale) : []).map(({ unit, height_m: other }) =>
      button(`${unit}: ${length(other)}`, () => this.onHeight(other)),
    );
    $("doubt-chips").replaceChildren(...[...chips, keep].map((chip) => element("li", {}, chip)));
    this.onChange();
  }

  /** Sentences of the service on a tree from photos, until they are read. */
  say(sentences) {
    fill($("doubt-words"), sentences.join("\n"));
    $("doubt-chips").replaceChildren(
      element(
        "li",
        {},
        button(text("doubt.read"), () => this._close()),
      ),
    );
    $("doubt").hidden = false;
    this.onChange();
  }

  _close() {
    $("doubt").hidden = true;
    this.onChange();
  }
}
