// The residuals of a frame, node by node. Mirrors coding/bitstream/residual_kernels.py.
import { BitModels } from "./bit_models.js";
import { MOST as NEIGHBOURS } from "./signal_graph_kernels.js";

const VOTES = NEIGHBOURS + 1; // numbers of neighbours, from none on
const LONGEST = 8, MOST = 62; // numbers up to this have models; bits of what is beyond, at most
const INPUTS = 3, CONTEXTS = 3 * VOTES * VOTES, POSITIONS = 4 + LONGEST;

/** What is known of a run's bits. */
export const residualModels = () => new BitModels(INPUTS, CONTEXTS, POSITIONS);

/** A frame without residuals: `numbers` (N x 3) of nodes, and which of them are `displaced`. */
export const emptyFrame = (size) => ({ numbers: new Float64Array(3 * size), displaced: new Uint8Array(size) });

/** Read a frame, when the frame before, `last`, is known. */
export function readFrame(bits, models, { width, neighbours, counts, ring, ringStarts }, last) {
  const contexts = models.contexts.fill(0), frame = emptyFrame(counts.length), { numbers, displaced } = frame;
  if (!models.read(bits, 0)) return frame;
  const sums = new Int32Array(3);
  for (let node = 0; node < counts.length; node++) {
    const count = counts[node], own = last.displaced[node];
    let votes = 0, before = 0, known = 0;
    sums.fill(0);
    for (let at = node * width, end = at + count; at < end; at++) {
      const beside = neighbours[at];
      if (!displaced[beside]) continue;
      votes++;
      for (let k = 0; k < 3; k++) sums[k] += Math.sign(numbers[3 * beside + k]);
    }
    for (let place = ringStarts[node]; place < ringStarts[node + 1]; place++) before += last.displaced[ring[place]];
    const was = own ? 2 : Math.min(before, 1);
    contexts[0] = (votes * VOTES + count) * 3 + was;
    contexts[1] = (Math.min(before, VOTES - 1) * VOTES + Math.min(votes, 3)) * 2 + own;
    contexts[2] = Math.min(votes, 3) * 3 + was;
    if (!models.read(bits, 1)) continue;
    for (let k = 0; k < 3; k++) {
      const here = limited(last.numbers[3 * node + k]) + 3, around = limited(sums[k]) + 3;
      contexts[0] = here * 7 + around;
      contexts[1] = (known * 7 + around) * 3 + k;
      contexts[2] = (known * 7 + here) * 3 + k;
      const number = readCoordinate(bits, models);
      numbers[3 * node + k] = number;
      if (number) known |= 1 << k;
    }
    displaced[node] = known ? 1 : 0;
  }
  return frame;
}

function readCoordinate(bits, models) {
  if (!models.read(bits, 2)) return 0;
  const negative = models.read(bits, 3);
  let found = 0;
  while (found < LONGEST && models.read(bits, 4 + found)) found++;
  if (found === LONGEST) {
    let length = 0;
    while (length < MOST && bits.number(1)) length++;
    found += bits.number(length);
  }
  return negative ? -(found + 1) : found + 1;
}

const limited = (number) => Math.min(Math.max(number, -3), 3);
