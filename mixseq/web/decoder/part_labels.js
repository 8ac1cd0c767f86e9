// Decode the part of the mesh that every vertex belongs to. Mirrors mixseq/compression/bitstream/spatial_basis.py.
import { BitModels } from "./bit_models.js";
import { MixseqError } from "./errors.js";
import { MAX_NEIGHBOURS } from "./signal_graph_kernels.js";

const LABEL_BITS = 7; // of a label
const NEIGHBOUR_COUNTS = MAX_NEIGHBOURS + 1; // possible numbers of neighbours, from 0 on

/** Read the labels of all vertices. */
export function readLabels(reader, partCount, { order, width, neighbours, counts }) {
  const models = new BitModels(2, NEIGHBOUR_COUNTS * NEIGHBOUR_COUNTS, 2 + (1 << LABEL_BITS)), stream = reader.stream();
  const nodes = new Int32Array(order.length), labels = new Int32Array(order.length), votes = new Int32Array(1 << LABEL_BITS);
  for (let node = 0; node < order.length; node++) {
    const begin = node * width, end = begin + counts[node] - 1;
    for (let at = begin; at <= end; at++) votes[nodes[neighbours[at]]]++;
    const first = majorityLabel(nodes, neighbours, begin, end, votes, -1), second = majorityLabel(nodes, neighbours, begin, end, votes, first), firstVotes = first < 0 ? 0 : votes[first];
    models.contexts[0] = firstVotes * NEIGHBOUR_COUNTS + (second < 0 ? 0 : votes[second]);
    models.contexts[1] = firstVotes * NEIGHBOUR_COUNTS + counts[node];
    for (let at = begin; at <= end; at++) votes[nodes[neighbours[at]]] = 0;
    if (first >= 0 && models.read(stream, 0)) nodes[node] = first;
    else if (second >= 0 && models.read(stream, 1)) nodes[node] = second;
    else {
      models.contexts.fill(0);
      let prefix = 1;
      for (let bit = 0; bit < LABEL_BITS; bit++) prefix = 2 * prefix + models.read(stream, 1 + prefix);
      nodes[node] = prefix - (1 << LABEL_BITS);
    }
  }
  reader.addToChecksum(nodes);
  const used = new Set(nodes);
  if (used.size !== partCount || Math.max(...used) >= partCount) throw new MixseqError("labels are not those of the parts; it is damaged");
  for (let node = 0; node < order.length; node++) labels[order[node]] = nodes[node];
  return labels;
}

/** The label with the most votes, without one; ties go to the label of the nearest neighbour, the last one. */
function majorityLabel(nodes, neighbours, begin, end, votes, without) {
  let best = -1;
  for (let at = end; at >= begin; at--) {
    const label = nodes[neighbours[at]];
    if (label !== without && (best < 0 || votes[label] > votes[best])) best = label;
  }
  return best;
}
