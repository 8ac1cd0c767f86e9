// How likely the next bit is, from several contexts at once (logistic mixing). Mirrors coding/bitstream/bit_models.py.

const FAR = 2047; // largest magnitude of x, in units of 2^-8
const PATIENCE = 255; // frequencies follow their last so many bits
const RATE = 48; // of weights, in 1 / 4096 of x's and p's units
const LEAST = 16; // no bit is likelier than all but so many 65536ths

const { stretch: STRETCH, squash: SQUASH } = logisticTables();
for (let x = 0; x < SQUASH.length; x++) SQUASH[x] = Math.min(Math.max(SQUASH[x], LEAST), 65536 - LEAST);
const STEPS = Int32Array.from({ length: PATIENCE + 1 }, (_, count) => Math.floor((1 << 17) / (2 * count + 3)));
const TRUST = Int32Array.from({ length: PATIENCE + 1 }, (_, count) => Math.floor((256 * count) / (count + 1)));

/**
 * What is known about bits to come; `contexts` are to be set before a bit: what the inputs know. There are as many `kinds`,
 * which have weights, as positions, unless contexts tell these apart.
 */
export class BitModels {
  constructor(inputs, contexts, positions, kinds = positions) {
    this.positions = positions;
    this.width = contexts * positions; // of an input
    this.shares = new Int32Array(inputs * this.width).fill(1 << 23); // 256 p + n
    this.weights = new Float64Array(kinds * inputs).fill(Math.floor((65536 + (inputs >> 1)) / inputs));
    this.contexts = new Int32Array(inputs);
    this.inputs = new Int32Array(inputs); // x of the current bit
    this.places = new Int32Array(inputs); // of its shares
  }

  /** Read a bit of a kind at a position, and learn from it. */
  read(bits, position, kind = position) {
    const { shares, weights, contexts, inputs, places, positions, width } = this;
    const count = inputs.length, own = kind * count;
    let sum = 0; // may have more than 32 bits
    for (let i = 0, first = position; i < count; i++, first += width) {
      const place = first + contexts[i] * positions, share = shares[place];
      const x = (STRETCH[share >> 12] * TRUST[share & 255]) >> 8;
      places[i] = place;
      inputs[i] = x;
      sum += weights[own + i] * x;
    }
    const x = sum >= FAR * 65536 ? FAR : sum < -FAR * 65536 ? -FAR : sum >> 16;
    const chance = SQUASH[x + FAR], bit = bits.read(chance);
    const error = ((bit << 16) - chance) >> 4, aim = (bit << 16) - bit;
    for (let i = 0; i < count; i++) {
      weights[own + i] += (Math.imul(inputs[i], error) * RATE + 32768) >> 16;
      const place = places[i], share = shares[place], seen = share & 255;
      // The product has 32 bits: p is 32768 where the step is largest.
      const p = (share >> 8) + (Math.imul(aim - (share >> 8), STEPS[seen]) >> 16);
      shares[place] = (p << 8) + (seen < PATIENCE ? seen + 1 : seen);
    }
    return bit;
  }
}

/** x of the chances p in units of 2^-12, and p in units of 2^-16 of x from -FAR to FAR. */
function logisticTables() {
  const growth = new Float64Array(2 * FAR + 1).fill(1), squash = new Int32Array(2 * FAR + 1), stretch = new Int32Array(4096);
  for (let x = 0; x < FAR; x++) growth[FAR + x + 1] = growth[FAR + x] * 1.0039138893383475; // near exp(1 / 256)
  for (let x = 1; x <= FAR; x++) growth[FAR - x] = 1 / growth[FAR + x];
  growth.forEach((g, k) => (squash[k] = Math.floor(65536 * (g / (1 + g)))));
  let x = 0;
  for (let p = 0; p < 4096; p++) {
    while (x < 2 * FAR && squash[x] < 16 * p + 8) x++;
    stretch[p] = x - FAR;
  }
  return { stretch, squash };
}
