// Half-edges of a mesh that grows polygon by polygon. A half-edge has the number of its first corner, and is open until its
// opposite is added. Mirrors the tables of mixseq/compression/bitstream/connectivity.py.
import { CONTEXTS_PER_BIT, hashContext } from "./arithmetic.js";

/** States of vertices. */
export const UNUSED = 0;
export const OPEN = 1;
export const CLOSED = 2;

/** Half-edges that end, or start, at a vertex. */
export const INTO = 0;
export const OUT_OF = 1;

const MAX_SEARCHED_HALF_EDGES = 33;

/** A mesh of unused vertices; the names are those of the Python module. */
export function newHalfEdges(cornerCount, vertexCount) {
  const two = (count) => [new Int32Array(count).fill(-1), new Int32Array(count).fill(-1)];
  const trees = [0, 1, 2].map(() => new Int32Array(vertexCount + 1));
  for (let at = 1; at <= vertexCount; at++) trees[UNUSED][at] = at & -at;
  return {
    tails: new Int32Array(cornerCount), heads: new Int32Array(cornerCount),
    newest: two(vertexCount), older: two(cornerCount), newer: two(cornerCount),
    openEdges: new Int32Array(vertexCount), degrees: new Int32Array(vertexCount), states: new Uint8Array(vertexCount),
    stateCounts: [vertexCount, 0, 0], trees,
    unused: [-1, 1].map((step) => Int32Array.from({ length: vertexCount + 2 }, (_, at) => at + step)),
  };
}

/** The number of vertices of a state before a vertex. */
export function vertexRank({ trees }, state, vertex) {
  const tree = trees[state];
  let rank = 0;
  for (; vertex > 0; vertex &= vertex - 1) rank += tree[vertex];
  return rank;
}

