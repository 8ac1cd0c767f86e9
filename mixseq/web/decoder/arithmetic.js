// Read bits by arithmetic decoding, predict them with adaptive models, and check decoded numbers.
// Mirrors mixseq/compression/bitstream/arithmetic.py.
import { MixseqError } from "./errors.js";

/** Eight tables: a byte, and a byte with 1 to 7 zeros behind it. */
const TABLES = tables();

function tables() {
  const found = Array.from({ length: 8 }, () => new Uint32Array(256));
  for (let byte = 0; byte < 256; byte++) {
    let code = byte;
    for (let bit = 0; bit < 8; bit++) code = code & 1 ? (code >>> 1) ^ 0xedb88320 : code >>> 1;
    found[0][byte] = code;
  }
  for (let zeros = 1; zeros < 8; zeros++) {
    for (let byte = 0; byte < 256; byte++) {
      const before = found[zeros - 1][byte];
      found[zeros][byte] = found[0][before & 255] ^ (before >>> 8);
    }
  }
  return found;
}

/** The CRC-32 of bytes, continued from the CRC-32 `before`. */
export function crc32(bytes, before = 0) {
  const table = TABLES[0];
  let code = ~before;
  for (let k = 0; k < bytes.length; k++) code = table[(code ^ bytes[k]) & 255] ^ (code >>> 8);
  return ~code >>> 0;
}

/** The same of whole numbers below 2^53, each as an int64 with its lowest byte first. */
export function checksumOf(numbers, before = 0) {
  const [a, b, c, d, e, f, g, h] = TABLES;
  let code = ~before;
  for (let k = 0; k < numbers.length; k++) {
    const number = numbers[k], low = code ^ number, high = Math.floor(number / 4294967296) | 0;
    code = h[low & 255] ^ g[(low >>> 8) & 255] ^ f[(low >>> 16) & 255] ^ e[low >>> 24] ^
      d[high & 255] ^ c[(high >>> 8) & 255] ^ b[(high >>> 16) & 255] ^ a[high >>> 24];
  }
  return ~code >>> 0;
}

const PADDING_BYTES = 8; // zero bytes that may be read after the end

/** Bytes with the state of reading bits from them. */
export class BitStream {
  constructor(data) {
    this.data = data;
    this.place = 4;
    // Both ends of the interval, and the number in it.
    this.interval = Uint32Array.of(0, 0xffffffff, (data[0] << 24) | (data[1] << 16) | (data[2] << 8) | data[3]);
  }

  /** Read a bit; `probability`, that it is 1, is in 65536ths. */
  read(probability) {
    const interval = this.interval;
    let low = interval[0], high = interval[1], bit = 1;
    const range = (high - low) >>> 0;
    // floor(range probability / 65536), in 32 bits
    const part = Math.imul(range >>> 16, probability) + (Math.imul(range & 0xffff, probability) >>> 16);
    const middle = (low + part) >>> 0;
    if (interval[2] <= middle) high = middle;
    else {
      low = middle + 1;
      bit = 0;
    }
    while ((low ^ high) >>> 24 === 0) {
      low = (low << 8) >>> 0;
      high = ((high << 8) | 255) >>> 0;
      const place = this.place++;
      interval[2] = (interval[2] << 8) | (place < this.data.length ? this.data[place] : 0);
    }
    interval[0] = low;
    interval[1] = high;
    return bit;
  }

  /** Read a number of `size` bits without a model. */
  rawBits(size) {
    let value = 0;
    for (let bit = 0; bit < size; bit++) value = 2 * value + this.read(32768);
    return value;
  }

  /** Whether more bits were read than there are. */
  isPastEnd() {
    return this.place > this.data.length + PADDING_BYTES;
  }
}

// Probabilities of bits, mixed from several contexts in the logistic domain.

const MAX_LOGIT = 2047; // largest magnitude of x, in units of 2^-8
const MAX_FREQUENCY_COUNT = 255; // largest count in the running mean of a frequency
const LEARNING_RATE = 48; // of weights, in 1 / 4096 of x's and p's units
const MIN_PROBABILITY = 16; // smallest probability of either bit, in 65536ths

const { stretch: STRETCH, squash: SQUASH } = logisticTables();
for (let x = 0; x < SQUASH.length; x++) SQUASH[x] = Math.min(Math.max(SQUASH[x], MIN_PROBABILITY), 65536 - MIN_PROBABILITY);
const RATES = Int32Array.from({ length: MAX_FREQUENCY_COUNT + 1 }, (_, count) => Math.floor((1 << 17) / (2 * count + 3)));
const CONFIDENCES = Int32Array.from({ length: MAX_FREQUENCY_COUNT + 1 }, (_, count) => Math.floor((256 * count) / (count + 1)));

/**
 * Frequencies and mixing weights of bits. The `contexts` of the inputs are set before every bit. Every one of the `kinds`
 * has weights; by default kinds are positions.
 */
export class BitModels {
  constructor(inputs, contexts, positions, kinds = positions) {
    this.positions = positions;
    this.width = contexts * positions; // of the rows of an input
    this.frequencies = new Int32Array(inputs * this.width).fill(1 << 23); // 256 p + n
    this.weights = new Float64Array(kinds * inputs).fill(Math.floor((65536 + (inputs >> 1)) / inputs));
    this.contexts = new Int32Array(inputs);
    this.inputs = new Int32Array(inputs); // x of the current bit
    this.places = new Int32Array(inputs); // of its frequencies
  }

