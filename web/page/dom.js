// Elements of the page.

/** @type {(id: string) => any} */
export const $ = (id) => document.getElementById(id);

/** Set a text only where it differs, so that selections and screen readers are left alone. */
export const fill = (node, content) => {
  if (node.textContent !== content) node.textContent = content;
};

export function element(name, properties = {}, ...children) {
  const node = Object.assign(document.createElement(name), properties);
  node.append(...children);
  return node;
}

export const button = (content, onclick, properties = {}) =>
  element("button", { type: "button", textContent: content, onclick, ...properties });

/** Hand a file to the browser's downloads. */
export function saveBlob(name, blob) {
  const address = URL.createObjectURL(blob);
  element("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

export function paintRange(input) {
  const share = (input.value - input.min) / (input.max - input.min);
  input.style.setProperty("--share", `${share * 100}%`);
}

export const paintRanges = () => document.querySelectorAll("input[type=range]").forEach(paintRange);

/** A slider's value in words, beside it and for screen readers. */
export function describe(input, readout, words) {
  if (readout) fill(readout, words);
  if (input.getAttribute("aria-valuetext") !== words) input.setAttribute("aria-valuetext", words);
  paintRange(input);
}

/** Ask one question in a dialog whose form closes it with "ok"; null where it was cancelled. */
export function ask(dialog, input) {
  input.value = dialog.returnValue = "";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.onclose = () => resolve(dialog.returnValue === "ok" ? input.value.trim() : null);
  });
}

/** Make `list` hold one child per key in this order; children that stay are left in place, with their focus. */
export function keyedChildren(list, keys, create) {
  const old = new Map([...list.children].map((node) => [node.dataset.key, node]));
  let at = list.firstElementChild;
  for (const key of keys) {
    let node = old.get(key);
    if (!node) {
      node = create(key);
      node.dataset.key = key;
    }
    old.delete(key);
    if (node === at) at = at.nextElementSibling;
    else list.insertBefore(node, at);
  }
  for (const node of old.values()) node.remove();
}
