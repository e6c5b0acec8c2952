// A zip archive of files as they are: what is in them is packed already, or is small.

const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let rest = byte;
  for (let bit = 0; bit < 8; bit++) rest = rest & 1 ? 0xedb88320 ^ (rest >>> 1) : rest >>> 1;
  return rest;
});
const UTF8 = 0x0800; // flag of names
const JANUARY_1980 = 0x0021; // the first date there is: the same files make the same archive

function crc32(bytes) {
  let rest = 0xffffffff;
  for (const byte of bytes) rest = TABLE[(rest ^ byte) & 255] ^ (rest >>> 8);
  return ~rest >>> 0;
}

/** Files `{ name, bytes }` as one Blob; all together below 4 GB. APPNOTE 4.3.7, 4.3.12 and 4.3.16. */
export function zipped(files) {
  const parts = [];
  const directory = [];
  let offset = 0;
  for (const { name, bytes } of files) {
    const label = new TextEncoder().encode(name);
    const facts = [20, UTF8, 0, 0, JANUARY_1980]; // version needed, flags, stored, time, date
    const sizes = [crc32(bytes), bytes.length, bytes.length];
    const local = record(0x04034b50, [...facts.map(short), ...sizes.map(long), short(label.length), short(0)], label);
    const rest = [label.length, 0, 0, 0, 0].map(short); // no extra field, no comment, first disk, no attributes
    const central = [short(20), ...facts.map(short), ...sizes.map(long), ...rest, long(0), long(offset)];
    directory.push(record(0x02014b50, central, label));
    parts.push(local, bytes);
    offset += local.length + bytes.length;
  }
  const size = directory.reduce((sum, entry) => sum + entry.length, 0);
  const count = files.length;
  const end = [0, 0, count, count].map(short).concat(long(size), long(offset), short(0));
  return new Blob([...parts, ...directory, record(0x06054b50, end)], { type: "application/zip" });
}

const short = (value) => [value & 255, value >>> 8];
const long = (value) => [value & 255, (value >>> 8) & 255, (value >>> 16) & 255, value >>> 24];
const record = (signature, fields, label = new Uint8Array()) =>
  Uint8Array.from([...long(signature), ...fields.flat(), ...label]);
