// Light or dark, by the system's wish or by the button. The choice is stored in this browser.

const system = matchMedia("(prefers-color-scheme: dark)");

export const currentTheme = () => localStorage.getItem("theme") ?? (system.matches ? "dark" : "light");

export function switchTheme() {
  localStorage.setItem("theme", currentTheme() === "dark" ? "light" : "dark");
  applyTheme();
}

export function applyTheme() {
  const stored = localStorage.getItem("theme");
  if (stored) document.documentElement.dataset.theme = stored;
}

export const onSystemTheme = (listener) => system.addEventListener("change", listener);

/** The accent as the theme has it now: light-dark() is only resolved in a used colour. */
export function accent() {
  const link = document.createElement("a");
  link.href = "#";
  document.body.append(link);
  const colour = getComputedStyle(link).color;
  link.remove();
  return colour;
}
