// Who is beside whom in a graph, who goes, who is joined. Mirrors coding/bitstream/signal_graph_kernels.py.

export const MOST = 12; // neighbours that a node is predicted from
const HUB = 32; // neighbours that are so many times more are searched, not gone through

/**
 * Starts (N + 1) and neighbours, ascending, each once, of all nodes, from pairs of nodes, some of which may be there
 * twice, or be one node.
 *
 * Each loop is a function of its own, here and elsewhere: browsers compile a loop while it runs for the first time, and throw that
 * away if it goes on to lines that they have not seen yet.
 */
export function adjacency(ends, others, size, count) {
  const starts = new Int32Array(count + 1), loose = new Int32Array(2 * size), beside = new Int32Array(2 * size);
  countBoth(ends, others, size, starts);
  accumulate(starts);
  listBoth(ends, others, size, starts.slice(), loose);
  giveBack(loose, starts, starts.slice(), beside);
  const kept = dropRepeated(starts, beside);
  return { starts, beside: beside.slice(0, kept) };
}

function countBoth(ends, others, size, starts) {
  for (let k = 0; k < size; k++) {
    starts[ends[k] + 1]++;
    starts[others[k] + 1]++;
  }
}

/** Make sums of counts. */
function accumulate(counts) {
  for (let k = 1; k < counts.length; k++) counts[k] += counts[k - 1];
}

function listBoth(ends, others, size, places, loose) {
  for (let k = 0; k < size; k++) {
    loose[places[ends[k]]++] = others[k];
    loose[places[others[k]]++] = ends[k];
  }
}

/** Give each node to its neighbours, so that these get theirs in ascending order. */
function giveBack(loose, starts, places, beside) {
  for (let node = 0; node < starts.length - 1; node++) {
    for (let at = starts[node]; at < starts[node + 1]; at++) beside[places[loose[at]]++] = node;
  }
}

/** Leave out what is there twice, and nodes beside themselves; returns how many are left. */
function dropRepeated(starts, beside) {
  let kept = 0;
  for (let node = 0, first = 0; node < starts.length - 1; node++) {
    const end = starts[node + 1];
    for (let at = first, last = node; at < end; at++) {
      const other = beside[at];
      if (other === last || other === node) continue;
      beside[kept++] = last = other;
    }
    first = end;
    starts[node + 1] = kept;
  }
  return kept;
}

/** Nodes with neighbours, those with the fewest first, of equally many the lower ones. */
export function byDegree(starts, count) {
  let most = 0;
  for (let node = 0; node < count; node++) most = Math.max(most, starts[node + 1] - starts[node]);
  const places = new Int32Array(most + 2);
  for (let node = 0; node < count; node++) places[starts[node + 1] - starts[node] + 1]++;
  accumulate(places);
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
  const size = sizeOf(gone, starts), ends = new Int32Array(size), others = new Int32Array(size), mark = new Int32Array(starts.length - 1).fill(-1);
  const count = closeHoles(gone, starts, beside, neighbours, counts, mark, ends, others);
  return { ends: ends.slice(0, count), others: others.slice(0, count) };
}

function sizeOf(gone, starts) {
  let size = 0;
  for (let k = 0; k < gone.length; k++) size += starts[gone[k] + 1] - starts[gone[k]];
  return size;
}

function closeHoles(gone, starts, beside, neighbours, counts, mark, ends, others) {
  let count = 0;
  for (let k = 0; k < gone.length; k++) {
    const node = gone[k], first = starts[node], last = starts[node + 1];
    counts[node] = Math.min(last - first, MOST);
    for (let i = 0; i < counts[node]; i++) neighbours[node * MOST + i] = beside[first + i];
    for (let at = first; at < last; at++) mark[beside[at]] = node;
    const best = mostJoined(node, starts, beside, mark);
    for (let at = first; at < last; at++) {
      if (beside[at] === best) continue;
      ends[count] = best;
      others[count++] = beside[at];
    }
  }
  return count;
}

/** The neighbour of a node that most of the others are marked beside. */
function mostJoined(node, starts, beside, mark) {
  const first = starts[node], last = starts[node + 1];
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
  return best;
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
