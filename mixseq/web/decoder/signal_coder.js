// Read signals over a graph: basis vectors over a mesh, coefficients over time. Mirrors
// mixseq/compression/bitstream/signal_coder.py.
import { BitModels, BitStream, checksumOf, splitChecksum, verifyChecksum } from "./arithmetic.js";
import { MixseqError } from "./errors.js";
import { Predictor } from "./predictor.js";
import { UNITS_PER_STEP, predict } from "./predictor_kernels.js";

const SIZE_LEVELS = 32; // levels of sizes, two per octave
const MAX_FINE_LEVEL = 55; // the largest level of sizes, four per octave
const DEPTH_CLASSES = 18; // node classes, by bit length of the node number
const AGE_CLASSES = 8; // signal classes, by the number of earlier signals
const MAX_MODELLED_BITS = 24, MAX_NUMBER_BITS = 55; // largest bit length with models; largest bit length
const MAX_SIZE = 2 ** 40; // upper bound to which sizes are clamped

export const CONTEXTS_PER_BIT = 5;
export const CONTEXT_VALUES = SIZE_LEVELS * SIZE_LEVELS;
export const POSITION_COUNT = 2 * MAX_MODELLED_BITS;

const POWERS = new Float64Array(MAX_NUMBER_BITS).fill(1);
for (let stream = 1; stream < MAX_NUMBER_BITS; stream++) POWERS[stream] = 2 * POWERS[stream - 1];

/**
 * Read a signal: the numbers of all nodes, and their values. `numbers` of the previous signal are replaced; `activity` and
 * `ringActivity` are sizes of the numbers of earlier signals, at the node and at adjacent nodes.
 */
function readSignal(stream, models, signalCount, { stencil, values, steps }, numbers, activity, ringActivity) {
  const { width, neighbours, counts } = stencil, contexts = models.contexts, age = Math.min(sizeLevel(signalCount), AGE_CLASSES - 1);
  for (let node = 0, depth = 0; node < values.length; node++) {
    while (depth < DEPTH_CLASSES - 1 && node >> depth) depth++;
    const count = counts[node], own = activity[node];
    let size = own;
    if (count) {
      let total = 0;
      for (let at = node * width, end = at + count; at < end; at++) total += magnitude(numbers[neighbours[at]]);
      size = Math.floor((UNITS_PER_STEP * total) / count);
    }
    const expected = Math.floor((205 * size + 102 * own + 38 * ringActivity[node]) / 256);
    const here = sizeLevel(size) * SIZE_LEVELS, ownLevel = sizeLevel(own);
    contexts[0] = here + ownLevel;
    contexts[1] = ownLevel * SIZE_LEVELS + sizeLevel(ringActivity[node]);
    contexts[2] = fineSizeLevel(expected) * DEPTH_CLASSES + depth;
    contexts[3] = here + sizeLevel(UNITS_PER_STEP * magnitude(numbers[node]));
    contexts[4] = sizeLevel(expected) * AGE_CLASSES + age;
    const number = readSignedNumber(stream, models);
    numbers[node] = number;
    values[node] = predict(node, stencil, values) + steps[node] * number;
  }
}

/** Read a number: bit length, highest of the bits after the first, the other bits, sign. */
function readSignedNumber(stream, models) {
  let size = 0, value = 1;
  while (size < MAX_MODELLED_BITS && models.read(stream, size)) size++;
  if (size === MAX_MODELLED_BITS) while (size < MAX_NUMBER_BITS && stream.rawBits(1)) size++;
  if (size === 0) return 0;
  if (size > 1) {
    const top = models.read(stream, MAX_MODELLED_BITS + Math.min(size, MAX_MODELLED_BITS) - 2);
    value = (2 + top) * POWERS[size - 2] + stream.rawBits(size - 2);
  }
  return stream.rawBits(1) ? -value : value;
}

const magnitude = (number) => Math.min(Math.abs(number), MAX_SIZE);

/** The level of a size in 1 / 64 steps, two per octave. */
function sizeLevel(size) {
  if (size < 2) return size;
  if (size >= 65536) return SIZE_LEVELS - 1;
  const stream = 32 - Math.clz32(size);
  return 2 * (stream - 1) + ((size >> (stream - 2)) & 1);
}

/** The same, four per octave. */
function fineSizeLevel(size) {
  if (size < 4) return size;
  if (size >= 32768) return MAX_FINE_LEVEL;
  const stream = 32 - Math.clz32(size);
  return 4 * (stream - 2) + ((size >> (stream - 3)) & 3);
}

/** Update the activity with a signal's numbers, and write its means over rings. */
function updateActivity(numbers, { ring, ringStarts }, activity, ringActivity) {
  for (let node = 0; node < numbers.length; node++) {
    activity[node] = Math.floor((102 * activity[node] + 154 * UNITS_PER_STEP * magnitude(numbers[node])) / 256);
  }
  for (let node = 0; node < numbers.length; node++) {
    const first = ringStarts[node], last = ringStarts[node + 1];
    let total = 0;
    for (let place = first; place < last; place++) total += activity[ring[place]];
    ringActivity[node] = last > first ? Math.floor(total / (last - first)) : 0;
  }
}

/** A stream, and the checksum of its decoded values. */
export class Reader {
  #stream;

  constructor(stream) {
    const { data, expected } = splitChecksum(stream);
    this.#stream = new BitStream(data);
    this.expected = expected;
    this.checksum = 0;
  }

  /** The stream; it must not have ended. */
  stream() {
    if (this.#stream.isPastEnd()) throw new MixseqError("the coded signals are damaged, they end early");
    return this.#stream;
  }

  /** Add decoded values to the checksum. */
  addToChecksum(numbers) {
    this.checksum = checksumOf(numbers, this.checksum);
  }

  /** Verify that the decoded values are those that were written. */
  finish() {
    verifyChecksum(this.checksum, this.expected);
  }
}

/** Models of the bits of numbers; coders of several graphs can share them. */
export const newNumberModels = () => new BitModels(CONTEXTS_PER_BIT, CONTEXT_VALUES, POSITION_COUNT);

/** Reads signals over a graph; `coordinates` of them belong together. */
export class SignalCoder {
  constructor(graph, stencil, coordinates, models) {
    const size = graph.order.length;
    this.graph = graph;
    this.models = models;
    this.predictor = new Predictor(graph, stencil, coordinates);
    this.numbers = new Float64Array(size);
    this.activity = new Float64Array(size);
    this.ringActivity = new Float64Array(size);
    this.signalCount = 0;
  }

  /** The next signal, in 64ths of a step, in the order of vertices, or frames. */
  read(reader) {
    const { graph, predictor, numbers, activity, ringActivity } = this;
    if (this.signalCount) { // the last signal of all needs no update
      updateActivity(numbers, graph, activity, ringActivity);
      predictor.finish();
    }
    readSignal(reader.stream(), this.models, this.signalCount++, predictor, numbers, activity, ringActivity);
    reader.addToChecksum(predictor.values);
    return inOrderOf(graph.order, predictor.values);
  }
}

/** The values of nodes in the order of vertices, or frames. */
function inOrderOf(order, nodes) {
  const values = new Float64Array(nodes.length);
  for (let node = 0; node < nodes.length; node++) values[order[node]] = nodes[node];
  return values;
}
