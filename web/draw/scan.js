// Laser scans as points: text, LAS and LAZ, from their beginning where they are long.

import * as THREE from "three";

const TEXT_BYTES = 30e6;
const MOST_READ = 4e6; // points of a LAS or LAZ file
const MOST_DRAWN = 200_000;
const AT_ONCE = 100_000; // points decompressed before the page may do something else
/** Place of the colour in a point's record, by point format of the LAS specification 1.4. */
const COLOR_AT = { 2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30 };

/** A scan as text: lines whose first three numbers are x, y, z [m]. */
export async function readText([{ content }]) {
  const lines = (await content.slice(0, TEXT_BYTES).text()).split("\n");
  const step = Math.ceil(lines.length / MOST_DRAWN);
  const points = lines.filter((_, i) => i % step === 0).map((line) => line.match(/[^\s,;]+/g)?.slice(0, 3) ?? []);
  const read = points.map((point) => point.map(Number)).filter((p) => p.length === 3 && p.every(Number.isFinite));
  return { object: pointsOf(geometryOf(read)) };
}

/** A LAS or LAZ file, by its header (LAS specification 1.4, section 2.4). */
export async function readLas([{ content }]) {
  const bytes = new Uint8Array(await content.arrayBuffer());
  const header = new DataView(bytes.buffer);
  const scale = [131, 139, 147].map((at) => header.getFloat64(at, true));
  const packed = header.getUint8(104) & 0xc0; // LASzip's mark
  const format = header.getUint8(104) & 0x3f;
  const length = header.getUint16(105, true);
  const later = header.getUint8(25) >= 4 ? Number(header.getBigUint64(247, true)) : 0; // LAS 1.4
  const count = Math.min(header.getUint32(107, true) || later, MOST_READ);
  const step = Math.ceil(count / MOST_DRAWN);
  const records = packed
    ? await unpacked(bytes, count, step, length)
    : plain(bytes.subarray(header.getUint32(96, true)), count, step, length);
  const places = records.map((view) => scale.map((unit, c) => unit * view.getInt32(4 * c, true)));
  const geometry = geometryOf(places);
  const colors = format in COLOR_AT ? records.map((view) => colorAt(view, COLOR_AT[format])) : [];
  const brightest = colors.flat().reduce((most, value) => Math.max(most, value), 0);
  if (brightest) {
    const unit = brightest > 255 ? 65535 : 255; // many programs write bytes
    const linear = colors.flatMap(([r, g, b]) => [
      ...new THREE.Color(r / unit, g / unit, b / unit).convertSRGBToLinear(),
    ]);
    geometry.setAttribute("color", new THREE.Float32BufferAttribute(linear, 3));
  }
  return { object: pointsOf(geometry) };
}

const colorAt = (view, at) => [0, 2, 4].map((c) => view.getUint16(at + c, true));

function plain(bytes, count, step, length) {
  const whole = Math.min(count, Math.floor(bytes.length / length));
  return Array.from(
    { length: Math.ceil(whole / step) },
    (_, i) => new DataView(bytes.buffer, bytes.byteOffset + i * step * length, length),
  );
}

/** Every `step`-th record of a LAZ file. */
async function unpacked(bytes, count, step, length) {
  const { default: createLazPerf } = await import("laz-perf");
  const laz = await createLazPerf({ locateFile: () => import.meta.resolve("laz-perf.wasm") });
  const [file, point] = [laz._malloc(bytes.length), laz._malloc(length)];
  laz.HEAPU8.set(bytes, file);
  const reader = new laz.LASZip();
  try {
    reader.open(file, bytes.length);
    const records = [];
    for (let i = 0; i < count; i++) {
      reader.getPoint(point);
      if (i % step === 0) records.push(new DataView(laz.HEAPU8.slice(point, point + length).buffer));
      if (i % AT_ONCE === 0) await new Promise((resolve) => setTimeout(resolve));
    }
    return records;
  } finally {
    reader.delete();
  }
}

/** Places relative to the first, since a surveyor's coordinates are millions of metres. */
function geometryOf(places) {
  const [first] = places;
  const relative = places.flatMap((place) => place.map((x, c) => x - first[c]));
  return new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(relative, 3));
}

/** Points of a geometry, grey where it has no colours. */
export function pointsOf(geometry) {
  const vertexColors = Boolean(geometry.attributes.color);
  const material = { size: 2, sizeAttenuation: false, vertexColors, color: vertexColors ? 0xffffff : 0x6b756f };
  return new THREE.Points(geometry, new THREE.PointsMaterial(material));
}
