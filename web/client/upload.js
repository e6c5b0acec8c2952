// Uploads: one multipart request for small files, tus in pieces for large ones.

import { isTemporary } from "./problem.js";
import { sleep } from "./wait.js";

/** Bytes of one PATCH; files that are larger together are sent in pieces. */
export const PIECE = 8 * 1024 * 1024;
const RETRIES = 4;
const TUS = { "Tus-Resumable": "1.0.0" };

/**
 * Create an asset of files: `File`s, or `{ name, content: Blob }`. A name may be a relative path with forward slashes,
 * by which a glTF or OBJ file names its companions.
 */
export async function uploadFiles(
  client,
  files,
  { kind, upAxis, unitM, signal, onProgress = () => {} } = /** @type {any} */ ({}),
) {
  const fields = Object.entries({ kind, up_axis: upAxis, unit_m: unitM }).filter(([, value]) => value !== undefined);
  const parts = files.map((file) => ({
    name: file.path ?? file.name,
    content: file.content ?? file,
    modified: file.lastModified ?? 0,
  }));
  const total = parts.reduce((sum, { content }) => sum + content.size, 0);
  onProgress(0);
  const asset =
    total > PIECE
      ? await sendLarge(client, parts, fields, { signal, onProgress: (bytes) => onProgress(bytes / total) })
      : await sendForm(client, parts, fields, { signal, onProgress });
  onProgress(1);
  return asset;
}

async function sendForm(client, parts, fields, options) {
  const form = new FormData();
  for (const { name, content } of parts) form.append("file", content, name);
  for (const [name, value] of fields) form.append(name, String(value));
  return (await postForm(client, "/v1/assets", form, options)).json();
}

async function sendLarge(client, parts, fields, { signal, onProgress }) {
  const ids = [];
  let before = 0;
  for (const part of parts) {
    const start = before;
    ids.push(await sendInPieces(client, part, { signal, onProgress: (bytes) => onProgress(start + bytes) }));
    before += part.content.size;
  }
  const request = { upload_ids: ids, ...Object.fromEntries(fields) };
  const asset = await client.json("POST", "/v1/assets", request, { again: true, signal });
  for (const part of parts) client.storage?.removeItem(storageKey(part));
  return asset;
}

/** tus: continue at the byte that was reached, after a reload too where the client has a storage. */
async function sendInPieces(client, part, { signal, onProgress }) {
  const { content } = part;
  let { path, offset } = (await findUpload(client, part, signal)) ?? {};
  if (!path) {
    path = await createUpload(client, part, signal);
    offset = 0;
  }
  for (let failures = 0; offset < content.size; onProgress(offset)) {
    const headers = { ...TUS, "Content-Type": "application/offset+octet-stream", "Upload-Offset": String(offset) };
    try {
      const body = content.slice(offset, offset + PIECE);
      const response = await client.send("PATCH", path, { headers, body, signal });
      offset = Number(response.headers.get("Upload-Offset"));
      failures = 0;
    } catch (error) {
      const moved = error.code === "upload-offset-conflict" || isTemporary(error.status);
      const refused = error.status >= 400 && error.status < 500 && !moved;
      if (signal?.aborted || refused || ++failures > RETRIES) throw error;
      await sleep(500 * 2 ** failures, signal);
      const response = await client.send("HEAD", path, { headers: TUS, signal });
      offset = Number(response.headers.get("Upload-Offset"));
    }
  }
  return path.split("/").pop();
}

async function createUpload(client, part, signal) {
  const headers = {
    ...TUS,
    "Upload-Length": String(part.content.size),
    "Upload-Metadata": `filename ${base64(part.name)}`,
  };
  const path = (await client.send("POST", "/v1/uploads", { headers, signal })).headers.get("Location");
  client.storage?.setItem(storageKey(part), path);
  return path;
}

/** The upload that an earlier attempt at the same file began, or null. */
async function findUpload(client, part, signal) {
  const path = client.storage?.getItem(storageKey(part));
  if (!path) return null;
  const response = await client.send("HEAD", path, { headers: TUS, signal }).catch(() => null);
  if (Number(response?.headers.get("Upload-Length")) !== part.content.size) return null;
  return { path, offset: Number(response.headers.get("Upload-Offset")) };
}

/** Only XMLHttpRequest reports how much was sent; where there is none (node), fetch sends the form. */
async function postForm(client, path, form, { signal, onProgress }) {
  if (typeof XMLHttpRequest === "undefined") return client.send("POST", path, { body: form, signal });
  const send = () =>
    new Promise((resolve, reject) => {
      const request = new XMLHttpRequest();
      request.open("POST", client.base + path);
      if (client.key) request.setRequestHeader("Authorization", `Bearer ${client.key}`);
      request.upload.onprogress = (event) => event.lengthComputable && onProgress(event.loaded / event.total);
      request.onload = () => resolve(asResponse(request));
      request.onerror = () => reject(new TypeError("the upload was cut off"));
      request.onabort = () => reject(signal.reason);
      signal?.addEventListener("abort", () => request.abort());
      request.send(form);
    });
  return client.withFetch(send).send("POST", path, { signal });
}

function asResponse(request) {
  const headers = new Headers();
  for (const name of ["Content-Type", "Retry-After", "Location"]) {
    const value = request.getResponseHeader(name);
    if (value !== null) headers.set(name, value);
  }
  return new Response(request.responseText, { status: request.status, headers });
}

const storageKey = ({ name, content, modified }) => `upload ${name} ${content.size} ${modified}`;
const base64 = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text)));
