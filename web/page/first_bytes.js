// What a dropped file is by its first and last bytes, where it is none that can become a tree: said before it is uploaded.

import { Problem } from "../client/problem.js";
import { suffixOf } from "./bundles.js";

const PIECE = 65_536; // bytes that are read of either end, and in between
const GLB_HEAD = 12; // magic, version, length of the whole
const ZIP = "PK\u0003\u0004";
/** What the content begins with, by kind. */
const BEGINNINGS = {
  pdf: "%PDF",
  rtf: "{\\rtf",
  blend: "BLENDER",
  fbx: "Kaydara FBX",
  rar: "Rar!",
  "7z": "7z\u00bc\u00af",
};
/** What a zip has a folder or file of, by kind. */
const INSIDE = { docx: "word/", xlsx: "xl/workbook", pptx: "ppt/", odf: "META-INF/manifest.xml" };

/** Throw a Problem where the first file of a bundle holds nothing that can be read. */
export async function checkContent([{ name, content }]) {
  const first = await bytesAt(content, 0);
  const size = content.size;
  if (await isZero(content, first)) throw new Problem({ code: "zeros", name });
  const text = latin(first);
  if (text.startsWith("glTF") && first.length >= GLB_HEAD) {
    const [version, whole] = [4, 8].map((at) => new DataView(first.buffer).getUint32(at, true));
    if (version === 2 && size < whole) throw new Problem({ code: "cut-off", name, size, whole });
  }
  const kind = kindOf(text, suffixOf(name)) ?? (text.startsWith(ZIP) ? await kindOfZip(content, suffixOf(name)) : null);
  if (kind) throw new Problem({ code: "foreign", name, kind });
}

function kindOf(text, suffix) {
  if (/^\s*<(!doctype html|html)/i.test(text)) return "html";
  const kind = Object.keys(BEGINNINGS).find((one) => text.startsWith(BEGINNINGS[one]));
  return kind ?? (suffix === "blend" ? "blend" : null); // Blender packs its files
}

/** The names in a zip's directory, which is its end. */
async function kindOfZip(content, suffix) {
  if (suffix === "3mf" || suffix === "zip") return null;
  const names = latin(await bytesAt(content, Math.max(content.size - PIECE, 0)));
  return Object.keys(INSIDE).find((one) => names.includes(INSIDE[one])) ?? null;
}

/** Whether both ends and three places between hold nothing but zeros. */
async function isZero(content, first) {
  if (!first.every((byte) => byte === 0)) return false;
  const places = [0.25, 0.5, 0.75, 1].map((share) => Math.max(Math.floor(share * content.size) - PIECE, 0));
  const pieces = await Promise.all(places.map((at) => bytesAt(content, at)));
  return pieces.every((piece) => piece.every((byte) => byte === 0));
}

const bytesAt = async (content, at) => new Uint8Array(await content.slice(at, at + PIECE).arrayBuffer());
const latin = (bytes) => new TextDecoder("latin1").decode(bytes);
