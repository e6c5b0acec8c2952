// The card that says what went wrong: in the reader's words first, in the service's below.

import { $, element, fill } from "./dom.js";
import { shortened } from "./names.js";
import { bytes, text, textOrNull } from "./texts.js";

/** Codes of what is not there any more. */
const GONE = new Set(["job-deleted", "expired", "not-found"]);
/** Codes of what the same files would meet again. */
const UNUSABLE = new Set(["unsupported-format", "invalid-geometry", "invalid-input", "payload-too-large"]);

/** `again` is called by "Try again"; without it there is no such button. */
export function showProblem(problem, again = null) {
  const { code = "page", title, detail, message, suggestion, errors = [], request_id: request } = problem;
  const values = { ...problem, name: shortened(problem.name ?? ""), kind: text(`kind.${problem.kind}`) };
  for (const field of ["size", "whole"]) if (problem[field]) values[field] = bytes(problem[field]);
  const words = textOrNull(`problem.${code}`, values);
  fill($("problem-title"), words ?? title ?? text("problem.page"));
  const said = detail || message;
  const advice = textOrNull(`problem.${code}.do`, values) ?? said ?? suggestion ?? "";
  fill($("problem-suggestion"), advice);
  const ours = Boolean(words) && !detail && !problem.status; // the service has said nothing
  const rest = ours ? [] : [words ? title : "", said, suggestion].filter((part) => part && part !== advice);
  fill($("problem-detail"), rest.join(". "));
  const fields = errors.filter((error) => !detail?.includes(error.detail));
  const items = fields.map((error) => element("li", {}, `${error.pointer}: ${error.detail}`));
  $("problem-fields").replaceChildren(...items);
  fill($("problem-code"), [code, request].filter(Boolean).join(" · "));
  $("problem-more").hidden = !rest.length && !fields.length;
  $("problem-more").open = Boolean(fields.length);
  $("problem-retry").hidden = !again;
  const retry = problem.offersMotion ? "animate" : UNUSABLE.has(code) ? "other" : "retry";
  fill($("problem-retry"), text(`problem.${retry}`));
  $("problem-retry").onclick = () => {
    hideProblem();
    again();
  };
  $("problem").hidden = false;
}

export const hideProblem = () => {
  $("problem").hidden = true;
};

let timer = null; // of the notice

/** A line that goes away by itself. */
export function showNotice(words) {
  const notice = $("notice");
  notice.hidden = false;
  fill(notice, words);
  clearTimeout(timer);
  timer = setTimeout(() => {
    notice.hidden = true;
  }, 6000);
}

/** What a button can do about a problem of a tree: nothing, other files, or the same again. */
export function wayOut({ code }, session) {
  if (GONE.has(code)) return null;
  return UNUSABLE.has(code) ? () => $("files").click() : () => session.retry();
}
