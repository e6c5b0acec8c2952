// Errors of the service as RFC 9457 describes them, and those of the connection in the same shape.

/** Status codes after which the same request can succeed. */
const TEMPORARY = new Set([408, 429, 502, 503, 504]);

/** An error response of the service. `retryAfterS` is null where the response has no Retry-After header. */
export class Problem extends Error {
  constructor(body, { status = body.status ?? 0, retryAfterS = null } = {}) {
    super(body.detail || body.title || `HTTP ${status}`);
    this.name = "Problem";
    Object.assign(this, body, { status, retryAfterS });
    this.title = body.title ?? "The service did not answer as expected";
    this.detail = body.detail ?? "";
    this.suggestion = body.suggestion ?? "";
    this.code = body.code ?? "unknown";
  }
}

export const isTemporary = (status) => TEMPORARY.has(status);

/** Whether the service could not be reached or is overloaded, so that the request itself may be right. */
export const isAway = (error) => error?.code === "unreachable" || isTemporary(error?.status);

export async function readProblem(response) {
  const retryAfterS = seconds(response.headers.get("Retry-After"));
  const isJson = /json/.test(response.headers.get("Content-Type") ?? "");
  const body = isJson ? await response.json().catch(() => ({})) : {};
  const content = body.title ? body : { title: `HTTP ${response.status}`, code: "unknown" };
  return new Problem(content, { status: response.status, retryAfterS });
}

/** A failed connection as a Problem; an aborted request stays an AbortError. */
export function asProblem(error, signal) {
  if (error instanceof Problem || signal?.aborted) return error;
  return new Problem({
    title: "The service cannot be reached",
    detail: error.message,
    code: "unreachable",
    suggestion: "Check that it is running, then try again.",
  });
}

/** Seconds of a Retry-After header, which is a number or a date; null where it is neither. */
export function seconds(header, now = Date.now()) {
  if (!header) return null;
  const number = Number(header);
  if (Number.isFinite(number)) return Math.max(number, 0);
  const date = Date.parse(header);
  return Number.isNaN(date) ? null : Math.max((date - now) / 1000, 0);
}
