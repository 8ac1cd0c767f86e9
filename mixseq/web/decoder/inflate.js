// Bytes that zlib has compressed (RFC 1950 and 1951).
import { MixseqError } from "./errors.js";

const ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/** The `size` bytes that were compressed. */
export function inflated(data, size) {
  const found = new Uint8Array(size);
  let place = 2, bit = 0, count = 0, last = 0;
  const damaged = () => new MixseqError("compressed bytes are damaged");
  const bits = (number) => {
    let value = 0;
    for (let k = 0; k < number; k++) {
      if (place >= data.length) throw damaged();
      value |= ((data[place] >> bit) & 1) << k;
      bit = (bit + 1) & 7;
      if (!bit) place++;
    }
    return value;
  };
  const put = (byte) => {
    if (count === size) throw damaged();
    found[count++] = byte;
  };
  const symbol = ({ counts, symbols }) => {
    for (let length = 1, code = 0, first = 0, index = 0; length < 16; length++) {
      code |= bits(1);
      if (code - first < counts[length]) return symbols[index + code - first];
      index += counts[length];
      first = (first + counts[length]) << 1;
      code <<= 1;
    }
    throw damaged();
  };
  // How far a symbol's range begins, and its extra bits: 4 or 2 symbols for every number of bits.
  const extended = (base, number, per) => {
    const extra = number < per ? 0 : Math.floor(number / per) - 1;
    return base + (extra ? ((per + (number % per)) << extra) : number) + bits(extra);
  };
  while (!last) {
    last = bits(1);
    const kind = bits(2);
    if (kind === 0) {
      if (bit) place += 1;
      bit = 0;
      const length = data[place] | (data[place + 1] << 8);
      place += 4;
      if (!(place + length <= data.length)) throw damaged();
      for (let k = 0; k < length; k++) put(data[place++]);
      continue;
    }
    if (kind === 3) throw damaged();
    const { literals, distances } = kind === 1 ? FIXED : codes(bits, symbol, damaged);
    for (let one = symbol(literals); one !== 256; one = symbol(literals)) {
      if (one < 256) {
        put(one);
        continue;
      }
      if (one > 285) throw damaged();
      const length = one === 285 ? 258 : extended(3, one - 257, 4), far = symbol(distances);
      const distance = extended(1, far, 2);
      if (far > 29 || distance > count) throw damaged();
      for (let k = 0; k < length; k++) put(found[count - distance]);
    }
  }
  const end = new DataView(data.buffer, data.byteOffset, data.length), checked = place + (bit ? 1 : 0);
  if (count !== size || checked + 4 > data.length || end.getUint32(checked) !== adler32(found)) throw damaged();
  return found;
}

function adler32(bytes) {
  let low = 1, high = 0;
  for (const byte of bytes) {
    low = (low + byte) % 65521;
    high = (high + low) % 65521;
  }
  return high * 65536 + low;
}

const FIXED = {
  literals: code(Array.from({ length: 288 }, (_, k) => (k < 144 ? 8 : k < 256 ? 9 : k < 280 ? 7 : 8))),
  distances: code(new Array(30).fill(5)),
};

/** Huffman's code of symbols with so many bits: how many have each number of bits, and the symbols in order. */
function code(lengths) {
  const counts = new Array(16).fill(0), symbols = [];
  for (let length = 1; length < 16; length++) {
    lengths.forEach((own, one) => {
      if (own !== length) return;
      counts[length]++;
      symbols.push(one);
    });
  }
  return { counts, symbols };
}

function codes(bits, symbol, damaged) {
  const literals = bits(5) + 257, all = literals + bits(5) + 1, number = bits(4) + 4, short = new Array(19).fill(0);
  for (let k = 0; k < number; k++) short[ORDER[k]] = bits(3);
  const of = code(short), lengths = [];
  while (lengths.length < all) {
    const one = symbol(of);
    if (one < 16) lengths.push(one);
    else {
      if (one === 16 && !lengths.length) throw damaged();
      const again = one === 16 ? lengths[lengths.length - 1] : 0, times = one === 18 ? bits(7) + 11 : bits(one - 14) + 3;
      for (let k = 0; k < times; k++) lengths.push(again);
    }
  }
  if (lengths.length > all) throw damaged();
  return { literals: code(lengths.slice(0, literals)), distances: code(lengths.slice(literals)) };
}
