// The order in which a signal over a mesh, or over time, is coded, and the neighbours that predict each value.
// Mirrors coding/bitstream/signal_graph.py.
//
// A graph of N nodes has the `order` (N) of the vertices, or frames, that they are; `counts` (N) of nodes before each
// that it is predicted from, in `neighbours` (N x width) with `weights`; and the `ring` of all nodes beside node i,
// ring[ringStarts[i]] to ring[ringStarts[i + 1] - 1].
import { MOST, adjacency, byDegree, collapse, independent } from "./signal_graph_kernels.js";

const WIDEST = 6; // nodes with more neighbours stay for a coarser level, if there are others
const ROOTS = 6; // of nodes without neighbours

/**
 * The graph of a mesh of so many vertices, with its levels, fine to coarse: what is `gone`, neighbours before (`starts`,
 * `beside`), pairs that close the holes (`ends`, `others`), neighbours after (`newStarts`, `newBeside`).
 */
export function meshGraph(triangles, count) {
  const fine = adjacency(new Int32Array(triangles), nextCorners(triangles), triangles.length, count);
  const neighbours = new Int32Array(count * MOST), counts = new Int32Array(count);
  const levels = coarserLevels(fine, count, neighbours, counts), order = new Int32Array(count), away = new Uint8Array(count);
  levels.forEach(({ gone }) => mark(gone, away));
  let place = listOthers(away, order);
  joinRoots(order.subarray(0, place), neighbours, counts);
  for (let level = levels.length - 1; level >= 0; level--) {
    order.set(levels[level].gone, place);
    place += levels[level].gone.length;
  }
  return { graph: inOrder(order, neighbours, counts, means(counts), MOST, fine, false), levels };
}

/** Vertices at the corners that come after these in their triangles. */
function nextCorners(triangles) {
  const next = new Int32Array(triangles.length);
  for (let k = 0; k < next.length; k++) next[k] = triangles[k % 3 === 2 ? k - 2 : k + 1];
  return next;
}

function mark(nodes, marks) {
  for (let k = 0; k < nodes.length; k++) marks[nodes[k]] = 1;
}

/** List the nodes that are not marked; returns how many. */
function listOthers(marks, list) {
  let count = 0;
  for (let node = 0; node < marks.length; node++) if (!marks[node]) list[count++] = node;
  return count;
}

/** Nodes that no level has are predicted from those just before them. */
function joinRoots(roots, neighbours, counts) {
  for (let place = 1; place < roots.length; place++) {
    const node = roots[place], first = Math.max(0, place - ROOTS);
    counts[node] = place - first;
    for (let k = first; k < place; k++) neighbours[node * MOST + k - first] = roots[k];
  }
}

/** Equal weights of all neighbours of a node. */
function means(counts) {
  const weights = new Float64Array(counts.length * MOST);
  for (let node = 0; node < counts.length; node++) {
    for (let i = 0; i < counts[node]; i++) weights[node * MOST + i] = 1 / counts[node];
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
    // Known are the multiples of two steps below the last frame, and that.
    const multiples = Math.ceil(last / (2 * step)), known = (k) => (k < multiples ? k * 2 * step : last);
    for (let node = step; node < last; node += 2 * step) {
      const place = (node - step) / (2 * step) + 1, first = Math.max(place - 2, 0), end = Math.min(place + 2, multiples + 1);
      const beside = [], others = [];
      for (let k = first; k < end; k++) beside.push(known(k));
      for (let k = first - 1; k >= Math.max(first - width, 0); k--) others.push(known(k));
      for (let k = end; k < Math.min(end + width, multiples + 1); k++) others.push(known(k));
      for (let k = 1; k <= width && node - 2 * k * step > 0; k++) others.push(node - 2 * k * step);
      others.sort((a, b) => Math.abs(a - node) - Math.abs(b - node) || a - b);
      weights.set(lagrange(beside, node), node * width);
      const all = beside.concat(others).slice(0, width);
      counts[node] = all.length;
      neighbours.set(all, node * width);
      order[done++] = node;
    }
  }
  const before = Int32Array.from({ length: last }, (_, frame) => frame), after = before.map((frame) => frame + 1);
  return inOrder(order, neighbours, counts, weights, width, adjacency(before, after, last, count), true);
}

/** Weights of the polynomial through values at nodes. */
function lagrange(nodes, at) {
  return nodes.map((node) => {
    let over = 1, under = 1;
    for (const other of nodes) {
      if (other === node) continue;
      over *= at - other;
      under *= node - other;
    }
    return over / under;
  });
}

/** The graph whose nodes have the numbers of their order. */
function inOrder(order, neighbours, counts, weights, width, { starts, beside }, overTime) {
  const size = order.length, place = new Int32Array(size);
  for (let node = 0; node < size; node++) place[order[node]] = node;
  const graph = {
    order, place, width, overTime,
    neighbours: new Int32Array(size * width), counts: new Int32Array(size), weights: new Float64Array(size * width),
    ring: new Int32Array(beside.length), ringStarts: new Int32Array(size + 1),
  };
  for (let node = 0, next = 0; node < size; node++) {
    const own = order[node];
    graph.counts[node] = counts[own];
    for (let i = 0; i < counts[own]; i++) {
      graph.neighbours[node * width + i] = place[neighbours[own * width + i]];
      graph.weights[node * width + i] = weights[own * width + i];
    }
    for (let at = starts[own]; at < starts[own + 1]; at++) graph.ring[next++] = place[beside[at]];
    graph.ringStarts[node + 1] = next;
  }
  return graph;
}

/** Take nodes away until no edge is left; neighbours and counts of those that go are written. */
function coarserLevels({ starts, beside }, count, neighbours, counts) {
  const levels = [];
  while (beside.length) {
    const nodes = byDegree(starts, count), fewest = starts[nodes[0] + 1] - starts[nodes[0]];
    const gone = independent(nodes, starts, beside, Math.max(WIDEST, fewest));
    const { ends, others } = collapse(gone, starts, beside, neighbours, counts);
    const allEnds = new Int32Array(beside.length / 2 + ends.length), allOthers = new Int32Array(allEnds.length), away = new Uint8Array(count);
    allEnds.set(ends);
    allOthers.set(others);
    mark(gone, away);
    const size = addOthers(starts, beside, away, ends.length, allEnds, allOthers), after = adjacency(allEnds, allOthers, size, count);
    levels.push({ gone, starts, beside, ends, others, newStarts: after.starts, newBeside: after.beside });
    ({ starts, beside } = after);
  }
  return levels;
}

/** Add the pairs of neighbours that stay to lists of so many pairs; returns how many there are then. */
function addOthers(starts, beside, away, size, ends, others) {
  for (let node = 0; node < away.length; node++) {
    if (away[node]) continue;
    for (let at = starts[node]; at < starts[node + 1]; at++) {
      if (beside[at] < node || away[beside[at]]) continue;
      ends[size] = node;
      others[size++] = beside[at];
    }
  }
  return size;
}
