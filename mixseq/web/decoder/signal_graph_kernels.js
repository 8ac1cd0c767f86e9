// Adjacency of graphs, and the removal of nodes. Mirrors mixseq/compression/bitstream/signal_graph.py.

export const MAX_NEIGHBOURS = 12; // largest number of neighbours that predict a node
const HUB_DEGREE_RATIO = 32; // ratio of degrees above which shared neighbours are found by binary search

/**
 * Starts (N + 1) and neighbours of all nodes, ascending and unique, from edges, which may repeat, or join a node to itself.
 *
 * Each loop is a function of its own, here and elsewhere: browsers compile a loop while it runs for the first time, and discard
 * the code if the function continues with lines that were not executed before.
 */
export function buildAdjacency(ends, others, size, count) {
  const starts = new Int32Array(count + 1), unsorted = new Int32Array(2 * size), adjacent = new Int32Array(2 * size);
  countEnds(ends, others, size, starts);
  accumulate(starts);
  listEnds(ends, others, size, starts.slice(), unsorted);
  sortRows(unsorted, starts, starts.slice(), adjacent);
  const kept = dropRepeated(starts, adjacent);
  return { starts, adjacent: adjacent.slice(0, kept) };
}

function countEnds(ends, others, size, starts) {
  for (let k = 0; k < size; k++) {
    starts[ends[k] + 1]++;
    starts[others[k] + 1]++;
  }
}

/** Replace counts by their cumulative sums. */
function accumulate(counts) {
  for (let k = 1; k < counts.length; k++) counts[k] += counts[k - 1];
}

function listEnds(ends, others, size, places, unsorted) {
  for (let k = 0; k < size; k++) {
    unsorted[places[ends[k]]++] = others[k];
    unsorted[places[others[k]]++] = ends[k];
  }
}

/** Sort rows, by adding each node to the rows of its neighbours. */
function sortRows(unsorted, starts, places, adjacent) {
  for (let node = 0; node < starts.length - 1; node++) {
    for (let at = starts[node]; at < starts[node + 1]; at++) adjacent[places[unsorted[at]]++] = node;
  }
}

/** Remove repeated neighbours, and nodes that are their own neighbours; return the number left. */
function dropRepeated(starts, adjacent) {
  let kept = 0;
  for (let node = 0, first = 0; node < starts.length - 1; node++) {
    const end = starts[node + 1];
    for (let at = first, last = node; at < end; at++) {
      const other = adjacent[at];
      if (other === last || other === node) continue;
      adjacent[kept++] = last = other;
    }
    first = end;
    starts[node + 1] = kept;
  }
  return kept;
}

/** Nodes with neighbours, by increasing degree, ties in ascending order. */
export function sortByDegree(starts, count) {
  let maxDegree = 0;
  for (let node = 0; node < count; node++) maxDegree = Math.max(maxDegree, starts[node + 1] - starts[node]);
  const places = new Int32Array(maxDegree + 2);
  for (let node = 0; node < count; node++) places[starts[node + 1] - starts[node] + 1]++;
  accumulate(places);
  const isolatedCount = places[1], nodes = new Int32Array(count - isolatedCount);
  for (let node = 0; node < count; node++) {
    const degree = starts[node + 1] - starts[node];
    if (degree) nodes[places[degree]++ - isolatedCount] = node;
  }
  return nodes;
}

/** Nodes of at most `maxDegree` neighbours, no two of them adjacent, in the order of a list. */
export function findIndependentNodes(nodes, starts, adjacent, maxDegree) {
  const blockedMask = new Uint8Array(starts.length - 1), independent = new Int32Array(nodes.length);
  let count = 0;
  for (let k = 0; k < nodes.length; k++) {
    const node = nodes[k];
    if (blockedMask[node] || starts[node + 1] - starts[node] > maxDegree) continue;
    independent[count++] = node;
    for (let at = starts[node]; at < starts[node + 1]; at++) blockedMask[adjacent[at]] = 1;
  }
  return independent.slice(0, count);
}

/**
 * Write the neighbours of removed nodes; return edges that close the holes. A node is collapsed onto its neighbour that is
 * adjacent to most others, among equals that of fewest neighbours.
 */
export function collapseNodes(removed, starts, adjacent, neighbours, counts) {
  const size = neighbourTotal(removed, starts), ends = new Int32Array(size), others = new Int32Array(size), mark = new Int32Array(starts.length - 1).fill(-1);
  const count = closeHoles(removed, starts, adjacent, neighbours, counts, mark, ends, others);
  return { ends: ends.slice(0, count), others: others.slice(0, count) };
}

function neighbourTotal(removed, starts) {
  let size = 0;
  for (let k = 0; k < removed.length; k++) size += starts[removed[k] + 1] - starts[removed[k]];
  return size;
}

function closeHoles(removed, starts, adjacent, neighbours, counts, mark, ends, others) {
  let count = 0;
  for (let k = 0; k < removed.length; k++) {
    const node = removed[k], first = starts[node], last = starts[node + 1];
    counts[node] = Math.min(last - first, MAX_NEIGHBOURS);
    for (let i = 0; i < counts[node]; i++) neighbours[node * MAX_NEIGHBOURS + i] = adjacent[first + i];
    for (let at = first; at < last; at++) mark[adjacent[at]] = node;
    const best = mostJoined(node, starts, adjacent, mark);
    for (let at = first; at < last; at++) {
      if (adjacent[at] === best) continue;
      ends[count] = best;
      others[count++] = adjacent[at];
    }
  }
  return count;
}

/** The neighbour of a node that is adjacent to most of the marked others. */
function mostJoined(node, starts, adjacent, mark) {
  const first = starts[node], last = starts[node + 1];
  let best = adjacent[first], sharedBest = -1, degreeBest = 0;
  for (let place = first; place < last; place++) {
    const other = adjacent[place], low = starts[other], high = starts[other + 1], degree = high - low;
    let shared = 0;
    if (degree > HUB_DEGREE_RATIO * (last - first)) {
      for (let at = first; at < last; at++) if (find(adjacent, low, high, adjacent[at]) >= 0) shared++;
    } else {
      for (let at = low; at < high; at++) if (mark[adjacent[at]] === node) shared++;
    }
    if (shared > sharedBest || (shared === sharedBest && degree < degreeBest)) {
      best = other;
      sharedBest = shared;
      degreeBest = degree;
    }
  }
  return best;
}

/** The place of a number between two places of an ascending list, or -1. */
export function find(list, low, high, number) {
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle] < number) low = middle + 1;
    else if (list[middle] > number) high = middle;
    else return middle;
  }
  return -1;
}
