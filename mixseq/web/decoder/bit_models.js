// Probabilities of bits, mixed from several contexts in the logistic domain. Mirrors mixseq/compression/bitstream/arithmetic.py.

const MAX_LOGIT = 2047; // largest magnitude of x, in units of 2^-8
const MAX_FREQUENCY_COUNT = 255; // largest count in the running mean of a frequency
const LEARNING_RATE = 48; // of weights, in 1 / 4096 of x's and p's units
const MIN_PROBABILITY = 16; // smallest probability of either bit, in 65536ths

const { stretch: STRETCH, squash: SQUASH } = logisticTables();
for (let x = 0; x < SQUASH.length; x++) SQUASH[x] = Math.min(Math.max(SQUASH[x], MIN_PROBABILITY), 65536 - MIN_PROBABILITY);
const RATES = Int32Array.from({ length: MAX_FREQUENCY_COUNT + 1 }, (_, count) => Math.floor((1 << 17) / (2 * count + 3)));
const CONFIDENCES = Int32Array.from({ length: MAX_FREQUENCY_COUNT + 1 }, (_, count) => Math.floor((256 * count) / (count + 1)));

/**
 * Frequencies and mixing weights of bits. The `contexts` of the inputs are set before every bit. Every one of the `kinds`
 * has weights; by default kinds are positions.
 */
export class BitModels {
  constructor(inputs, contexts, positions, kinds = positions) {
    this.positions = positions;
    this.width = contexts * positions; // of the rows of an input
    this.frequencies = new Int32Array(inputs * this.width).fill(1 << 23); // 256 p + n
    this.weights = new Float64Array(kinds * inputs).fill(Math.floor((65536 + (inputs >> 1)) / inputs));
    this.contexts = new Int32Array(inputs);
    this.inputs = new Int32Array(inputs); // x of the current bit
    this.places = new Int32Array(inputs); // of its frequencies
  }

  /** Read a bit of a kind at a position, and update the models. */
  read(stream, position, kind = position) {
    const { frequencies, weights, contexts, inputs, places, positions, width } = this;
    const count = inputs.length, own = kind * count;
    let sum = 0; // may have more than 32 bits
    for (let i = 0, first = position; i < count; i++, first += width) {
      const place = first + contexts[i] * positions, frequency = frequencies[place];
      const x = (STRETCH[frequency >> 12] * CONFIDENCES[frequency & 255]) >> 8;
      places[i] = place;
      inputs[i] = x;
      sum += weights[own + i] * x;
    }
    const x = sum >= MAX_LOGIT * 65536 ? MAX_LOGIT : sum < -MAX_LOGIT * 65536 ? -MAX_LOGIT : sum >> 16;
    const probability = SQUASH[x + MAX_LOGIT], bit = stream.read(probability);
    const error = ((bit << 16) - probability) >> 4, aim = (bit << 16) - bit;
    for (let i = 0; i < count; i++) {
      weights[own + i] += (Math.imul(inputs[i], error) * LEARNING_RATE + 32768) >> 16;
      const place = places[i], frequency = frequencies[place], seenCount = frequency & 255;
      // The product has 32 bits: p is 32768 where the step is largest.
      const p = (frequency >> 8) + (Math.imul(aim - (frequency >> 8), RATES[seenCount]) >> 16);
      frequencies[place] = (p << 8) + (seenCount < MAX_FREQUENCY_COUNT ? seenCount + 1 : seenCount);
    }
    return bit;
  }
}

/** Tables of x by p in units of 2^-12, and of p in units of 2^-16 by x from -MAX_LOGIT to MAX_LOGIT. */
function logisticTables() {
  const growth = new Float64Array(2 * MAX_LOGIT + 1).fill(1), squash = new Int32Array(2 * MAX_LOGIT + 1), stretch = new Int32Array(4096);
  for (let x = 0; x < MAX_LOGIT; x++) growth[MAX_LOGIT + x + 1] = growth[MAX_LOGIT + x] * 1.0039138893383475; // near exp(1 / 256)
  for (let x = 1; x <= MAX_LOGIT; x++) growth[MAX_LOGIT - x] = 1 / growth[MAX_LOGIT + x];
  growth.forEach((g, k) => (squash[k] = Math.floor(65536 * (g / (1 + g)))));
  let x = 0;
  for (let p = 0; p < 4096; p++) {
    while (x < 2 * MAX_LOGIT && squash[x] < 16 * p + 8) x++;
    stretch[p] = x - MAX_LOGIT;
  }
  return { stretch, squash };
}
