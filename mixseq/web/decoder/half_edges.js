// Half-edges of a mesh that grows polygon by polygon, as in mixseq/compression/bitstream/connectivity_kernels.py: a half-edge is open as long
// as none runs the other way, and has the number of the corner that it starts from.

/** States of vertices. */
export const UNUSED = 0;
export const OPEN = 1;
export const CLOSED = 2;

/** Half-edges that end, or start, at a vertex. */
export const INTO = 0;
export const OUT_OF = 1;

const LOOKED_AT = 33;

/** A mesh of unused vertices; the names are those of the Python module. */
export function noHalfEdges(cornerCount, vertexCount) {
  const two = (count) => [new Int32Array(count).fill(-1), new Int32Array(count).fill(-1)];
  const trees = [0, 1, 2].map(() => new Int32Array(vertexCount + 1));
  for (let at = 1; at <= vertexCount; at++) trees[UNUSED][at] = at & -at;
  return {
    tails: new Int32Array(cornerCount), heads: new Int32Array(cornerCount),
    newest: two(vertexCount), older: two(cornerCount), newer: two(cornerCount),
    openEdges: new Int32Array(vertexCount), degrees: new Int32Array(vertexCount), states: new Uint8Array(vertexCount),
    members: [vertexCount, 0, 0], trees,
    unused: [-1, 1].map((step) => Int32Array.from({ length: vertexCount + 2 }, (_, at) => at + step)),
  };
}

/** How many vertices of a state come before a vertex. */
export function rankOf({ trees }, state, vertex) {
  const tree = trees[state];
  let rank = 0;
  for (; vertex > 0; vertex &= vertex - 1) rank += tree[vertex];
  return rank;
}

/** The vertex of a state that so many of it come before. */
export function vertexOf({ trees }, state, rank) {
  const tree = trees[state];
  let vertex = 0;
  for (let step = 1 << (31 - Math.clz32(tree.length)); step; step >>= 1) {
    if (vertex + step < tree.length && tree[vertex + step] <= rank) {
      vertex += step;
      rank -= tree[vertex];
    }
  }
  return vertex;
}

/** Give a vertex a state. */
export function move({ trees, states, members, unused }, vertex, state) {
  const old = states[vertex], from = trees[old], to = trees[state];
  if (old === state) return;
  states[vertex] = state;
  members[old]--;
  members[state]++;
  if (old === UNUSED) {
    const below = unused[0][vertex + 1], above = unused[1][vertex + 1];
    unused[1][below] = above;
    unused[0][above] = below;
  }
  for (let at = vertex + 1; at < to.length; at += at & -at) {
    from[at]--;
    to[at]++;
  }
}

/** Add the polygon whose corners are those from `start` to below `stop`. */
export function addPolygon(mesh, corners, start, stop) {
  for (let corner = start; corner < stop; corner++) add(mesh, corner, corners[corner], corners[corner + 1 < stop ? corner + 1 : start]);
  for (let corner = start; corner < stop; corner++) {
    const vertex = corners[corner];
    mesh.degrees[vertex]++;
    move(mesh, vertex, mesh.openEdges[vertex] ? OPEN : CLOSED);
  }
}

/** Close the half-edge that runs the other way, or open this one. */
function add(mesh, edge, tail, head) {
  const { tails, heads, openEdges } = mesh;
  let other = mesh.newest[INTO][tail], looked = 0;
  while (other >= 0 && tails[other] !== head) other = ++looked < LOOKED_AT ? mesh.older[INTO][other] : -1;
  if (other >= 0) {
    unlink(mesh, INTO, tail, other);
    unlink(mesh, OUT_OF, head, other);
  } else {
    tails[edge] = tail;
    heads[edge] = head;
    link(mesh, INTO, head, edge);
    link(mesh, OUT_OF, tail, edge);
  }
  openEdges[tail] += other >= 0 ? -1 : 1;
  openEdges[head] += other >= 0 ? -1 : 1;
}

function link(mesh, way, vertex, edge) {
  const newest = mesh.newest[way][vertex];
  mesh.older[way][edge] = newest;
  if (newest >= 0) mesh.newer[way][newest] = edge;
  mesh.newest[way][vertex] = edge;
}

function unlink(mesh, way, vertex, edge) {
  const older = mesh.older[way][edge], newer = mesh.newer[way][edge];
  if (older >= 0) mesh.newer[way][older] = newer;
  if (newer >= 0) mesh.older[way][newer] = older;
  else mesh.newest[way][vertex] = older;
}
