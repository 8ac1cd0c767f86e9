// Bits that were sorted by how sure their prediction is, as mixseq/coding/bitstream/bit_mixing.py decodes them.
import { MixseqError } from "./errors.js";
import { FAR, logisticTables } from "./logistic.js";

/** Number of queues. */
export const QUEUES = 16;

/** Number of contexts of a bit. */
export const INPUTS = 8;

const SLOTS = 1 << 16, PATIENCE = 255, RATE = 32;

/**
 * Read predicted bits of queues `Uint8Array`s; kinds of bits have weights of their own.
 *
 * Before each bit its contexts are set: the 32 lowest bits of each in `contexts`, those above in `above`, which stay as
 * they are. `next(kind)` is the bit, `plain()` one of which nothing is known. `ended()` tells whether all bits were read.
 */
export function mixedBits(queues, kinds, firstWeight) {
  const { stretch, squash } = logisticTables();
  const contexts = new Int32Array(INPUTS), above = new Int32Array(INPUTS), heads = new Int32Array(QUEUES);
  const shares = new Int32Array(INPUTS * SLOTS).fill(1 << 23), places = new Int32Array(INPUTS); // shares: 256 p + bits seen
  const weights = new Float64Array(kinds * INPUTS).fill(firstWeight), logits = new Int32Array(INPUTS);
  const steps = Int32Array.from({ length: PATIENCE + 1 }, (_, seen) => (1 << 17) / (2 * seen + 3));

  function next(kind) {
    const first = kind * INPUTS;
    let sum = 0;
    for (let i = 0; i < INPUTS; i++) {
      const place = (i << 16) | (spread(contexts[i], above[i]) >>> 16), logit = stretch[shares[place] >> 12];
      places[i] = place;
      logits[i] = logit;
      sum += weights[first + i] * logit; // which may have more than 32 bits
    }
    const x = sum >= FAR * 65536 ? FAR : sum <= -FAR * 65536 ? -FAR : Math.floor(sum / 65536) | 0;
    const bit = taken((Math.abs(x) * QUEUES) >> 11) ^ (x > 0 ? 1 : 0);
    const error = RATE * (((bit << 16) - squash[x + FAR]) >> 4), aim = 65535 * bit;
    for (let i = 0; i < INPUTS; i++) {
      weights[first + i] += (Math.imul(logits[i], error) + 32768) >> 16;
      const place = places[i], share = shares[place], p = share >> 8, seen = share & 255;
      shares[place] = ((p + (Math.imul(aim - p, steps[seen]) >> 16)) << 8) + (seen < PATIENCE ? seen + 1 : PATIENCE);
    }
    return bit;
  }

  function taken(queue) {
    if (heads[queue] >= queues[queue].length) throw new MixseqError("coded bits end early; the file is damaged");
    return queues[queue][heads[queue]++];
  }

  return { contexts, above, next, plain: () => taken(0), ended: () => queues.every((queue, k) => heads[k] === queue.length) };
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
