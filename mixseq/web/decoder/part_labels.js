// Which part of the mesh every vertex belongs to. Mirrors coding/bitstream/part_labels.py.
import { BitModels } from "./bit_models.js";
import { MixseqError } from "./errors.js";
import { MOST } from "./signal_graph_kernels.js";

const BITS = 7; // of a label
const VOTES = MOST + 1; // numbers of neighbours, from none on

/** The labels of all vertices, of so many parts. */
export function readLabels(reader, number, { order, width, neighbours, counts }) {
  const models = new BitModels(2, VOTES * VOTES, 2 + (1 << BITS)), bits = reader.bits();
  const nodes = new Int32Array(order.length), labels = new Int32Array(order.length), votes = new Int32Array(1 << BITS);
  for (let node = 0; node < order.length; node++) {
    const first = node * width, last = first + counts[node] - 1;
    for (let at = first; at <= last; at++) votes[nodes[neighbours[at]]]++;
    const one = winner(nodes, neighbours, first, last, votes, -1), other = winner(nodes, neighbours, first, last, votes, one), most = one < 0 ? 0 : votes[one];
    models.contexts[0] = most * VOTES + (other < 0 ? 0 : votes[other]);
    models.contexts[1] = most * VOTES + counts[node];
    for (let at = first; at <= last; at++) votes[nodes[neighbours[at]]] = 0;
    if (one >= 0 && models.read(bits, 0)) nodes[node] = one;
    else if (other >= 0 && models.read(bits, 1)) nodes[node] = other;
    else {
      models.contexts.fill(0);
      let found = 1;
      for (let bit = 0; bit < BITS; bit++) found = 2 * found + models.read(bits, 1 + found);
      nodes[node] = found - (1 << BITS);
    }
  }
  reader.checked(nodes);
  const used = new Set(nodes);
  if (used.size !== number || Math.max(...used) >= number) throw new MixseqError("labels are not those of the parts; it is damaged");
  for (let node = 0; node < order.length; node++) labels[order[node]] = nodes[node];
  return labels;
}

/** The label with most votes of neighbours, but for one; of equally many votes those of the nearest neighbour, the last one, count. */
function winner(nodes, neighbours, first, last, votes, without) {
  let best = -1;
  for (let at = last; at >= first; at--) {
    const label = nodes[neighbours[at]];
    if (label !== without && (best < 0 || votes[label] > votes[best])) best = label;
  }
  return best;
}
