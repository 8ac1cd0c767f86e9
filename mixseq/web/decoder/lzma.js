// Bytes that LZMA2 has compressed, without a header (the format of Igor Pavlov, as xz has it in its blocks).
import { MixseqError } from "./errors.js";

const POSITIONS = 16, STATES = 12, FIRST_LITERALS = 7; // states below were reached by a literal
const damaged = () => new MixseqError("compressed bytes are damaged");

/** The bytes that were compressed, at most `limit`. */
export function unpackLzma2(data, limit) {
  const chunks = chunksOf(data), size = chunks.reduce((sum, chunk) => sum + chunk.size, 0);
  if (size > limit) throw new MixseqError(`${size} bytes are more than there can be; the file is damaged`);
  const out = new Uint8Array(size);
  let at = 0, coder = null, properties = 255, begin = 0; // where the dictionary begins
  for (const { control, start, size, packed } of chunks) {
    if (control === 1 || control >= 0xe0) begin = at;
    if (control < 0x80) out.set(data.subarray(start, start + size), at);
    else {
      const reset = (control >> 5) & 3;
      if (reset > 1) properties = data[start - 1];
      if (properties > 224 || properties % 9 + (Math.floor(properties / 9) % 5) > 4 || (!reset && !coder)) throw damaged();
      if (reset) coder = newCoder(out, properties);
      coder(data.subarray(start, start + packed), begin, at, at + size);
    }
    at += size;
  }
  return out;
}

/** What the chunks are: their control bytes, where their bytes are, and how many they make. */
function chunksOf(data) {
  const chunks = [];
  for (let place = 0; ; ) {
    const control = data[place], packs = control >= 0x80, size = ((packs ? control & 31 : 0) << 16) + (data[place + 1] << 8) + data[place + 2] + 1;
    if (control === 0) return chunks;
    const start = place + (packs ? 5 + (control >= 0xc0 ? 1 : 0) : 3), packed = packs ? (data[place + 3] << 8) + data[place + 4] + 1 : size;
    place = start + packed;
    if (!(place < data.length) || (!packs && control > 2)) throw damaged();
    chunks.push({ control, start, size, packed });
  }
}

/** Decode chunks that go on with each other: returns `decode(input, begin, at, end)`, which fills `out` from `at` to `end`. */
function newCoder(out, properties) {
  const lc = properties % 9, lp = Math.floor(properties / 9) % 5, pb = Math.floor(properties / 45);
  const chances = (count) => new Uint16Array(count).fill(1024), lengths = () => ({ choices: chances(2), low: chances(POSITIONS * 8), middle: chances(POSITIONS * 8), high: chances(256) });
  const isMatch = chances(STATES * POSITIONS), isRepeat = chances(STATES), isShort = chances(STATES * POSITIONS), repeats = [chances(STATES), chances(STATES), chances(STATES)];
  const literals = chances(0x300 << (lc + lp)), slots = chances(4 * 64), far = chances(128), aligned = chances(16), matched = lengths(), repeated = lengths();
  let state = 0, distances = [0, 0, 0, 0], input, place, range, code;

  function normalise() {
    if (range >= 2 ** 24) return;
    if (place >= input.length) throw damaged();
    range = (range << 8) >>> 0;
    code = ((code << 8) | input[place++]) >>> 0;
  }

  function bit(table, index) {
    normalise();
    const chance = table[index], bound = (range >>> 11) * chance;
    if (code < bound) {
      range = bound;
      table[index] += (2048 - chance) >> 5;
      return 0;
    }
    range -= bound;
    code -= bound;
    table[index] -= chance >> 5;
    return 1;
  }

  function tree(table, first, bits) {
    let node = 1;
    for (let k = 0; k < bits; k++) node = 2 * node + bit(table, first + node);
    return node - (1 << bits);
  }

  function reversed(table, first, bits) {
    let node = 1, value = 0;
    for (let k = 0; k < bits; k++) {
      const one = bit(table, first + node);
      node = 2 * node + one;
      value |= one << k;
    }
    return value;
  }

  function plain(bits) {
    let value = 0;
    for (let k = 0; k < bits; k++) {
      normalise();
      range >>>= 1;
      const one = code >= range ? 1 : 0;
      code -= one * range;
      value = 2 * value + one;
    }
    return value;
  }

  function length({ choices, low, middle, high }, position) {
    if (!bit(choices, 0)) return 2 + tree(low, 8 * position, 3);
    return bit(choices, 1) ? 18 + tree(high, 0, 8) : 10 + tree(middle, 8 * position, 3);
  }

  function distance(count) {
    const slot = tree(slots, 64 * Math.min(count - 2, 3), 6), bits = (slot >> 1) - 1;
    if (slot < 4) return slot;
    const first = (2 + (slot & 1)) * 2 ** bits;
    return first + (slot < 14 ? reversed(far, first - slot, bits) : plain(bits - 4) * 16 + reversed(aligned, 0, 4));
  }

  function literal(at, begin) {
    const before = at > begin ? out[at - 1] : 0, first = 0x300 * ((((at - begin) & ((1 << lp) - 1)) << lc) + (before >> (8 - lc)));
    let node = 1;
    if (state >= FIRST_LITERALS) {
      let same = out[at - distances[0] - 1];
      for (let offset = 0x100; node < 0x100; ) {
        same <<= 1;
        const expected = same & offset, one = bit(literals, first + offset + expected + node);
        node = 2 * node + one;
        offset = one ? expected : offset - expected;
      }
    }
    while (node < 0x100) node = 2 * node + bit(literals, first + node);
    out[at] = node;
    state = state < 4 ? 0 : state < 10 ? state - 3 : state - 6;
  }

  return function decode(given, begin, at, end) {
    [input, place, range, code] = [given, 5, 2 ** 32 - 1, ((given[1] << 24) | (given[2] << 16) | (given[3] << 8) | given[4]) >>> 0];
    if (given.length < 5) throw damaged();
    while (at < end) {
      const position = (at - begin) & ((1 << pb) - 1), here = state * POSITIONS + position, literalState = state < FIRST_LITERALS;
      if (!bit(isMatch, here)) {
        literal(at++, begin);
        continue;
      }
      let count, again = 0;
      if (!bit(isRepeat, state)) {
        count = length(matched, position);
        distances = [distance(count), ...distances.slice(0, 3)];
        state = literalState ? 7 : 10;
      } else {
        while (again < 3 && bit(repeats[again], state)) again++;
        if (!again && !bit(isShort, here)) {
          count = 1;
          state = literalState ? 9 : 11;
        } else {
          distances.unshift(...distances.splice(again, 1));
          count = length(repeated, position);
          state = literalState ? 8 : 11;
        }
      }
      if (distances[0] >= at - begin || at + count > end) throw damaged();
      for (const stop = at + count; at < stop; at++) out[at] = out[at - distances[0] - 1];
    }
  };
}
