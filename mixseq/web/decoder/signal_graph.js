// The coding order of a signal over a mesh, or over time, and the neighbours that predict each value.
// Mirrors mixseq/compression/bitstream/signal_graph.py.
//
// A graph of N nodes has the `order` (N) of their vertices, or frames; the earlier nodes that predict each, `neighbours`
// (N x width) with `counts` (N) and `weights`; and the `ring` of all nodes adjacent to node i, ring[ringStarts[i]] to
// ring[ringStarts[i + 1] - 1].

const MAX_REMOVED_DEGREE = 6; // largest number of neighbours of a removed node, if there are any such nodes
const MAX_ROOT_NEIGHBOURS = 6; // earlier roots that predict a node without neighbours

/**
 * The graph of a mesh with `count` vertices, and its levels, fine to coarse: the `removed` nodes, the graph before (`starts`,
 * `adjacent`), edges that close the holes (`ends`, `others`), the graph after (`newStarts`, `newAdjacent`).
 */
export function meshGraph(triangles, count) {
  const fine = buildAdjacency(new Int32Array(triangles), nextCorners(triangles), triangles.length, count);
  const neighbours = new Int32Array(count * MAX_NEIGHBOURS), counts = new Int32Array(count);
  const levels = coarserLevels(fine, count, neighbours, counts), order = new Int32Array(count), removedMask = new Uint8Array(count);
  levels.forEach(({ removed }) => mark(removed, removedMask));
  let place = listOthers(removedMask, order);
  joinRoots(order.subarray(0, place), neighbours, counts);
  for (let level = levels.length - 1; level >= 0; level--) {
    order.set(levels[level].removed, place);
    place += levels[level].removed.length;
  }
  return { graph: inOrder(order, neighbours, counts, means(counts), MAX_NEIGHBOURS, fine, false), levels };
}

/** The vertex of the next corner, for all corners of triangles. */
function nextCorners(triangles) {
  const next = new Int32Array(triangles.length);
  for (let k = 0; k < next.length; k++) next[k] = triangles[k % 3 === 2 ? k - 2 : k + 1];
  return next;
}

function mark(nodes, marks) {
  for (let k = 0; k < nodes.length; k++) marks[nodes[k]] = 1;
}

/** List the nodes that are not marked; return their number. */
function listOthers(marks, list) {
  let count = 0;
  for (let node = 0; node < marks.length; node++) if (!marks[node]) list[count++] = node;
  return count;
}

/** Predict nodes that were not removed from those just before them. */
function joinRoots(roots, neighbours, counts) {
  for (let place = 1; place < roots.length; place++) {
    const node = roots[place], first = Math.max(0, place - MAX_ROOT_NEIGHBOURS);
    counts[node] = place - first;
    for (let k = first; k < place; k++) neighbours[node * MAX_NEIGHBOURS + k - first] = roots[k];
  }
}

/** Equal weights of all neighbours of a node. */
function means(counts) {
  const weights = new Float64Array(counts.length * MAX_NEIGHBOURS);
  for (let node = 0; node < counts.length; node++) {
    for (let i = 0; i < counts[node]; i++) weights[node * MAX_NEIGHBOURS + i] = 1 / counts[node];
  }
  return weights;
}

/** The graph of consecutive frames: first and last, those in the middle, and so on by halves. */
export function pathGraph(count) {
  const width = 6, last = count - 1;
  const neighbours = new Int32Array(count * width), counts = new Int32Array(count);
  const weights = new Float64Array(count * width), order = new Int32Array(count);
  let done = 1;
  if (count > 1) {
    order[done++] = last;
    counts[last] = 1;
    weights[last * width] = 1;
  }
  let step = 1;
  while (step < last) step *= 2;
  for (step /= 2; step >= 1; step /= 2) {
    // The known frames are the multiples of two steps below the last frame, and the last frame.
    const multiples = Math.ceil(last / (2 * step)), known = (k) => (k < multiples ? k * 2 * step : last);
    for (let node = step; node < last; node += 2 * step) {
      const place = (node - step) / (2 * step) + 1, first = Math.max(place - 2, 0), end = Math.min(place + 2, multiples + 1);
      const adjacent = [], others = [];
      for (let k = first; k < end; k++) adjacent.push(known(k));
      for (let k = first - 1; k >= Math.max(first - width, 0); k--) others.push(known(k));
      for (let k = end; k < Math.min(end + width, multiples + 1); k++) others.push(known(k));
      for (let k = 1; k <= width && node - 2 * k * step > 0; k++) others.push(node - 2 * k * step);
      others.sort((a, b) => Math.abs(a - node) - Math.abs(b - node) || a - b);
      weights.set(lagrangeWeights(adjacent, node), node * width);
      const all = adjacent.concat(others).slice(0, width);
      counts[node] = all.length;
      neighbours.set(all, node * width);
      order[done++] = node;
    }
  }
  const before = Int32Array.from({ length: last }, (_, frame) => frame), after = before.map((frame) => frame + 1);
  return inOrder(order, neighbours, counts, weights, width, buildAdjacency(before, after, last, count), true);
}

