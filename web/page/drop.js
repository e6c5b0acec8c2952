// Files and folders that are dropped on the page.

import { $ } from "./dom.js";

/** `onFiles(files)`: `File`s with `path` where they lie in a folder. `onProblem(error)` where a folder cannot be read. */
export function watchDrops({ onFiles, onProblem }) {
  let depth = 0;
  const showVeil = (visible) => Object.assign($("veil"), { hidden: !visible });
  addEventListener("dragenter", (event) => {
    event.preventDefault();
    if (event.dataTransfer?.types.includes("Files")) showVeil(++depth > 0);
  });
  addEventListener("dragleave", () => {
    depth = Math.max(depth - 1, 0);
    showVeil(depth > 0);
  });
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    depth = 0;
    showVeil(false);
    readDrop(event.dataTransfer).then(onFiles, onProblem);
  });
}

/** All files of a drop, folders included. Entries are taken at once: they are gone after the event. */
export async function readDrop(transfer) {
  const entries = [...(transfer.items ?? [])].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.some((entry) => entry.isDirectory)) return [...transfer.files];
  return (await Promise.all(entries.map((entry) => readEntry(entry, "")))).flat();
}

async function readEntry(entry, folder) {
  const path = folder + entry.name;
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
    return [Object.assign(file, { path })];
  }
  const files = [];
  const reader = entry.createReader();
  for (;;) {
    const batch = await new Promise((resolve, reject) => reader.readEntries(resolve, reject)); // 100 at most
    if (!batch.length) return files;
    for (const child of batch) files.push(...(await readEntry(child, `${path}/`)));
  }
}

/** Files of an `<input webkitdirectory>` or a plain one, with their paths. */
export const chosenFiles = (input) =>
  [...input.files].map((file) =>
    file.webkitRelativePath ? Object.assign(file, { path: file.webkitRelativePath }) : file,
  );
