// Which of the dropped files belong together: one bundle is one tree.

import { Problem } from "../client/problem.js";

const PHOTOS = new Set(["jpg", "jpeg", "png", "webp", "heic", "heif", "tif", "tiff"]);
/** Formats that may also be notes or cameras: alone they are a scan, beside a model they are not. */
const WEAK = new Set(["txt", "xyz", "csv", "pts", "asc"]);

export const suffixOf = (name) => (/\.([^./]+)$/.exec(name)?.[1] ?? "").toLowerCase();
export const folderOf = (path) => path.replace(/[^/]*$/, "");
const pathOf = (file) => file.path ?? file.name;

/**
 * Bundles of `File`s (with `path` where they come from a folder). `limits` is the body of /v1/limits. A file that
 * belongs to no model stays with all of them; `ignored` are hidden files.
 */
export function sortFiles(files, limits) {
  const mesh = new Set(limits.mesh_formats);
  const cloud = new Set(limits.cloud_formats);
  const used = files.filter((file) => !/(^|\/)(\.|__MACOSX|@eaDir|(eh)?thumbs\.db$|desktop\.ini$)/i.test(pathOf(file)));
  const isModel = (file) => mesh.has(suffixOf(file.name)) || cloud.has(suffixOf(file.name));
  const strong = used.filter((file) => isModel(file) && !WEAK.has(suffixOf(file.name)));
  const films = used.filter((file) => limits.film_formats.includes(suffixOf(file.name)));
  const models = strong.length || films.length ? strong : used.filter(isModel);
  const empty = used.filter((file) => file.size === 0);
  const zips = used.filter((file) => suffixOf(file.name) === "zip");
  const photos = used.filter((file) => PHOTOS.has(suffixOf(file.name)));
  if (!models.length && photos.length) return { bundles: [used], empty };
  const heads = [...models, ...zips];
  if (!heads.length && films.length) return { bundles: films.map((film) => [film]), empty };
  if (!heads.length) return { bundles: [], unknown: used, empty };
  if (isPair(heads, mesh, cloud)) return { bundles: [[...used]], empty };
  const beside = used.filter((file) => !heads.includes(file));
  return { bundles: heads.map((head) => [head, ...companions(head, heads, beside)]), empty };
}

/** Where the service does not say what it reads, one file is sent as it is. */
const NO_LIMITS = { mesh_formats: [], cloud_formats: [], film_formats: [] };

/** The bundles of files, one at least; `limits` is null where they are not known. Throws a Problem where no tree is among them. */
export function treesAmong(files, limits) {
  const { bundles, unknown, empty } = sortFiles(files, limits ?? NO_LIMITS);
  if (empty.length) throw new Problem({ code: "empty-file", name: empty[0].name });
  if (bundles.length) return bundles;
  if (!unknown.length) throw new Problem({ code: "empty-folder" });
  if (unknown.length > 1) throw new Problem({ code: "no-model", n: unknown.length });
  return [unknown];
}

/** One cloud and one mesh in the same place are one tree. */
function isPair(heads, mesh, cloud) {
  const only = (formats, others) =>
    heads.filter(({ name }) => formats.has(suffixOf(name)) && !others.has(suffixOf(name)));
  return heads.length === 2 && only(cloud, mesh).length === 1 && only(mesh, cloud).length === 1;
}

/** Files under the model's own folder that are nearer to no other model. */
function companions(head, heads, files) {
  if (heads.length === 1) return files;
  const own = folderOf(pathOf(head));
  return files.filter((file) => {
    const path = pathOf(file);
    if (!path.startsWith(own)) return false;
    return !heads.some(
      (other) => folderOf(pathOf(other)).length > own.length && path.startsWith(folderOf(pathOf(other))),
    );
  });
}

/** Paths relative to the model's folder, as the model names its companions. */
export function relativePaths(bundle) {
  const own = folderOf(pathOf(bundle[0]));
  return bundle.map((file) => {
    const path = pathOf(file);
    return {
      name: file.name,
      path: path.startsWith(own) ? path.slice(own.length) : path,
      content: file,
      size: file.size,
      lastModified: file.lastModified,
    };
  });
}

export const isPhotos = (bundle) => bundle.every(({ name }) => PHOTOS.has(suffixOf(name)));
