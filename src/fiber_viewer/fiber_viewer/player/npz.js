// SPDX-License-Identifier: Apache-2.0
// Reads .npz files, zips of numpy arrays, as numpy.savez_compressed writes them.

const END_OF_DIRECTORY = 0x06054b50;
const DIRECTORY_ENTRY = 0x02014b50;
const STORED = 0;
const DEFLATED = 8;

// Typed arrays for the numpy types. 64-bit integers become doubles; ids and counts stay exact.
const COLUMN_TYPES = {
  "|b1": Uint8Array, "|u1": Uint8Array, "|i1": Int8Array,
  "<i2": Int16Array, "<u2": Uint16Array, "<i4": Int32Array, "<u4": Uint32Array,
  "<f4": Float32Array, "<f8": Float64Array, "<i8": BigInt64Array, "<u8": BigUint64Array,
};

/** Returns the bytes of base64 text. */
export function fromBase64(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** Returns {name: {data, shape}} of all numeric arrays in a .npz file. */
export async function readNpz(bytes) {
  const arrays = {};
  for (const entry of directoryOf(bytes)) {
    const array = parseNpy(await contentOf(bytes, entry));
    if (array) arrays[entry.name.replace(/\.npy$/, "")] = array;
  }
  return arrays;
}

function directoryOf(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let end = bytes.length - 22;
  while (end >= 0 && view.getUint32(end, true) !== END_OF_DIRECTORY) end--;
  if (end < 0) throw new Error("this file is not a recording: it is not an .npz file");
  const count = view.getUint16(end + 10, true);
  const entries = [];
  let at = view.getUint32(end + 16, true);
  for (let i = 0; i < count; i++) {
    if (view.getUint32(at, true) !== DIRECTORY_ENTRY) throw new Error("the .npz file is damaged");
    const [nameLength, extra, comment] = [28, 30, 32].map((o) => view.getUint16(at + o, true));
    entries.push({
      name: new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + nameLength)),
      method: view.getUint16(at + 10, true),
      size: view.getUint32(at + 20, true),
      header: view.getUint32(at + 42, true),
    });
    at += 46 + nameLength + extra + comment;
  }
  return entries;
}

async function contentOf(bytes, { name, method, size, header }) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const begin = header + 30 + view.getUint16(header + 26, true) + view.getUint16(header + 28, true);
  const packed = bytes.subarray(begin, begin + size);
  if (method === STORED) return packed.slice();
  if (method !== DEFLATED) throw new Error(`${name}: this compression method is not supported`);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Returns {data, shape} of the bytes of a .npy file, null for text and other objects. */
export function parseNpy(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const wide = bytes[6] > 1; // version 2 and later have a longer length field
  const length = wide ? view.getUint32(8, true) : view.getUint16(8, true);
  const begin = (wide ? 12 : 10) + length;
  const header = new TextDecoder("latin1").decode(bytes.subarray(wide ? 12 : 10, begin));
  const type = COLUMN_TYPES[/'descr': '([^']*)'/.exec(header)[1]];
  if (!type) return null;
  if (/'fortran_order': True/.test(header)) throw new Error("arrays must be in C order");
  const shape = /'shape': \(([^)]*)\)/.exec(header)[1].split(",").filter((s) => s.trim()).map(Number);
  const count = shape.reduce((a, b) => a * b, 1);
  let data = new type(bytes.slice(begin, begin + count * type.BYTES_PER_ELEMENT).buffer);
  if (typeof data[0] === "bigint") data = Float64Array.from(data, Number);
  return { data, shape };
}
