// Locate the streams in the bytes, and verify them. Mirrors io/mixseq_io/coded/streams.py.
import { crc32 } from "./arithmetic.js";
import { MixseqError } from "./errors.js";

/** Decompress up to `most` bytes of zlib data by the browser; empty data stays empty. `what` names it in messages. */
export async function decompressed(data, most, what) {
  if (!data.length) return data;
  const reader = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate")).getReader(), parts = [];
  const next = () => reader.read().catch((error) => {
    throw new MixseqError(`${what} are damaged (${error.message})`);
  });
  let size = 0;
  for (let part = await next(); !part.done; part = await next()) {
    size += part.value.length;
    if (size > most) {
      reader.cancel();
      throw new MixseqError(`${what} take more than the allowed ${most} bytes`);
    }
    parts.push(part.value);
  }
  return new Uint8Array(await new Blob(parts).arrayBuffer());
}

/** The times of `count` frames in seconds, from the bytes of their deviations from regular ones; no bytes for regular times. */
export function readTimes(bytes, first, count, fps) {
  if (bytes.length !== 0 && bytes.length !== 8 * count) throw new MixseqError("the number of times is not that of the frames; it is damaged");
  const times = Float64Array.from({ length: count }, (_, frame) => first + frame / fps);
  if (bytes.length) addDifferences(times, bytes);
  if (!times.every((time, k) => Number.isFinite(time) && !(k && time <= times[k - 1]))) {
    throw new MixseqError("the times of frames do not increase; it is damaged");
  }
  return times;
}

/** Add the sums of differences to the bits of times, as 64-bit integers in two halves; the lowest bytes of all are first. */
function addDifferences(times, bytes) {
  const count = times.length, view = new DataView(new ArrayBuffer(8)), wrapped = 2 ** 32;
  const half = (k, byte) => {
    const of = (which) => bytes[(byte + which) * count + k] << (8 * which);
    return (of(0) | of(1) | of(2) | of(3)) >>> 0;
  };
  for (let k = 0, low = 0, high = 0; k < count; k++) {
    low += half(k, 0);
    high = (high + half(k, 4) + Math.floor(low / wrapped)) % wrapped;
    low %= wrapped;
    view.setFloat64(0, times[k], true);
    const sum = view.getUint32(0, true) + low;
    view.setUint32(0, sum, true); // the lowest 32 bits of it
    view.setUint32(4, view.getUint32(4, true) + high + Math.floor(sum / wrapped), true);
    times[k] = view.getFloat64(0, true);
  }
}

const MAGIC = 0x3171736d; // msq1
const HEAD_SIZE = 16; // bytes
const MAX_CHUNK_FRAMES = 8192;
const MAX_MEMORY = 2 ** 32; // bytes that a sequence may take
const MAX_BITS_PER_BYTE = 17000, PADDING_BYTES = 4; // no bit takes less than 4.8e-4 bits

/**
 * The streams of `bytes`, each checked: `connectivity`, `surface`, `times` and, if `parameters` tell so, `uvs` and `labels`; a list for the `basis`;
 * and `chunks` with their `first` frame, `count` of frames, `coefficients`, `residuals` and `inbetweens`, empty if there are none.
 */
