// The bytes of bits that were sorted into queues, as mixseq/coding/bitstream/bit_queues.py packs them.
import { QUEUES } from "./bit_mixing.js";
import { Tables, symbolReader } from "./entropy.js";
import { MixseqError } from "./errors.js";

const FIRST_ROUND = 1 << 6, LONGEST_ROUND = 1 << 16, FEWEST_BYTES = 1 / (1 << 18);

/**
 * Return the bits of every queue as `Uint8Array`s.
 *
 * `least` and `most` tell how many bits there can be, `what` what they are of, for messages. No bit takes less than
 * 2^-18 bytes, so whoever claims more than there are is refused before there is memory for them.
 */
export function unpackQueues(bytes, least, most, what) {
  const { lengths, start } = readLengths(bytes, what), total = lengths.reduce((sum, length) => sum + length, 0);
  if (total < least || total > most || total * FEWEST_BYTES > bytes.length) throw new MixseqError(`${total} bits are not as many as ${what} have; the file is damaged`);
  const next = symbolReader(bytes.subarray(start)), tables = bitTables();
  const queues = lengths.map((length) => new Uint8Array(length)), longest = Math.max(...lengths);
  for (let first = 0, size = FIRST_ROUND; first < longest; first += size, size = Math.min(2 * size, LONGEST_ROUND)) {
    const lefts = queues.map((_, queue) => tables.lefts(queue));
    queues.forEach((queue, k) => {
      const last = Math.min(first + size, queue.length);
      let ones = 0;
      for (let place = first; place < last; place++) {
        const symbol = next(lefts[k]);
        if (symbol !== 1 && symbol !== 2) throw new MixseqError(`the bits of ${what} are damaged`); // 0 and 3 would be -1, and larger numbers
        queue[place] = symbol - 1;
        ones += symbol - 1;
      }
      tables.add(k, 1, Math.max(last - first, 0) - ones);
      tables.add(k, 2, ones);
    });
    tables.forget();
  }
  return queues;
}

/** Models of the bits of queues: a 1 is less likely than a 0 by about exp(-8 (q + 1/2) / QUEUES). */
function bitTables() {
  const fall = 1 - 1 / 2 + 1 / 8 - 1 / 48, ratios = [3 / 4];
  while (ratios.length < QUEUES) ratios.push(ratios[ratios.length - 1] * fall);
  return new Tables(ratios.map((ratio) => ratio / (1 - ratio)), 1);
}

/** The numbers of bits in the queues (LEB128), and where the next byte is. */
function readLengths(bytes, what) {
  const lengths = [];
  let number = 0, unit = 1;
  for (let place = 0; place < Math.min(bytes.length, 10 * QUEUES); place++) {
    number += (bytes[place] & 127) * unit;
    unit *= 128;
    if (bytes[place] < 128) {
      lengths.push(number);
      if (lengths.length === QUEUES) return { lengths, start: place + 1 };
      [number, unit] = [0, 1];
    }
  }
  throw new MixseqError(`the bits of ${what} end early; the file is damaged`);
}
