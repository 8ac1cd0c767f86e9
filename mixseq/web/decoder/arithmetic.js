// Bytes become bits, by how likely these are (arithmetic decoding). Mirrors coding/bitstream/arithmetic.py.

const BEYOND = 8; // bytes after the end that may be asked for: they are zero

/** Reads bits from bytes. */
export class Bits {
  constructor(data) {
    this.data = data;
    this.place = 4;
    // Both ends of the interval, and the number in it.
    this.interval = Uint32Array.of(0, 0xffffffff, (data[0] << 24) | (data[1] << 16) | (data[2] << 8) | data[3]);
  }

  /** A bit that is 1 with a chance of so many 65536ths. */
  read(chance) {
    const interval = this.interval;
    let low = interval[0], high = interval[1], bit = 1;
    const range = (high - low) >>> 0;
    // floor(range chance / 65536), in 32 bits
    const part = Math.imul(range >>> 16, chance) + (Math.imul(range & 0xffff, chance) >>> 16);
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

  /** A number of so many bits of which nothing is known. */
  number(size) {
    let found = 0;
    for (let bit = 0; bit < size; bit++) found = 2 * found + this.read(32768);
    return found;
  }

  /** Whether more was read than there is. */
  isBeyond() {
    return this.place > this.data.length + BEYOND;
  }
}