export function readIndex(text, bytes, parameters) {
  const hasUvs = parameters.uvSteps !== null, hasLabels = parameters.labelCount !== null;
  const hasInbetweens = parameters.inbetweenLevels > 0;
  const damaged = new MixseqError("the index is damaged, so nothing can be read");
  if (bytes.length < HEAD_SIZE) throw damaged;
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length), word = (at) => view.getUint32(at, true);
  const middle = HEAD_SIZE + word(4), end = middle + word(8);
  if (word(0) !== MAGIC || end > bytes.length || word(8) % 4 || crc32(bytes.subarray(HEAD_SIZE, end)) !== word(12)) throw damaged;
  if (end === middle || crc32(new TextEncoder().encode(text)) !== word(middle)) throw damaged;
  const numbers = readLeb128(bytes.subarray(HEAD_SIZE, middle)), [groups, chunks] = numbers;
  const counts = numbers.slice(2, 2 + chunks), lengths = numbers.slice(2 + chunks);
  const checksumCount = (end - middle) / 4 - 1, nonemptyCount = lengths.filter((length) => length > 0).length;
  if (lengths.length !== 3 + hasUvs + hasLabels + groups + (2 + hasInbetweens) * chunks || !counts.every((count) => count > 0 && count <= MAX_CHUNK_FRAMES) || checksumCount !== nonemptyCount) throw damaged;

  let start = end, checksum = middle, next = 0;
  const stream = (name) => {
    const length = lengths[next++], data = bytes.subarray(start, (start += length));
    if (length && !(data.length === length && crc32(data) === word((checksum += 4)))) throw new MixseqError(`${name} are damaged`);
    return data;
  };
  const connectivity = stream("the connectivity's bytes"), surface = stream("the surface's bytes");
  const times = stream("the times"), uvs = hasUvs ? stream("the texture coordinates") : null, basis = [];
  const labels = hasLabels ? stream("the labels of parts") : null; // of triangles
  for (let group = 0; group < groups; group++) basis.push(stream(`the basis vectors of group ${group}`));
  let first = 0;
  return {
    connectivity, surface, times, uvs, labels, basis,
    chunks: counts.map((count) => {
      const frames = `of frames ${first} to ${first + count - 1}`;
      const coefficients = stream(`the coefficients ${frames}`), residuals = stream(`the residuals ${frames}`);
      const inbetweens = hasInbetweens ? stream(`the in-betweens ${frames}`) : new Uint8Array(0);
      first += count;
      return { first: first - count, count, coefficients, residuals, inbetweens };
    }),
  };
}

/** Verify that streams are long enough for the numbers that `facts` say, a bit each, and that there is memory. */
export function checkSizes({ vertexCount, cornerCount, frameCount, parameters }, { connectivity, basis, chunks }) {
  const { rank, ranks, inbetweenLevels, inbetweenParts, labelCount } = parameters, shapes = parameters.factors === "shapes", largest = (sizes) => sizes.reduce((a, b) => Math.max(a, b), 0);
  const checkBits = (name, numbers, size) => {
    if (numbers <= MAX_BITS_PER_BYTE * (size + PADDING_BYTES * (basis.length + 1))) return;
    throw new MixseqError(`${size} bytes cannot hold ${numbers} numbers of its ${name}; it is damaged`);
  };
  checkBits("corners", cornerCount, connectivity.length);
  checkBits("vertices", (shapes ? 3 : 1) * Math.min(...ranks) * vertexCount, basis.reduce((sum, { length }) => sum + length, 0));
  if (!shapes) chunks.forEach(({ count, coefficients }) => checkBits("frames", 3 * count, coefficients.length));
  const bytes = 800 * vertexCount + 320 * cornerCount + 64 * frameCount +
    86 * largest(chunks.map(({ residuals }) => residuals.length)) + (inbetweenParts ? 64 * (vertexCount + 3 * labelCount * frameCount * 2 ** inbetweenLevels) : 0) + 16 * rank * ((shapes ? 3 : 1) * vertexCount + (shapes ? 9 : 3) * frameCount * 2 ** inbetweenLevels);
  if (bytes > MAX_MEMORY) throw new MixseqError(`it would take ${Math.ceil(bytes / 2 ** 30)} GiB of memory, more than the allowed 4 GiB`);
}

/** Numbers of 7 bits a byte, the lowest first. */
function readLeb128(bytes) {
  const numbers = [];
  let number = 0, unit = 1;
  for (const byte of bytes) {
    number += (byte & 127) * unit;
    unit *= 128;
    if (byte & 128) continue;
    numbers.push(number);
    number = 0;
    unit = 1;
  }
  return numbers;
}
