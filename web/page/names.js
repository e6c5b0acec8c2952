// Names of trees: what an upload is called, how its name is shown, and how its files are called.

import { element } from "./dom.js";
import { store, stored } from "./storage.js";

const SHOWN = 48; // characters of a name; what is longer is cut in its middle
const OF_A_FILE = 50; // UTF-8 takes up to four bytes for each, and file systems take 255 bytes with what follows

/** What an upload is called: its file's name without folder and suffix; empty for photos, of which a film is one file. */
export function nameOf({ id, kind, parts }) {
  return stored(`name ${id}`) ?? (kind === "photos" && parts.length > 1 ? "" : stem(parts[0].name));
}

/** Remember a name that an upload does not tell the service: that of a folder with a `scene.gltf` in it. */
export function keepName(asset, name) {
  if (name !== nameOf(asset)) store(`name ${asset.id}`, name);
}

export function stem(path) {
  const parts = path.split("/");
  const base = parts.pop().replace(/\.[^.]+$/, "");
  return base === "scene" && parts.length ? parts.pop() : base; // Sketchfab calls every file so
}

/** A name whose middle is left out where it is long; signs of several characters stay whole. */
export function shortened(name, most = SHOWN) {
  const signs = [...new Intl.Segmenter().segment(name)].map(({ segment }) => segment);
  if (signs.length <= most) return name;
  const half = Math.floor((most - 1) / 2);
  return `${signs.slice(0, half).join("")}…${signs.slice(-half).join("")}`;
}

/** A name as it stands among other words, whichever way it is written. */
export function nameTag(name, properties = {}) {
  return element("bdi", { dir: "auto", title: name, ...properties }, shortened(name));
}

/** A name that any file system takes: "oak.glb" for ("oak", ".glb"). */
export function fileName(name, suffix) {
  // biome-ignore lint/suspicious/noControlCharactersInRegex: file systems refuse them
  const allowed = name.replace(/[\\/:*?"<>|\u0000-\u001f\u007f]/g, "").replace(/^[. ]+|[. ]+$/g, "");
  return (shortened(allowed, OF_A_FILE) || "tree") + suffix;
}
