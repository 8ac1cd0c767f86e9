// Guesses at the next corner of a mesh, and the history that they use. Mirrors mixseq/compression/bitstream/connectivity_kernels.py.
import { INTO, OUT_OF } from "./half_edges.js";
import { CONTEXTS_PER_BIT, hashContext } from "./hashed_contexts.js";

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
