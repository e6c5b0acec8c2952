// Where a tree is drawn from, and how it is put on a stage of its own: by addresses alone, without a job or a key.

import { readSurface } from "../draw/surface.js";
import { localSource } from "../motion/local.js";
import { Modes } from "../motion/modes.js";
import { contentsOf } from "./example.js";

const SMALL = "shapes=false"; // the bones of the surface say how voxels move
const NAMES = ["surface", "modes", "splat"];
const READABLE = /^\/v1\/(spectra|artifacts)\/[0-9A-Z]{26}(\/surface|\/modes)?(\?[\w=&-]*)?$/;

/** Paths of a job's surface, modes and, of a cloud, Gaussians. */
export async function partsOf(client, job) {
  const spectrum = `/v1/spectra/${job.result.spectrum_id}`;
  const artifacts = await client.artifacts(job.id);
  const splat = artifacts.find(({ name }) => name === "tree.animated-splat.safetensors");
  const motion = { surface: `${spectrum}/surface`, modes: `${spectrum}/modes?${SMALL}` };
  return { ...motion, ...(splat && { splat: splat.url }) };
}

/** The same paths, each with a signature that opens it without a key, where the service wants one. */
export async function signedParts(client, parts, expires_s) {
  const sign = async ([name, path]) => {
    const [file, query] = path.split("?"); // a signature is the path's
    const { url, expires_at } = await client.link(file, expires_s);
    const whole = query ? `${url}${url.includes("?") ? "&" : "?"}${query}` : url;
    return { name, url: whole, expires_at };
  };
  const links = await Promise.all(Object.entries(parts).map(sign));
  const ends = links.map(({ expires_at }) => expires_at).filter(Boolean);
  return { parts: Object.fromEntries(links.map(({ name, url }) => [name, url])), expires_at: ends[0] ?? null };
}

/** The parts that a fragment names; null where it names none, or other addresses than those of trees. */
export function partsIn(fragment) {
  const given = NAMES.map((name) => [name, fragment.get(name)]).filter(([, path]) => path);
  const parts = Object.fromEntries(given);
  const whole = parts.surface && parts.modes;
  return whole && given.every(([, path]) => READABLE.test(path)) ? parts : null;
}

/** The contents of parts. */
export const fetchParts = (client, parts) => contentsOf(parts, (path) => client.bytes(path));

/** The contents of a folder on any web server: see page/web_folder.js. */
export const fetchFolder = (folder, names) =>
  contentsOf(Object.fromEntries(names.map((name) => [name, `${folder}${name}.safetensors`])));

/** Stand a tree on the scene from its parts' contents: `{ tree, source, spectrum }`; null if it is not wanted any more. */
export async function standParts(scene, { surface, modes, splat }, isWanted = () => true) {
  const read = await readSurface(surface);
  if (!isWanted()) return null;
  const motion = new Modes(modes);
  const tree = scene.stand(read, motion);
  if (splat) {
    const { isUncoloured, readSplat } = await import("../draw/splat.js");
    const gaussians = readSplat(splat);
    if (!isUncoloured(gaussians)) await tree.setSplat(gaussians);
  }
  return { tree, source: localSource(tree), spectrum: { period_s: 1 / motion.frequencies_hz[1] } };
}
