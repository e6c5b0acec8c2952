// safetensors files.

const KINDS = {
  F16: Uint16Array,
  I16: Int16Array,
  U16: Uint16Array,
  I32: Int32Array,
  F32: Float32Array,
  U8: Uint8Array,
};

/**
 * The tensors of a safetensors file by name, the `shape` of each, and the strings of its metadata. Half floats become
 * single floats, except for the tensors named in `halves`; the `planes` of the metadata become integers again.
 */
export function readTensors(buffer, { halves = [] } = {}) {
  const size = Number(new DataView(buffer).getBigUint64(0, true));
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, size)));
  const { __metadata__: metadata = {}, ...entries } = header;
  const tensors = {};
  const shape = {};
  for (const [name, entry] of Object.entries(entries)) {
    const [start, end] = entry.data_offsets.map((offset) => 8 + size + offset);
    const stored = new KINDS[entry.dtype](buffer.slice(start, end));
    tensors[name] = entry.dtype === "F16" && !halves.includes(name) ? Float32Array.from(stored, half) : stored;
    shape[name] = entry.shape;
  }
  for (const [name, zero] of Object.entries(JSON.parse(metadata.planes ?? "{}"))) {
    tensors[name] = joined(tensors[name], zero);
    shape[name].shift();
  }
  return { tensors, shape, metadata };
}

/** Integers of 16 bits from the plane of their low bytes and that of their high bytes. */
function joined(planes, zero) {
  const numbers = new Int16Array(planes.length / 2);
  for (let i = 0; i < numbers.length; i++) numbers[i] = planes[i] + 256 * planes[numbers.length + i] - zero;
  return numbers;
}

/** IEEE 754 half precision to a number. */
function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 0) return sign * 2 ** -24 * fraction;
  if (exponent === 31) return fraction ? Number.NaN : sign * Number.POSITIVE_INFINITY;
  return sign * 2 ** (exponent - 15) * (1 + fraction / 1024);
}
