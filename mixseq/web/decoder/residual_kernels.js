// The residuals of a frame, node by node. Mirrors mixseq/compression/bitstream/residual_layer.py.
import { BitModels } from "./bit_models.js";
import { MAX_NEIGHBOURS } from "./signal_graph_kernels.js";

const NEIGHBOUR_COUNTS = MAX_NEIGHBOURS + 1; // possible numbers of neighbours, from 0 on
const MAX_MODELLED_NUMBER = 8, MAX_EXCESS_BITS = 62; // largest number with models; largest bit length of the excess
const CONTEXTS_PER_BIT = 3, CONTEXT_VALUES = 3 * NEIGHBOUR_COUNTS * NEIGHBOUR_COUNTS, POSITION_COUNT = 4 + MAX_MODELLED_NUMBER;

/** Models of the bits of a run. */
export const newResidualModels = () => new BitModels(CONTEXTS_PER_BIT, CONTEXT_VALUES, POSITION_COUNT);

/** A frame without residuals: `numbers` (N x 3) of nodes, and whether they are `displaced`. */
export const emptyFrame = (size) => ({ numbers: new Float64Array(3 * size), displaced: new Uint8Array(size) });

/** Read a frame, in contexts of the last frame. */
export function readFrame(stream, models, { width, neighbours, counts, ring, ringStarts }, last) {
  const contexts = models.contexts.fill(0), frame = emptyFrame(counts.length), { numbers, displaced } = frame;
  if (!models.read(stream, 0)) return frame;
  const sums = new Int32Array(3);
  for (let node = 0; node < counts.length; node++) {
    const count = counts[node], own = last.displaced[node];
    let displacedCount = 0, lastDisplaced = 0, nonzeroAxes = 0;
    sums.fill(0);
    for (let at = node * width, end = at + count; at < end; at++) {
      const neighbour = neighbours[at];
      if (!displaced[neighbour]) continue;
      displacedCount++;
      for (let k = 0; k < 3; k++) sums[k] += Math.sign(numbers[3 * neighbour + k]);
    }
    for (let place = ringStarts[node]; place < ringStarts[node + 1]; place++) lastDisplaced += last.displaced[ring[place]];
    const around = own ? 2 : Math.min(lastDisplaced, 1);
    contexts[0] = (displacedCount * NEIGHBOUR_COUNTS + count) * 3 + around;
    contexts[1] = (Math.min(lastDisplaced, NEIGHBOUR_COUNTS - 1) * NEIGHBOUR_COUNTS + Math.min(displacedCount, 3)) * 2 + own;
    contexts[2] = Math.min(displacedCount, 3) * 3 + around;
    if (!models.read(stream, 1)) continue;
    for (let k = 0; k < 3; k++) {
      const here = clamp(last.numbers[3 * node + k]) + 3, around = clamp(sums[k]) + 3;
      contexts[0] = here * 7 + around;
      contexts[1] = (nonzeroAxes * 7 + around) * 3 + k;
      contexts[2] = (nonzeroAxes * 7 + here) * 3 + k;
      const number = readCoordinate(stream, models);
      numbers[3 * node + k] = number;
      if (number) nonzeroAxes |= 1 << k;
    }
    displaced[node] = nonzeroAxes ? 1 : 0;
  }
  return frame;
}

function readCoordinate(stream, models) {
  if (!models.read(stream, 2)) return 0;
  const negative = models.read(stream, 3);
  let value = 0;
  while (value < MAX_MODELLED_NUMBER && models.read(stream, 4 + value)) value++;
  if (value === MAX_MODELLED_NUMBER) {
    let length = 0;
    while (length < MAX_EXCESS_BITS && stream.rawBits(1)) length++;
    value += stream.rawBits(length);
  }
  return negative ? -(value + 1) : value + 1;
}

const clamp = (number) => Math.min(Math.max(number, -3), 3);