  /** Read a bit of a kind at a position, and update the models. */
  read(stream, position, kind = position) {
    const { frequencies, weights, contexts, inputs, places, positions, width } = this;
    const count = inputs.length, own = kind * count;
    let sum = 0; // may have more than 32 bits
    for (let i = 0, first = position; i < count; i++, first += width) {
      const place = first + contexts[i] * positions, frequency = frequencies[place];
      const x = (STRETCH[frequency >> 12] * CONFIDENCES[frequency & 255]) >> 8;
      places[i] = place;
      inputs[i] = x;
      sum += weights[own + i] * x;
    }
    const x = sum >= MAX_LOGIT * 65536 ? MAX_LOGIT : sum < -MAX_LOGIT * 65536 ? -MAX_LOGIT : sum >> 16;
    const probability = SQUASH[x + MAX_LOGIT], bit = stream.read(probability);
    const error = ((bit << 16) - probability) >> 4, aim = (bit << 16) - bit;
    for (let i = 0; i < count; i++) {
      weights[own + i] += (Math.imul(inputs[i], error) * LEARNING_RATE + 32768) >> 16;
      const place = places[i], frequency = frequencies[place], seenCount = frequency & 255;
      // The product has 32 bits: p is 32768 where the step is largest.
      const p = (frequency >> 8) + (Math.imul(aim - (frequency >> 8), RATES[seenCount]) >> 16);
      frequencies[place] = (p << 8) + (seenCount < MAX_FREQUENCY_COUNT ? seenCount + 1 : seenCount);
    }
    return bit;
  }
}

/** Tables of x by p in units of 2^-12, and of p in units of 2^-16 by x from -MAX_LOGIT to MAX_LOGIT. */
function logisticTables() {
  const growth = new Float64Array(2 * MAX_LOGIT + 1).fill(1), squash = new Int32Array(2 * MAX_LOGIT + 1), stretch = new Int32Array(4096);
  for (let x = 0; x < MAX_LOGIT; x++) growth[MAX_LOGIT + x + 1] = growth[MAX_LOGIT + x] * 1.0039138893383475; // near exp(1 / 256)
  for (let x = 1; x <= MAX_LOGIT; x++) growth[MAX_LOGIT - x] = 1 / growth[MAX_LOGIT + x];
  growth.forEach((g, k) => (squash[k] = Math.floor(65536 * (g / (1 + g)))));
  let x = 0;
  for (let p = 0; p < 4096; p++) {
    while (x < 2 * MAX_LOGIT && squash[x] < 16 * p + 8) x++;
    stretch[p] = x - MAX_LOGIT;
  }
  return { stretch, squash };
}

/** Number of contexts of a bit. */
export const CONTEXTS_PER_BIT = 8;

const CONTEXT_SLOTS = 1 << 16;

/**
 * Read bits of several kinds from bytes.
 *
 * Contexts are set before each bit: their 32 lowest bits in `contexts`, the upper ones in `above`; they are kept.
 * `next(kind)` reads a bit, `rawBits(size)` a number of `size` bits without a model.
 */
export function hashedBits(data, kinds) {
  const stream = new BitStream(data), models = new BitModels(CONTEXTS_PER_BIT, CONTEXT_SLOTS, 1, kinds);
  const contexts = new Int32Array(CONTEXTS_PER_BIT), above = new Int32Array(CONTEXTS_PER_BIT), slots = models.contexts;

  function next(kind) {
    for (let i = 0; i < CONTEXTS_PER_BIT; i++) slots[i] = hashContext(contexts[i], above[i]) >>> 16;
    const bit = models.read(stream, 0, kind);
    if (stream.isPastEnd()) throw new MixseqError("the coded bits end early; it is damaged");
    return bit;
  }

  return { contexts, above, next, rawBits: (size) => stream.rawBits(size) };
}

/**
 * The bits 32 to 63 of a context, given by its lower and upper 32 bits, times 2^64 divided by the golden ratio.
 */
export function hashContext(low, high) {
  const first = low >>> 16, second = low & 0xffff;
  const middle = Math.imul(first, 0x7c15) + (Math.imul(second, 0x7c15) >>> 16), other = (middle & 0xffff) + Math.imul(second, 0x7f4a);
  const carried = Math.imul(first, 0x7f4a) + (middle >>> 16) + (other >>> 16);
  return carried + Math.imul(low, 0x9e3779b9) + Math.imul(high, 0x7f4a7c15);
}

const CHECKSUM_SIZE = 4; // bytes

/** Split a stream into its data and the CRC-32 of the decoded numbers. */
export function splitChecksum(bytes) {
  const end = Math.max(bytes.length - CHECKSUM_SIZE, 0);
  let expected = 0;
  for (let k = bytes.length - 1; k >= end; k--) expected = ((expected << 8) | bytes[k]) >>> 0;
  return { data: bytes.subarray(0, end), expected };
}

/** Verify that the decoded numbers are those that were coded. */
export function verifyChecksum(found, expected) {
  if (found !== expected) throw new MixseqError("the decoded numbers differ from the coded ones; it is damaged");
}
