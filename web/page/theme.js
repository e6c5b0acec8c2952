// Light or dark, by the system's wish or by the button. The choice is stored in this browser.

import { $ } from "./dom.js";
import { store, stored } from "./storage.js";

const system = matchMedia("(prefers-color-scheme: dark)");

export const currentTheme = () => stored("theme") ?? (system.matches ? "dark" : "light");

export function switchTheme() {
  store("theme", currentTheme() === "dark" ? "light" : "dark");
  applyTheme();
}

export function applyTheme() {
  const theme = stored("theme");
  if (theme) document.documentElement.dataset.theme = theme;
}

export const onSystemTheme = (listener) => system.addEventListener("change", listener);

/** Show a stage in the theme's colours, before the sky where no other background is chosen. */
export function dress(stage) {
  const { color, backgroundColor } = getComputedStyle($("sky"));
  const { background = "sky" } = document.body.dataset;
  stage.look(currentTheme(), background === "sky" ? [color, backgroundColor] : null);
  document.body.classList.toggle("bare", stage.surroundings.backdrop.visible);
  document.body.classList.toggle("soft", stage.soft);
}

/** The accent as the theme has it now: light-dark() is only resolved in a used colour. */
export function accent() {
  const link = document.createElement("a");
  link.href = "#";
  document.body.append(link);
  const colour = getComputedStyle(link).color;
  link.remove();
  return colour;
}
