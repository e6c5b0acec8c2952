// The page /docs: every operation of openapi.json, to read and to try. Swagger UI draws it.

const { SwaggerUIBundle } = /** @type {any} */ (globalThis);

const REGIONS = { ".information-container": "About", ".scheme-container": "Server and key" };
const LEVELS = { "h3.opblock-tag": 2, h4: 3, h5: 4 };

/** Mend what Swagger UI gives screen readers and keyboards, each time that it has drawn something. */
function mend(page) {
  for (const [name, ariaLabel] of Object.entries(REGIONS)) {
    for (const part of page.querySelectorAll(`${name}:not([role])`)) Object.assign(part, { role: "region", ariaLabel });
  }
  for (const [name, level] of Object.entries(LEVELS)) {
    for (const heading of page.querySelectorAll(`${name}:not([aria-level])`)) heading.ariaLevel = level;
  }
  for (const select of page.querySelectorAll("select:not([aria-label])")) {
    select.ariaLabel = select.closest("tr")?.dataset.paramName ?? (select.id || "media type");
  }
  for (const table of page.querySelectorAll(".responses-table[role=region]:not([aria-label])")) {
    table.ariaLabel = `Responses of ${table.id.replace("_responses", "")}`;
  }
  for (const link of page.querySelectorAll(".opblock-summary-control a[href]")) link.removeAttribute("href"); // in a button
  for (const code of page.querySelectorAll("pre.microlight:not([tabindex])")) code.tabIndex = 0; // it scrolls
}

SwaggerUIBundle({
  url: "./openapi.json",
  dom_id: "#api",
  deepLinking: true,
  docExpansion: "list",
  displayRequestDuration: true,
  defaultModelsExpandDepth: 0,
  persistAuthorization: false,
  presets: [SwaggerUIBundle.presets.apis],
  validatorUrl: null,
});

const page = document.getElementById("api");
new MutationObserver(() => mend(page)).observe(page, { childList: true, subtree: true });