/** The vertex of a state and rank. */
export function vertexAtRank({ trees }, state, rank) {
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

/** Set the state of a vertex. */
export function setState({ trees, states, stateCounts, unused }, vertex, state) {
  const old = states[vertex], from = trees[old], to = trees[state];
  if (old === state) return;
  states[vertex] = state;
  stateCounts[old]--;
  stateCounts[state]++;
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

/** Add the polygon with the corners from `start` to below `stop`. */
export function addPolygon(mesh, corners, start, stop) {
  for (let corner = start; corner < stop; corner++) addHalfEdge(mesh, corner, corners[corner], corners[corner + 1 < stop ? corner + 1 : start]);
  for (let corner = start; corner < stop; corner++) {
    const vertex = corners[corner];
    mesh.degrees[vertex]++;
    setState(mesh, vertex, mesh.openEdges[vertex] ? OPEN : CLOSED);
  }
}

/** Close the opposite half-edge, or open this one. */
function addHalfEdge(mesh, edge, tail, head) {
  const { tails, heads, openEdges } = mesh;
  let opposite = mesh.newest[INTO][tail], searched = 0;
  while (opposite >= 0 && tails[opposite] !== head) opposite = ++searched < MAX_SEARCHED_HALF_EDGES ? mesh.older[INTO][opposite] : -1;
  if (opposite >= 0) {
    unlink(mesh, INTO, tail, opposite);
    unlink(mesh, OUT_OF, head, opposite);
  } else {
    tails[edge] = tail;
    heads[edge] = head;
    link(mesh, INTO, head, edge);
    link(mesh, OUT_OF, tail, edge);
  }
  openEdges[tail] += opposite >= 0 ? -1 : 1;
  openEdges[head] += opposite >= 0 ? -1 : 1;
}

function link(mesh, side, vertex, edge) {
  const newest = mesh.newest[side][vertex];
  mesh.older[side][edge] = newest;
  if (newest >= 0) mesh.newer[side][newest] = edge;
  mesh.newest[side][vertex] = edge;
}

function unlink(mesh, side, vertex, edge) {
  const older = mesh.older[side][edge], newer = mesh.newer[side][edge];
  if (older >= 0) mesh.newer[side][older] = newer;
  if (newer >= 0) mesh.older[side][newer] = older;
  else mesh.newest[side][vertex] = older;
}

/** Number of guesses at a corner. */
export const GUESS_COUNT = 16;

/** Number of vertices from which unguessed vertices are counted. */
export const BASE_COUNT = 9;

const REPEAT_SLOTS = 1 << 16, HASH_FACTOR = 1000003, WORD = 2 ** 32;

/** An empty history of earlier corners; the names are those of the Python module. */
export function newHistory(vertexCount) {
  const rows = (count, size) => Array.from({ length: count }, () => new Int32Array(size));
  return {
    guesses: new Float64Array(GUESS_COUNT), successes: rows(4, GUESS_COUNT), winners: rows(4, 2), recentWinners: new Int32Array(3), recentCorners: new Int32Array(6),
    bases: new Int32Array(BASE_COUNT), distances: [0, 1, 2].map(() => rows(4, BASE_COUNT)), lastUnguessed: new Int32Array(4), lastDistances: new Int32Array(3),
    repeats: new Int32Array(REPEAT_SLOTS), facts: new Int32Array(CONTEXTS_PER_BIT), lastPolygons: new Int32Array(vertexCount).fill(-1),
  };
}

/** Guess the vertex of a corner from the mesh, the last polygons, and adjacent numbers. */
export function makeGuesses({ newest, older, tails, heads, unused }, { guesses, recentCorners }, place, before, first, lastNew) {
  guesses.fill(-1);
  if (place === 0) {
    for (let i = 0; i < 3; i++) {
      const into = newest[INTO][recentCorners[i]], out = newest[OUT_OF][recentCorners[i]];
      if (into >= 0) guesses[i] = tails[into];
      if (out >= 0) guesses[3 + i] = heads[out];
    }
    guesses[9] = 2 * recentCorners[0] - recentCorners[3];
  } else {
    let edge = newest[INTO][before];
    for (let i = 0; i < 3 && edge >= 0; i++, edge = older[INTO][edge]) guesses[i] = tails[edge];
  }
  if (place === 3) {
    let edge = newest[OUT_OF][first];
    for (let i = 3; i < 6 && edge >= 0; i++, edge = older[OUT_OF][edge]) guesses[i] = heads[edge];
  }
  guesses[6] = unused[1][lastNew + 1] - 1;
  guesses[7] = unused[0][lastNew + 1] - 1;
  for (let i = 0; i < 3; i++) guesses[11 + i] = recentCorners[i];
  guesses[14] = before + 1;
  guesses[15] = before - 1;
}

/** Record the right guesses at a corner; `winner` is the first of them, or `GUESS_COUNT` plus the state. */
export function recordGuesses({ guesses, successes, recentWinners, winners }, place, vertex, winner) {
  const right = successes[place];
  for (let g = 0; g < GUESS_COUNT; g++) if (guesses[g] >= 0) right[g] = ((right[g] << 1) | (guesses[g] === vertex ? 1 : 0)) & 255;
  const here = winners[place];
  recentWinners[2] = recentWinners[1];
  recentWinners[1] = recentWinners[0];
  here[1] = here[0];
  recentWinners[0] = here[0] = winner;
}

/** The slot of the last three differences of corners: bits 32 to 47 of a product mod 2^64. */
export function repeatSlot(corners, corner, place) {
  const third = corners[corner - 2], second = corners[corner - 1], first = (corners[corner] - second) * HASH_FACTOR + second - third;
  const high = Math.floor(first / WORD), low = (first - high * WORD) * HASH_FACTOR + third - corners[corner - 3], carry = Math.floor(low / WORD);
  const lower = 4 * (low - carry * WORD) + place;
  return hashContext(lower, 4 * (high * HASH_FACTOR + carry) + Math.floor(lower / WORD)) & (REPEAT_SLOTS - 1);
}
