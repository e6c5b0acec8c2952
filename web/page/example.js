// The tree behind the welcome: two files of the page, which need no service.

const example = (name) => `/web/examples/round-broadleaf.${name}.safetensors`;
const EXAMPLE = { surface: example("surface"), modes: example("modes") };

/** The job that the page's address names; null for none. */
export const linkedJob = () => new URLSearchParams(location.hash.slice(1)).get("job");

/** Surface and modes, as `standParts` takes them. */
export const fetchExample = () => contentsOf(EXAMPLE);

/** The same names, each with what `read` gets at its path. */
export async function contentsOf(paths, read = bytesOf) {
  const files = Object.entries(paths).map(async ([name, path]) => [name, await read(path)]);
  return Object.fromEntries(await Promise.all(files));
}

/** Ask for the motion of a job before the page does: by then the browser has it. */
export async function fetchMotion(job) {
  const key = sessionStorage.getItem("key");
  const ask = (path) => fetch(path, { headers: key ? { Authorization: `Bearer ${key}` } : {} });
  const { spectrum_id: id } = (await (await ask(`/v1/jobs/${job}`)).json()).result;
  const asked = (id ? ["modes?shapes=false", "surface"] : []).map((part) => ask(`/v1/spectra/${id}/${part}`));
  for (const response of asked) await (await response).arrayBuffer();
}

export async function bytesOf(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(`${path}: ${response.status}`);
  return response.arrayBuffer();
}

/** Name a job in the address, or none; `push` makes it a step for Back. */
export function setAddress(hash, push = false) {
  if (location.hash === hash) return;
  if (push) history.pushState(null, "", hash);
  else history.replaceState(null, "", hash);
}
