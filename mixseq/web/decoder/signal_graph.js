// The order in which a signal over a mesh, or over time, is coded, and the neighbours that predict each value.
// Mirrors coding/bitstream/signal_graph.py.
//
// A graph of N nodes has the `order` (N) of the vertices, or frames, that they are; `counts` (N) of nodes before each
// that it is predicted from, in `neighbours` (N x width) with `weights`; and the `ring` of all nodes beside node i,
// ring[ringStarts[i]] to ring[ringStarts[i + 1] - 1].

export const MOST = 12; // neighbours that a node is predicted from
const WIDEST = 6; // nodes with more neighbours stay for a coarser level, if there are others
const ROOTS = 6; // of nodes without neighbours
const HUB = 32; // neighbours that are so many times more are searched, not gone through

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

/**
 * Starts (N + 1) and neighbours, ascending, each once, of all nodes, from pairs of nodes, some of which may be there
 * twice, or be one node.
 */
function adjacency(ends, others, size, count) {
  const starts = new Int32Array(count + 1);
  for (let k = 0; k < size; k++) {
    starts[ends[k] + 1]++;
    starts[others[k] + 1]++;
  }
  for (let node = 0; node < count; node++) starts[node + 1] += starts[node];
  const loose = new Int32Array(2 * size), beside = new Int32Array(2 * size);
  let places = starts.slice();
  for (let k = 0; k < size; k++) {
    loose[places[ends[k]]++] = others[k];
    loose[places[others[k]]++] = ends[k];
  }
  places = starts.slice();
  for (let node = 0; node < count; node++) { // to its neighbours, so that these get theirs in ascending order
    for (let at = starts[node]; at < starts[node + 1]; at++) beside[places[loose[at]]++] = node;
  }
  let kept = 0;
  for (let node = 0, first = 0; node < count; node++) {
    const end = starts[node + 1];
    for (let at = first, last = node; at < end; at++) {
      const other = beside[at];
      if (other === last || other === node) continue;
      beside[kept++] = last = other;
    }
    first = end;
    starts[node + 1] = kept;
  }
  return { starts, beside: beside.slice(0, kept) };
}

/** Nodes with neighbours, those with the fewest first, of equally many the lower ones. */
function byDegree(starts, count) {
  let most = 0;
  for (let node = 0; node < count; node++) most = Math.max(most, starts[node + 1] - starts[node]);
  const places = new Int32Array(most + 2);
  for (let node = 0; node < count; node++) places[starts[node + 1] - starts[node] + 1]++;
  for (let degree = 0; degree <= most; degree++) places[degree + 1] += places[degree];
  const alone = places[1], nodes = new Int32Array(count - alone);
  for (let node = 0; node < count; node++) {
    const degree = starts[node + 1] - starts[node];
    if (degree) nodes[places[degree]++ - alone] = node;
  }
  return nodes;
}

/** Nodes, first come first served, no two of which are neighbours, with at most so many neighbours. */
function independent(nodes, starts, beside, most) {
  const blocked = new Uint8Array(starts.length - 1), chosen = new Int32Array(nodes.length);
  let count = 0;
  for (let k = 0; k < nodes.length; k++) {
    const node = nodes[k];
    if (blocked[node] || starts[node + 1] - starts[node] > most) continue;
    chosen[count++] = node;
    for (let at = starts[node]; at < starts[node + 1]; at++) blocked[beside[at]] = 1;
  }
  return chosen.slice(0, count);
}

/**
 * Note neighbours of nodes that go; return pairs that close the holes: all neighbours are joined to the one that has most
 * of the others as neighbours already, or to the one of fewest neighbours among those.
 */
function collapse(gone, starts, beside, neighbours, counts) {
  let size = 0;
  for (const node of gone) size += starts[node + 1] - starts[node];
  const ends = new Int32Array(size), others = new Int32Array(size), mark = new Int32Array(starts.length - 1).fill(-1);
  let count = 0;
  for (const node of gone) {
    const first = starts[node], last = starts[node + 1];
    counts[node] = Math.min(last - first, MOST);
    for (let i = 0; i < counts[node]; i++) neighbours[node * MOST + i] = beside[first + i];
    for (let at = first; at < last; at++) mark[beside[at]] = node;
    let best = beside[first], sharedBest = -1, degreeBest = 0;
    for (let place = first; place < last; place++) {
      const other = beside[place], low = starts[other], high = starts[other + 1], degree = high - low;
      let shared = 0;
      if (degree > HUB * (last - first)) {
        for (let at = first; at < last; at++) if (find(beside, low, high, beside[at]) >= 0) shared++;
      } else {
        for (let at = low; at < high; at++) if (mark[beside[at]] === node) shared++;
      }
      if (shared > sharedBest || (shared === sharedBest && degree < degreeBest)) {
        best = other;
        sharedBest = shared;
        degreeBest = degree;
      }
    }
    for (let at = first; at < last; at++) {
      if (beside[at] === best) continue;
      ends[count] = best;
      others[count++] = beside[at];
    }
  }
  return { ends: ends.slice(0, count), others: others.slice(0, count) };
}

/** Where a number is between two places of an ascending list, or -1. */
export function find(list, low, high, number) {
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle] < number) low = middle + 1;
    else if (list[middle] > number) high = middle;
    else return middle;
  }
  return -1;
}
