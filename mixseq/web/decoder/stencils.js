// Initial weights of signals over a mesh, from connectivity alone: those of least bending.
// Mirrors mixseq/compression/bitstream/predictor.py.
import { MAX_NEIGHBOURS, find } from "./signal_graph_kernels.js";

const MAX_STENCIL_NODES = 16; // largest number of nodes in a stencil
const MAX_SLOPE_NEIGHBOURS = 32; // slopes at nodes of more neighbours are ignored

/** The initial stencils of a mesh's graph: `neighbours` (N x width), `counts`, `weights`. */
export function graphStencils({ graph, levels }) {
  const size = graph.order.length, width = MAX_STENCIL_NODES;
  const found = { width, neighbours: new Int32Array(size * width), counts: graph.counts.slice(), weights: new Float64Array(size * width) };
  copyRows(graph, found);
  let lengths = levels.length ? new Float64Array(levels[0].adjacent.length).fill(1) : null;
  levels.forEach((level) => {
    const after = updateLengths(level, lengths);
    fitStencils(level, lengths, after, graph.place, found);
    lengths = after;
  });
  return found;
}

/** Copy neighbours and weights to rows that may be wider. */
export function copyRows({ width, neighbours, counts, weights }, to) {
  for (let node = 0; node < counts.length; node++) {
    for (let i = 0; i < counts[node]; i++) {
      to.neighbours[node * to.width + i] = neighbours[node * width + i];
      to.weights[node * to.width + i] = weights[node * width + i];
    }
  }
}

/** Write the stencils of removed vertices, from edge lengths before and after. */
function fitStencils({ removed, starts, adjacent, newStarts, newAdjacent }, lengths, newLengths, place, found) {
  const slot = new Int32Array(place.length).fill(-1); // where a vertex is in the two lists
  const listed = new Int32Array(MAX_NEIGHBOURS * (MAX_SLOPE_NEIGHBOURS + 1)), rawWeights = new Float64Array(MAX_NEIGHBOURS * (MAX_SLOPE_NEIGHBOURS + 1));
  const across = new Uint8Array(MAX_SLOPE_NEIGHBOURS); // whether the path to a neighbour leads across the vertex
  for (let k = 0; k < removed.length; k++) {
    const vertex = removed[k], first = starts[vertex], degree = Math.min(starts[vertex + 1] - first, MAX_NEIGHBOURS);
    let slope = 0; // of the vertex, by its own value
    for (let at = first; at < first + degree; at++) slope += 1 / lengths[at];
    slope /= degree;
    for (let i = 0; i < degree; i++) {
      listed[i] = adjacent[first + i];
      rawWeights[i] = slope / (degree * lengths[first + i]);
      slot[listed[i]] = i;
    }
    let size = degree, total = slope * slope;
    for (let i = 0; i < degree; i++) {
      const neighbour = adjacent[first + i], length = lengths[first + i], low = newStarts[neighbour], high = newStarts[neighbour + 1];
      if (high - low > MAX_SLOPE_NEIGHBOURS) continue;
      let number = 1; // of remaining neighbours, plus one
      for (let at = low; at < high; at++) {
        const where = slot[newAdjacent[at]];
        across[at - low] = where >= 0 && where < degree && newLengths[at] >= length + lengths[first + where] ? 1 : 0;
        number += 1 - across[at - low];
      }
      const slope = 1 / (number * length);
      for (let at = low; at < high; at++) {
        if (across[at - low]) continue;
        const other = newAdjacent[at];
        if (slot[other] < 0) {
          slot[other] = size;
          listed[size] = other;
          rawWeights[size++] = 0;
        }
        const rawWeight = slope / (number * newLengths[at]);
        rawWeights[i] += rawWeight;
        rawWeights[slot[other]] -= rawWeight;
      }
      total += slope * slope;
      rawWeights[i] += slope * slope;
    }
    for (let i = 0; i < size; i++) slot[listed[i]] = -1;
    writeStencil(place[vertex], degree, size, total, listed, rawWeights, place, found);
  }
}

/** Write a stencil: neighbours first, then the nodes of the largest weights. */
function writeStencil(node, degree, size, total, listed, rawWeights, place, { width, neighbours, counts, weights }) {
  const kept = Math.min(size, width);
  let remainder = 1;
  for (let i = 0; i < kept; i++) {
    let best = i;
    for (let j = i + 1; i >= degree && j < size; j++) if (Math.abs(rawWeights[j]) > Math.abs(rawWeights[best])) best = j;
    const vertex = listed[i], weight = rawWeights[i];
    listed[i] = listed[best];
    rawWeights[i] = rawWeights[best];
    listed[best] = vertex;
    rawWeights[best] = weight;
    remainder -= rawWeights[i] / total;
  }
  counts[node] = kept;
  for (let i = 0; i < kept; i++) {
    neighbours[node * width + i] = place[listed[i]];
    weights[node * width + i] = rawWeights[i] / total + remainder / kept;
  }
}

/** The lengths of edges after vertices were removed, the shortest each, from those before. */
function updateLengths({ removed, starts, adjacent, ends, newStarts, newAdjacent }, lengths) {
  const found = new Float64Array(newAdjacent.length).fill(Infinity);
  copyLengths(starts, adjacent, lengths, newStarts, newAdjacent, found);
  for (let k = 0, count = 0; k < removed.length; k++) {
    const vertex = removed[k], first = starts[vertex], last = starts[vertex + 1];
    if (last - first < 2) continue;
    const best = ends[count], length = lengths[find(adjacent, first, last, best)];
    for (let at = first; at < last; at++) {
      if (adjacent[at] === best) continue;
      shorten(best, adjacent[at], length + lengths[at], newStarts, newAdjacent, found);
      shorten(adjacent[at], best, length + lengths[at], newStarts, newAdjacent, found);
      count++;
    }
  }
  return found;
}

/** Copy the lengths of remaining edges. */
function copyLengths(starts, adjacent, lengths, newStarts, newAdjacent, found) {
  for (let vertex = 0; vertex < starts.length - 1; vertex++) {
    let at = starts[vertex];
    const end = starts[vertex + 1];
    for (let where = newStarts[vertex]; where < newStarts[vertex + 1]; where++) {
      while (at < end && adjacent[at] < newAdjacent[where]) at++;
      if (at < end && adjacent[at] === newAdjacent[where]) found[where] = lengths[at];
    }
  }
}

function shorten(rawWeight, other, length, starts, adjacent, lengths) {
  const where = find(adjacent, starts[rawWeight], starts[rawWeight + 1], other);
  lengths[where] = Math.min(lengths[where], length);
}
