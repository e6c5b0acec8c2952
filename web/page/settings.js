// Language and units, remembered in this browser.

import { $, element } from "./dom.js";
import { store } from "./storage.js";
import { LANGUAGES, language, lengthUnit, setLengthUnit } from "./texts.js";

export function buildSettings() {
  const options = Object.entries(LANGUAGES).map(([tag, { name }]) =>
    element("option", { value: tag, lang: tag }, name),
  );
  $("language").replaceChildren(...options);
  $("language").value = language;
  $("unit").value = lengthUnit;
  $("open-settings").onclick = () => $("settings").showModal();
  $("language").onchange = () => {
    store("language", $("language").value);
    location.reload();
  };
  $("unit").onchange = () => {
    setLengthUnit($("unit").value);
    location.reload();
  };
}
