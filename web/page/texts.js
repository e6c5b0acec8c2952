// Every text of the page in the reader's language, and numbers as they are written there.

import de from "../texts/de.js";
import en from "../texts/en.js";
import { store, stored } from "./storage.js";

export const LANGUAGES = { en: { name: "English", texts: en }, de: { name: "Deutsch", texts: de } };
const FEET = 3.28084; // a metre
const MILES_PER_HOUR = 2.23694; // a metre per second

const languages = globalThis.navigator?.languages ?? ["en"]; // node has none
const preferred = stored("language") ?? languages.find((tag) => tag.slice(0, 2) in LANGUAGES);
export const language = (preferred ?? "en").slice(0, 2) in LANGUAGES ? (preferred ?? "en").slice(0, 2) : "en";
const locale = languages.find((tag) => tag.startsWith(language)) ?? language;

/** "m" or "ft". */
export let lengthUnit = stored("unit") ?? "m";

export function setLengthUnit(unit) {
  lengthUnit = unit;
  store("unit", unit);
}

/** The text of a key; `{name}` stands for a value. */
export function text(key, values = {}) {
  const found = LANGUAGES[language].texts[key] ?? en[key];
  if (found === undefined) return key;
  return found.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

/** The text of a key, or null where there is none. */
export const textOrNull = (key, values) => (key in en ? text(key, values) : null);

/** Put texts into the elements that name them: `data-text` for content, `data-label` for the accessible name. */
export function translate(root = /** @type {any} */ (document)) {
  document.documentElement.lang = language;
  for (const node of root.querySelectorAll("[data-text]")) node.textContent = text(node.dataset.text);
  for (const node of root.querySelectorAll("[data-label]")) node.setAttribute("aria-label", text(node.dataset.label));
}

export const number = (value, digits = 0) =>
  value.toLocaleString(locale, { minimumFractionDigits: digits, maximumFractionDigits: digits });

export const percent = (share) => `${number(100 * share)} %`;
export const degrees = (value) => `${number(value)}°`;

/** A direction in degrees, and the point of the compass next to it; +Y is north, as in maps. */
export const bearing = (value) => `${degrees(value)} ${text("wind.points").split(" ")[Math.round(value / 45) % 8]}`;

export const date = (iso) => new Date(iso).toLocaleString(locale, { dateStyle: "medium", timeStyle: "short" });

/** A length in the chosen unit; small ones in centimetres or inches. */
export function length(metres) {
  if (lengthUnit === "ft")
    return metres < 0.3 ? `${number(metres * FEET * 12, 1)} in` : `${number(metres * FEET, 1)} ft`;
  if (metres < 0.01) return `${number(metres * 1000, 1)} mm`;
  return metres < 1 ? `${number(metres * 100, 1)} cm` : `${number(metres, 1)} m`;
}

export const toUnit = (metres) => (lengthUnit === "ft" ? metres * FEET : metres);
export const fromUnit = (value) => (lengthUnit === "ft" ? value / FEET : value);

export const speed = (m_s) =>
  lengthUnit === "ft" ? `${number(m_s * MILES_PER_HOUR, 1)} mph` : `${number(m_s, 1)} m/s`;

export function bytes(count) {
  const units = ["B", "kB", "MB", "GB"];
  let value = count;
  let step = 0;
  for (; value >= 1000 && step < 3; step++) value /= 1000;
  return `${number(value, value >= 100 || step === 0 ? 0 : 1)} ${units[step]}`;
}

/** "about 20 s", "about 3 min". */
export function duration(seconds) {
  if (seconds < 90) return text("time.seconds", { n: number(Math.max(1, Math.ceil(seconds))) });
  return text("time.minutes", { n: number(Math.ceil(seconds / 60)) });
}
