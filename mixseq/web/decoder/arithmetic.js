// Arithmetic decoding: bits from bytes, by their probabilities. Mirrors mixseq/compression/bitstream/arithmetic.py.

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
