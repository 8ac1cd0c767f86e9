// Who is beside whom in a graph, who goes, who is joined. Mirrors coding/bitstream/signal_graph_kernels.py.

export const MOST = 12; // neighbours that a node is predicted from
const HUB = 32; // neighbours that are so many times more are searched, not gone through

/**
 * Starts (N + 1) and neighbours, ascending, each once, of all nodes, from pairs of nodes, some of which may be there
 * twice, or be one node.
 */
export function adjacency(ends, others, size, count) {
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
export function byDegree(starts, count) {
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
export function independent(nodes, starts, beside, most) {
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
export function collapse(gone, starts, beside, neighbours, counts) {
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
