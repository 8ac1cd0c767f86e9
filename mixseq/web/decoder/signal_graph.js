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
  const size = triangles.length, ends = new Int32Array(size), others = new Int32Array(size);
  for (let k = 0; k < size; k++) {
    ends[k] = triangles[k];
    others[k] = triangles[k % 3 === 2 ? k - 2 : k + 1];
  }
  const fine = adjacency(ends, others, size, count);
  const neighbours = new Int32Array(count * MOST), counts = new Int32Array(count);
  const levels = coarserLevels(fine, count, neighbours, counts);
  const order = new Int32Array(count), left = new Uint8Array(count).fill(1);
  for (const { gone } of levels) for (const node of gone) left[node] = 0;
  let roots = 0;
  for (let node = 0; node < count; node++) if (left[node]) order[roots++] = node;
  for (let place = 1; place < roots; place++) {
    const node = order[place], first = Math.max(0, place - ROOTS);
    counts[node] = place - first;
    for (let k = first; k < place; k++) neighbours[node * MOST + k - first] = order[k];
  }
  for (let level = levels.length - 1, place = roots; level >= 0; level--) {
    order.set(levels[level].gone, place);
    place += levels[level].gone.length;
  }
  const weights = new Float64Array(count * MOST);
  for (let node = 0; node < count; node++) {
    for (let i = 0; i < counts[node]; i++) weights[node * MOST + i] = 1 / counts[node];
  }
  return { graph: inOrder(order, neighbours, counts, weights, MOST, fine, false), levels };
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
    const away = new Uint8Array(count);
    for (const node of gone) away[node] = 1;
    const allEnds = new Int32Array(beside.length / 2 + ends.length), allOthers = new Int32Array(allEnds.length);
    let size = ends.length;
    allEnds.set(ends);
    allOthers.set(others);
    for (let node = 0; node < count; node++) {
      if (away[node]) continue;
      for (let at = starts[node]; at < starts[node + 1]; at++) {
        if (beside[at] < node || away[beside[at]]) continue;
        allEnds[size] = node;
        allOthers[size++] = beside[at];
      }
    }
    const after = adjacency(allEnds, allOthers, size, count);
    levels.push({ gone, starts, beside, ends, others, newStarts: after.starts, newBeside: after.beside });
    ({ starts, beside } = after);
  }
  return levels;
}
