// Corners of polygons, and the growing order of polygons. Mirrors mixseq/compression/bitstream/connectivity.py.

const QUEUE_COUNT = 4;

/**
 * The corners of polygons on nodes: vertices, or texture coordinates. The names are those of the Python module; `after` and
 * `before` have the next and the previous corner of every corner.
 */
export function cornersOnNodes(counts, node, nodeCount) {
  const size = node.length, starts = new Int32Array(counts.length + 1), polygon = new Int32Array(size);
  const all = Int32Array.from(node, (_, corner) => corner), after = all.map((corner) => corner + 1), before = all.map((corner) => corner - 1);
  counts.forEach((count, p) => {
    const start = starts[p], stop = (starts[p + 1] = start + count);
    polygon.fill(p, start, stop);
    after[stop - 1] = start;
    before[start] = stop - 1;
  });
  const { order: around, starts: aroundStarts } = sorted(all, node, nodeCount);
  return { starts, polygon, node, after, before, twin: findTwins(node, after, around, nodeCount), aroundStarts, around };
}

/** Sort corners by their keys below `size`, stably; also return where each key starts. */
function sorted(corners, keys, size) {
  const starts = new Int32Array(size + 1), order = new Int32Array(corners.length);
  for (const key of keys) starts[key + 1]++;
  for (let key = 0; key < size; key++) starts[key + 1] += starts[key];
  const filled = starts.slice();
  for (const corner of corners) order[filled[keys[corner]]++] = corner;
  return { order, starts };
}

/** Twins of half-edges: of several between the same nodes, the k-th is the twin of the k-th opposite one. */
function findTwins(tails, after, around, nodeCount) {
  const heads = tails.map((_, corner) => tails[after[corner]]), twin = new Int32Array(tails.length).fill(-1);
  const back = sorted(around, heads, nodeCount).order, forth = sorted(sorted(twin.map((_, corner) => corner), heads, nodeCount).order, tails, nodeCount).order;
  for (let i = 0, j = 0; i < forth.length && j < back.length; ) {
    const there = forth[i], wanted = back[j], apart = tails[there] - heads[wanted] || heads[there] - tails[wanted];
    if (apart <= 0) i++;
    if (apart >= 0) j++;
    if (apart === 0 && tails[there] !== heads[there]) twin[wanted] = there;
  }
  return twin;
}

/** The polygons in the order in which they are visited: first those with the fewest unknown nodes. */
export function growingOrder({ starts, polygon, node, aroundStarts, around }) {
  const count = starts.length - 1, unknown = new Int32Array(count), visited = new Uint8Array(count), order = new Int32Array(count);
  const known = new Uint8Array(aroundStarts.length - 1), queued = new Int32Array(node.length), following = new Int32Array(node.length).fill(-1);
  const heads = new Int32Array(QUEUE_COUNT).fill(-1), tails = new Int32Array(QUEUE_COUNT);
  let lowest = 0, entries = 0;
  for (let p = 0; p < count; p++) unknown[p] = starts[p + 1] - starts[p];

  function next() {
    for (let queue = 0; queue < QUEUE_COUNT; queue++) {
      while (heads[queue] >= 0) {
        const p = queued[heads[queue]];
        heads[queue] = following[heads[queue]];
        if (!visited[p] && Math.min(unknown[p], QUEUE_COUNT - 1) === queue) return p;
      }
    }
    while (visited[lowest]) lowest++;
    return lowest;
  }

  function enqueue(p) {
    const queue = Math.min(unknown[p], QUEUE_COUNT - 1);
    queued[entries] = p;
    if (heads[queue] < 0) heads[queue] = entries;
    else following[tails[queue]] = entries;
    tails[queue] = entries++;
  }

  for (let place = 0; place < count; place++) {
    const chosen = (order[place] = next());
    visited[chosen] = 1;
    for (let corner = starts[chosen]; corner < starts[chosen + 1]; corner++) {
      const at = node[corner];
      if (known[at]) continue;
      known[at] = 1;
      for (let k = aroundStarts[at]; k < aroundStarts[at + 1]; k++) {
        const p = polygon[around[k]];
        if (visited[p]) continue;
        unknown[p]--;
        enqueue(p);
      }
    }
  }
  return order;
}