/** Weights of the polynomial through values at nodes. */
function lagrangeWeights(nodes, at) {
  return nodes.map((node) => {
    let numerator = 1, denominator = 1;
    for (const other of nodes) {
      if (other === node) continue;
      numerator *= at - other;
      denominator *= node - other;
    }
    return numerator / denominator;
  });
}

/** The graph with its nodes in coding order. */
function inOrder(order, neighbours, counts, weights, width, { starts, adjacent }, isOverTime) {
  const size = order.length, place = new Int32Array(size);
  for (let node = 0; node < size; node++) place[order[node]] = node;
  const graph = {
    order, place, width, isOverTime,
    neighbours: new Int32Array(size * width), counts: new Int32Array(size), weights: new Float64Array(size * width),
    ring: new Int32Array(adjacent.length), ringStarts: new Int32Array(size + 1),
  };
  for (let node = 0, next = 0; node < size; node++) {
    const own = order[node];
    graph.counts[node] = counts[own];
    for (let i = 0; i < counts[own]; i++) {
      graph.neighbours[node * width + i] = place[neighbours[own * width + i]];
      graph.weights[node * width + i] = weights[own * width + i];
    }
    for (let at = starts[own]; at < starts[own + 1]; at++) graph.ring[next++] = place[adjacent[at]];
    graph.ringStarts[node + 1] = next;
  }
  return graph;
}

/** Remove nodes until no edge is left; write neighbours and counts of removed nodes. */
function coarserLevels({ starts, adjacent }, count, neighbours, counts) {
  const levels = [];
  while (adjacent.length) {
    const nodes = sortByDegree(starts, count), fewest = starts[nodes[0] + 1] - starts[nodes[0]];
    const removed = findIndependentNodes(nodes, starts, adjacent, Math.max(MAX_REMOVED_DEGREE, fewest));
    const { ends, others } = collapseNodes(removed, starts, adjacent, neighbours, counts);
    const allEnds = new Int32Array(adjacent.length / 2 + ends.length), allOthers = new Int32Array(allEnds.length), removedMask = new Uint8Array(count);
    allEnds.set(ends);
    allOthers.set(others);
    mark(removed, removedMask);
    const size = addOthers(starts, adjacent, removedMask, ends.length, allEnds, allOthers), after = buildAdjacency(allEnds, allOthers, size, count);
    levels.push({ removed, starts, adjacent, ends, others, newStarts: after.starts, newAdjacent: after.adjacent });
    ({ starts, adjacent } = after);
  }
  return levels;
}

/** Add the edges of remaining nodes to a list of `size` edges; return its new size. */
function addOthers(starts, adjacent, removedMask, size, ends, others) {
  for (let node = 0; node < removedMask.length; node++) {
    if (removedMask[node]) continue;
    for (let at = starts[node]; at < starts[node + 1]; at++) {
      if (adjacent[at] < node || removedMask[adjacent[at]]) continue;
      ends[size] = node;
      others[size++] = adjacent[at];
    }
  }
  return size;
}

// Adjacency of graphs, and the removal of nodes.

export const MAX_NEIGHBOURS = 12; // largest number of neighbours that predict a node
export const NEIGHBOUR_COUNTS = MAX_NEIGHBOURS + 1; // possible numbers of neighbours, from 0 on
const HUB_DEGREE_RATIO = 32; // ratio of degrees above which shared neighbours are found by binary search

/**
 * Starts (N + 1) and neighbours of all nodes, ascending and unique, from edges, which may repeat, or join a node to itself.
 *
 * Each loop is a function of its own, here and elsewhere: browsers compile a loop while it runs for the first time, and discard
 * the code if the function continues with lines that were not executed before.
 */
function buildAdjacency(ends, others, size, count) {
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
function sortByDegree(starts, count) {
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
function findIndependentNodes(nodes, starts, adjacent, maxDegree) {
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
function collapseNodes(removed, starts, adjacent, neighbours, counts) {
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
