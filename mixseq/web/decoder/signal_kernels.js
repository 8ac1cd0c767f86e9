// One signal, node by node. Mirrors coding/bitstream/signal_kernels.py.
import { UNIT, predict } from "./predictor_kernels.js";

const LEVELS = 32; // of sizes, two in an octave
const FINE_LEVELS = 55; // the last of them, four in an octave
const DEPTHS = 18; // numbers of bits of a node's number
const AGES = 8; // levels of how many signals were before
const LONGEST = 24, MOST = 55; // bits of a number that have models; at most
const LARGEST = 2 ** 40; // larger sizes count as this

export const INPUTS = 5;
export const CONTEXTS = LEVELS * LEVELS;
export const POSITIONS = 2 * LONGEST;

const POWERS = new Float64Array(MOST).fill(1);
for (let bits = 1; bits < MOST; bits++) POWERS[bits] = 2 * POWERS[bits - 1];

/**
 * Read a signal: a number for every node, and the value that it makes. `numbers` are those of the signal before, which
 * those of this one replace; `activity` and `around` are sizes of the numbers of earlier signals, here and beside.
 */
export function readSignal(bits, models, known, { from, values, steps }, numbers, activity, around) {
  const { width, neighbours, counts } = from, contexts = models.contexts, age = Math.min(level(known), AGES - 1);
  for (let node = 0, depth = 0; node < values.length; node++) {
    while (depth < DEPTHS - 1 && node >> depth) depth++;
    const count = counts[node], active = activity[node];
    let size = active;
    if (count) {
      let total = 0;
      for (let at = node * width, end = at + count; at < end; at++) total += magnitude(numbers[neighbours[at]]);
      size = Math.floor((UNIT * total) / count);
    }
    const expected = Math.floor((205 * size + 102 * active + 38 * around[node]) / 256);
    const here = level(size) * LEVELS, beside = level(active);
    contexts[0] = here + beside;
    contexts[1] = beside * LEVELS + level(around[node]);
    contexts[2] = fineLevel(expected) * DEPTHS + depth;
    contexts[3] = here + level(UNIT * magnitude(numbers[node]));
    contexts[4] = level(expected) * AGES + age;
    const number = readSigned(bits, models);
    numbers[node] = number;
    values[node] = predict(node, from, values) + steps[node] * number;
  }
}

/** A number: how many bits it has, the highest of those after the first, the others, and the sign. */
function readSigned(bits, models) {
  let size = 0, value = 1;
  while (size < LONGEST && models.read(bits, size)) size++;
  if (size === LONGEST) while (size < MOST && bits.number(1)) size++;
  if (size === 0) return 0;
  if (size > 1) {
    const top = models.read(bits, LONGEST + Math.min(size, LONGEST) - 2);
    value = (2 + top) * POWERS[size - 2] + bits.number(size - 2);
  }
  return bits.number(1) ? -value : value;
}

const magnitude = (number) => Math.min(Math.abs(number), LARGEST);

/** The level of a size in 1 / 64 steps, two in an octave. */
function level(size) {
  if (size < 2) return size;
  if (size >= 65536) return LEVELS - 1;
  const bits = 32 - Math.clz32(size);
  return 2 * (bits - 1) + ((size >> (bits - 2)) & 1);
}

/** The same, four in an octave. */
function fineLevel(size) {
  if (size < 4) return size;
  if (size >= 32768) return FINE_LEVELS;
  const bits = 32 - Math.clz32(size);
  return 4 * (bits - 2) + ((size >> (bits - 3)) & 3);
}

/** Add the sizes of a signal's numbers to the activity, and write its means over rings. */
export function learnSizes(numbers, { ring, ringStarts }, activity, around) {
  for (let node = 0; node < numbers.length; node++) {
    activity[node] = Math.floor((102 * activity[node] + 154 * UNIT * magnitude(numbers[node])) / 256);
  }
  for (let node = 0; node < numbers.length; node++) {
    const first = ringStarts[node], last = ringStarts[node + 1];
    let total = 0;
    for (let place = first; place < last; place++) total += activity[ring[place]];
    around[node] = last > first ? Math.floor(total / (last - first)) : 0;
  }
}
