// Small things of the page: elements, themes, problems, one question.

export const $ = (id) => document.getElementById(id);
export const fill = (node, text) => {
  if (node.textContent !== text) node.textContent = text;
};
export const degrees = (value) => `${Math.round(value)}°`;

export function element(name, properties = {}, ...children) {
  const node = Object.assign(document.createElement(name), properties);
  node.append(...children);
  return node;
}

export const button = (text, onclick, properties = {}) =>
  element("button", { type: "button", textContent: text, onclick, ...properties });

/** Light or dark as it is now; `other` switches. The choice is kept in this browser. */
export function setTheme(other) {
  const root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  let theme = root.dataset.theme ?? localStorage.getItem("theme") ?? dark;
  if (other) localStorage.setItem("theme", (theme = theme === "dark" ? "light" : "dark"));
  if (other || localStorage.getItem("theme")) root.dataset.theme = theme;
  else theme = dark;
  return theme;
}

/** As the service tells it: title, detail, fields, what to do. */
export function showProblem(problem, again = null) {
  fill($("problem-title"), problem.title ?? "Something went wrong on this page");
  fill($("problem-detail"), problem.detail ?? problem.message);
  fill($("problem-suggestion"), problem.suggestion ?? "");
  const fields = (problem.errors ?? []).filter(({ detail }) => !problem.detail?.includes(detail));
  $("problem-fields").replaceChildren(
    ...fields.map(({ pointer, detail }) => element("li", {}, `${pointer}: ${detail}`)),
  );
  fill($("problem-code"), [problem.code, problem.request_id].filter(Boolean).join(" · "));
  $("problem-retry").hidden = !again;
  $("problem-retry").onclick = () => {
    hideProblem();
    again();
  };
  $("problem-close").onclick = hideProblem;
  $("problem").hidden = false;
}

export const hideProblem = () => {
  $("problem").hidden = true;
};

/** What was entered, or null. */
export function ask(dialog, input) {
  return new Promise((resolve) => {
    const done = (value) => {
      dialog.close();
      resolve(value);
    };
    dialog.querySelector("form").onsubmit = (event) => {
      event.preventDefault();
      done(event.submitter?.value === "cancel" ? null : input.value.trim());
    };
    dialog.oncancel = () => resolve(null);
    input.value = "";
    dialog.showModal();
  });
}

export function size(bytes) {
  const units = ["B", "kB", "MB", "GB"];
  let step = 0;
  for (; bytes >= 1000 && step < 3; step++) bytes /= 1000;
  return `${bytes >= 100 || step === 0 ? Math.round(bytes) : bytes.toFixed(1)} ${units[step]}`;
}
