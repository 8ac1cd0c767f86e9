// Bits in contexts that are too many for tables. Mirrors coding/bitstream/hashed_contexts.py.
import { Bits } from "./arithmetic.js";
import { BitModels } from "./bit_models.js";
import { MixseqError } from "./errors.js";

/** Number of contexts of a bit. */
export const INPUTS = 8;

const SLOTS = 1 << 16;

/**
 * Read bits of several kinds from bytes.
 *
 * Before each bit its contexts are set: the 32 lowest bits of each in `contexts`, those above in `above`, which stay as
 * they are. `next(kind)` is the bit, `plain(size)` a number of so many bits of which nothing is known.
 */
export function hashedBits(data, kinds) {
  const coded = new Bits(data), models = new BitModels(INPUTS, SLOTS, 1, kinds);
  const contexts = new Int32Array(INPUTS), above = new Int32Array(INPUTS), slots = models.contexts;

  function next(kind) {
    for (let i = 0; i < INPUTS; i++) slots[i] = spread(contexts[i], above[i]) >>> 16;
    const bit = models.read(coded, 0, kind);
    if (coded.isBeyond()) throw new MixseqError("coded bits end early; the file is damaged");
    return bit;
  }

  return { contexts, above, next, plain: (size) => coded.number(size) };
}

/**
 * The bits 32 to 63 of a context, given by its lower and upper 32 bits, times 2^64 divided by the golden ratio.
 */
export function spread(low, high) {
  const first = low >>> 16, second = low & 0xffff;
  const middle = Math.imul(first, 0x7c15) + (Math.imul(second, 0x7c15) >>> 16), other = (middle & 0xffff) + Math.imul(second, 0x7f4a);
  const carried = Math.imul(first, 0x7f4a) + (middle >>> 16) + (other >>> 16);
  return carried + Math.imul(low, 0x9e3779b9) + Math.imul(high, 0x7f4a7c15);
}
