// Range coding by constriction, as mixseq/coding/bitstream/entropy.py reads it: symbols of models that are 24 bits fine.
import { MixseqError } from "./errors.js";

const WORD = 2 ** 32, WHOLE = 2 ** 24;

/**
 * Read coded symbols of bytes: returns `next(lefts)`, which gives the symbol s whose share is from `lefts[s]` to `lefts[s + 1]`;
 * the first left is 0, the last one 2^24.
 *
 * The state is two numbers of 64 bits, as doubles of 32 bits each, the upper one first: the range, and how far the code is
 * above its low end. Behind these is a product.
 */
export function symbolReader(bytes) {
  if (bytes.length % 4) throw new MixseqError("coded numbers end within a word; the file is damaged");
  const words = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength), state = new Float64Array(6);
  let place = 0;
  state.set([WORD - 1, WORD - 1, nextWord(), nextWord()]);

  function nextWord() {
    place += 4;
    return place > words.byteLength ? 0 : words.getUint32(place - 4, true); // words after the end are 0
  }

  return function next(lefts) {
    const last = lefts.length - 2, scale = state[0] * 256 + Math.floor(state[1] / WHOLE), quotient = (state[2] * WORD + state[3]) / scale;
    let symbol = 0, high, low;
    while (symbol < last && lefts[symbol + 1] <= quotient) symbol++;
    for (;;) {
      multiply(scale, lefts[symbol]);
      high = state[2] - state[4];
      low = state[3] - state[5];
      if (low < 0) [high, low] = [high - 1, low + WORD];
      multiply(scale, lefts[symbol + 1] - lefts[symbol]);
      if (high < 0) symbol--; // the quotient was rounded
      else if (high < state[4] || (high === state[4] && low < state[5])) break;
      else if (++symbol > last) throw new MixseqError("coded numbers are damaged");
    }
    const more = !state[4]; // the range is small
    state[0] = more ? state[5] : state[4];
    state[1] = more ? 0 : state[5];
    state[2] = more ? low : high;
    state[3] = more ? nextWord() : low;
    return symbol;
  };

  function multiply(scale, number) {
    const first = Math.floor(scale / 65536), part = first * number, high = Math.floor(part / 65536);
    const low = (part - high * 65536) * 65536 + (scale - first * 65536) * number, carry = Math.floor(low / WORD);
    state[4] = high + carry;
    state[5] = low - carry * WORD;
  }
}

/** Tables of counts that learn, one row for every context, of numbers up to a magnitude; the last symbol stands for larger ones. */
export class Tables {
  constructor(magnitudes, largest) {
    this.size = 2 * largest + 2;
    this.counts = new Float64Array(this.size * magnitudes.length).fill(1);
    magnitudes.forEach((magnitude, context) => {
      const ratio = magnitude / (1 + magnitude), powers = [1];
      for (let n = 1; n <= largest; n++) powers.push(powers[n - 1] * ratio);
      const shares = [...powers.slice(1).reverse(), ...powers], whole = shares.reduce((sum, share) => sum + share, 0);
      shares.forEach((share, symbol) => (this.counts[context * this.size + symbol] += Math.floor((512 * share) / whole)));
    });
  }

  /** The lefts of the symbols in a context, for `symbolReader`. */
  lefts(context) {
    const row = this.counts.subarray(context * this.size, (context + 1) * this.size);
    const total = row.reduce((sum, count) => sum + count, 0), shares = Array.from(row, (count) => count / total);
    const scale = (WHOLE - this.size) / shares.reduce((sum, share) => sum + share, 0), lefts = new Float64Array(this.size + 1);
    let sum = 0;
    shares.forEach((share, symbol) => {
      lefts[symbol] = Math.floor(sum * scale) + symbol;
      sum += share;
    });
    lefts[this.size] = WHOLE;
    return lefts;
  }

  /** Count that a symbol came so many times in a context. */
  add(context, symbol, times) {
    this.counts[context * this.size + symbol] += 64 * times;
  }

  /** Halve the counts of contexts that have too many. */
  forget() {
    for (let start = 0; start < this.counts.length; start += this.size) {
      const row = this.counts.subarray(start, start + this.size);
      while (row.reduce((sum, count) => sum + count, 0) > 64 * 2048) row.forEach((count, k) => (row[k] = Math.floor((count + 1) / 2)));
    }
  }
}
