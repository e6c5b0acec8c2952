// A WebM file of encoded frames (RFC 9559): one video track, a cluster for each key frame.

const EBML = 0x1a45dfa3;
const SEGMENT = 0x18538067;
const INFO = 0x1549a966;
const TRACKS = 0x1654ae6b;
const CLUSTER = 0x1f43b675;

/** `frames` are `{ bytes, time_ms, isKey }` in order, the first a key frame; `codec` is "V_VP8" or "V_VP9". */
export function webm({ codec, width, height, duration_ms, frames }) {
  const head = node(
    EBML,
    number(0x4286, 1), // version of EBML, and the one needed to read it
    number(0x42f7, 1),
    number(0x42f2, 4), // longest id and size
    number(0x42f3, 8),
    node(0x4282, ascii("webm")),
    number(0x4287, 4), // version of the file type, and the one needed to read it
    number(0x4285, 2),
  );
  const info = node(
    INFO,
    number(0x2ad7b1, 1e6), // nanoseconds of a time step
    node(0x4489, float(duration_ms)),
    node(0x4d80, ascii("DynamicTree")),
    node(0x5741, ascii("DynamicTree")),
  );
  const video = node(0xe0, number(0xb0, width), number(0xba, height));
  const track = node(0xae, number(0xd7, 1), number(0x73c5, 1), number(0x83, 1), node(0x86, ascii(codec)), video);
  return new Blob([head, node(SEGMENT, info, node(TRACKS, track), ...clusters(frames))], { type: "video/webm" });
}

function clusters(frames) {
  const groups = [];
  for (const frame of frames) frame.isKey ? groups.push([frame]) : groups.at(-1).push(frame);
  return groups.map((group) => {
    const start = Math.round(group[0].time_ms);
    const blocks = group.map(({ bytes, time_ms: time, isKey }) => {
      const after = Math.round(time) - start;
      return node(0xa3, Uint8Array.of(0x81, after >> 8, after & 255, isKey ? 0x80 : 0), bytes);
    });
    return node(CLUSTER, number(0xe7, start), ...blocks);
  });
}

/** An element: id, size in eight bytes, content. */
function node(id, ...contents) {
  const content = new Blob(contents);
  return new Blob([bigEndian(id), Uint8Array.of(1), bigEndian(content.size, 7), content]);
}

const number = (id, value) => node(id, bigEndian(value));
const ascii = (words) => new TextEncoder().encode(words);

function float(value) {
  const bytes = new Uint8Array(8);
  new DataView(bytes.buffer).setFloat64(0, value);
  return bytes;
}

function bigEndian(value, length = Math.max(1, Math.ceil(Math.log2(value + 1) / 8))) {
  return Uint8Array.from({ length }, (_, i) => Math.floor(value / 256 ** (length - 1 - i)) % 256);
}
