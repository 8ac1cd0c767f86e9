// Bits in contexts that are too numerous for tables. Mirrors mixseq/compression/bitstream/arithmetic.py.
import { BitStream } from "./arithmetic.js";
import { BitModels } from "./bit_models.js";
import { MixseqError } from "./errors.js";

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
