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

/** Ask for what a job's tree moves by before the page does. A `fetch` that gives each of these answers, once. */
export function fetchMotion(job) {
  const key = sessionStorage.getItem("key");
  const asked = new Map();
  const ask = (path) => {
    const answer = fetch(path, { headers: key ? { Authorization: `Bearer ${key}` } : {} });
    asked.set(
      path,
      answer.then(async (response) => new Response(await response.arrayBuffer(), response)),
    );
    return asked.get(path);
  };
  const askAll = async () => {
    const { asset_id: asset, result } = await (await ask(`/v1/jobs/${job}`)).clone().json();
    const spectrum = `/v1/spectra/${result.spectrum_id}`;
    const parts = [`${spectrum}/modes?shapes=false`, `${spectrum}/surface`, spectrum, `/v1/assets/${asset}`];
    if (result.spectrum_id) await Promise.all(parts.map(ask));
  };
  askAll().catch(() => {}); // the page asks again
  return (path, options) => {
    const answer = asked.get(path) ?? fetch(path, options);
    asked.delete(path);
    return answer;
  };
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
