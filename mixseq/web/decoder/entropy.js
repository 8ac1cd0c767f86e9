// Range coding by constriction, as mixseq/coding/bitstream/entropy.py reads it: symbols of models that are 24 bits fine.
import { MixseqError } from "./errors.js";

const WORD = 2 ** 32, WHOLE = 2 ** 24;

/**
 * Read coded symbols of bytes: returns `next(lefts)`, which gives the symbol s whose share is from `lefts[s]` to `lefts[s + 1]`;
 * the first left is 0, the last one 2^24.
 *
 * The state is two numbers of 64 bits, each as two doubles of 32 bits: the range, and where the code is above its low end.
 */
export function symbolReader(bytes) {
  if (bytes.length % 4) throw new MixseqError("coded numbers end within a word; the file is damaged");
  const words = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let place = 0, rangeHigh = WORD - 1, rangeLow = WORD - 1;
  let high = nextWord(), low = nextWord();

  function nextWord() {
    const word = place < words.byteLength ? words.getUint32(place, true) : 0; // words after the end are 0
    place += 4;
    return word;
  }

  return function next(lefts) {
    const scale = rangeHigh * 256 + Math.floor(rangeLow / WHOLE), quotient = (high * WORD + low) / scale;
    let symbol = 0;
    while (symbol < lefts.length - 2 && lefts[symbol + 1] <= quotient) symbol++;
    if (isBelow(scale, lefts[symbol])) symbol--; // the quotient was rounded
    else if (!isBelow(scale, lefts[symbol + 1])) symbol++;
    if (symbol > lefts.length - 2) throw new MixseqError("coded numbers are damaged");
    const left = lefts[symbol], width = lefts[symbol + 1] - left, lowest = lowOf(scale, left), borrow = low < lowest ? 1 : 0;
    high -= highOf(scale, left) + borrow;
    low += borrow * WORD - lowest;
    rangeHigh = highOf(scale, width);
    rangeLow = lowOf(scale, width);
    if (!rangeHigh) {
      [rangeHigh, rangeLow] = [rangeLow, 0];
      [high, low] = [low, nextWord()];
    }
    return symbol;
  };

  /** Whether the code is below the product of a number below 2^40 and one up to 2^24. */
  function isBelow(scale, number) {
    const above = highOf(scale, number);
    return high < above || (high === above && low < lowOf(scale, number));
  }
}

/** The bits of a product from the 32nd on. */
function highOf(scale, number) {
  const first = Math.floor(scale / 65536) * number;
  return Math.floor(first / 65536) + Math.floor(((first % 65536) * 65536 + (scale % 65536) * number) / WORD);
}

/** The 32 lowest bits of a product. */
function lowOf(scale, number) {
  const first = Math.floor(scale / 65536) * number;
  return ((first % 65536) * 65536 + (scale % 65536) * number) % WORD;
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
