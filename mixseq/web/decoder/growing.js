// Corners of polygons, and an order of polygons in which each is beside those before it, as in mixseq/compression/bitstream/connectivity.py.

const BUCKETS = 4;

/**
 * The corners of polygons on nodes: on vertices, or on texture coordinates. The names are those of the Python module, but for
 * `after` and `before`, which have the next corner and the one before of every corner.
 */
export function cornersOf(counts, node, nodeCount) {
  const size = node.length, starts = new Int32Array(counts.length + 1), polygon = new Int32Array(size);
  const all = Int32Array.from(node, (_, corner) => corner), after = all.map((corner) => corner + 1), before = all.map((corner) => corner - 1);
  counts.forEach((count, p) => {
    const start = starts[p], stop = (starts[p + 1] = start + count);
    polygon.fill(p, start, stop);
    after[stop - 1] = start;
    before[start] = stop - 1;
  });
  const { order: around, starts: aroundStarts } = sorted(all, node, nodeCount);
  return { starts, polygon, node, after, before, twin: twins(node, after, around, nodeCount), aroundStarts, around };
}

/** Corners in the order of their keys, which are below `size`; of equal ones as they were. Also where each key starts. */
function sorted(corners, keys, size) {
  const starts = new Int32Array(size + 1), order = new Int32Array(corners.length);
  for (const key of keys) starts[key + 1]++;
  for (let key = 0; key < size; key++) starts[key + 1] += starts[key];
  const filled = starts.slice();
  for (const corner of corners) order[filled[keys[corner]]++] = corner;
  return { order, starts };
}

/** Twins of half-edges: of those between the same nodes, the k-th one way is the twin of the k-th the other way. */
function twins(tails, after, around, nodeCount) {
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
  const heads = new Int32Array(BUCKETS).fill(-1), tails = new Int32Array(BUCKETS);
  let lowest = 0, entries = 0;
  for (let p = 0; p < count; p++) unknown[p] = starts[p + 1] - starts[p];

  function next() {
    for (let bucket = 0; bucket < BUCKETS; bucket++) {
      while (heads[bucket] >= 0) {
        const p = queued[heads[bucket]];
        heads[bucket] = following[heads[bucket]];
        if (!visited[p] && Math.min(unknown[p], BUCKETS - 1) === bucket) return p;
      }
    }
    while (visited[lowest]) lowest++;
    return lowest;
  }

  function enqueue(p) {
    const bucket = Math.min(unknown[p], BUCKETS - 1);
    queued[entries] = p;
    if (heads[bucket] < 0) heads[bucket] = entries;
    else following[tails[bucket]] = entries;
    tails[bucket] = entries++;
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
