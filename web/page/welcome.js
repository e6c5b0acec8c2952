// The page's beginning: choose files, or take an example.

import { $, button, element, fill } from "./dom.js";
import { chosenFiles } from "./drop.js";
import { length, text } from "./texts.js";

export const EXAMPLES = [
  { file: "round-broadleaf", name: "example.broadleaf", height_m: 10.3 },
  { file: "weeping", name: "example.weeping", height_m: 9.7 },
  { file: "conical-conifer", name: "example.conifer", height_m: 8.0 },
];

/** `onFiles(files)` with what was chosen, `onExample(example)`. */
export function buildWelcome({ onFiles, onExample }) {
  const inputs = { choose: "files", "choose-folder": "folder", "take-photos": "camera" };
  for (const [opener, input] of Object.entries(inputs)) {
    $(opener).onclick = () => $(input).click();
    $(input).onchange = () => {
      onFiles(chosenFiles($(input)));
      $(input).value = "";
    };
  }
  $("examples").replaceChildren(...EXAMPLES.map((example) => exampleItem(example, onExample)));
}

function exampleItem(example, onExample) {
  const source = `./web/examples/${example.file}.webp`;
  const picture = element("img", { src: source, alt: "", width: 128, height: 128, loading: "lazy" });
  const start = button("", () => onExample(example));
  start.append(picture, element("span", {}, text(example.name)), element("small", {}, length(example.height_m)));
  return element("li", {}, start);
}

export async function exampleFile({ file }) {
  const response = await fetch(`./web/examples/${file}.glb`);
  return new File([await response.blob()], `${file}.glb`);
}

/** Say which formats can be dropped. */
export function showFormats(limits) {
  const list = (names) => names.map((name) => name.toUpperCase()).join(", ");
  const mesh = text("formats.mesh", { list: list(limits.mesh_formats) });
  const cloud = text("formats.cloud", { list: list(limits.cloud_formats) });
  const photos = text("formats.photos", {
    min: limits.min_photos,
    max: limits.max_photos,
    list: list(limits.film_formats),
  });
  fill($("formats"), [mesh, cloud, photos].join("; "));
}
