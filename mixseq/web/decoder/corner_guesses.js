// Guesses at the next corner of a mesh, and what they take, as in mixseq/compression/bitstream/connectivity_kernels.py.
import { INTO, OUT_OF } from "./half_edges.js";
import { INPUTS, spread } from "./hashed_contexts.js";

/** Number of guesses at a corner. */
export const GUESSES = 16;

/** Number of vertices from which one that no guess had is counted. */
export const BASES = 9;

const REPEATS = 1 << 16, FACTOR = 1000003, WORD = 2 ** 32;

/** What is remembered of earlier corners at the start: nothing. The names are those of the Python module. */
export function noPast(vertexCount) {
  const rows = (count, size) => Array.from({ length: count }, () => new Int32Array(size));
  return {
    guesses: new Float64Array(GUESSES), successes: rows(4, GUESSES), winners: rows(4, 2), trail: new Int32Array(3), near: new Int32Array(6),
    bases: new Int32Array(BASES), distances: [0, 1, 2].map(() => rows(4, BASES)), named: new Int32Array(4), lastDistances: new Int32Array(3),
    repeats: new Int32Array(REPEATS), about: new Int32Array(INPUTS), used: new Int32Array(vertexCount).fill(-1),
  };
}

/** Guess the vertex of a corner from its neighbours in the mesh, in the polygons before, and in number. */
export function makeGuesses({ newest, older, tails, heads, unused }, { guesses, near }, place, before, first, lastNew) {
  guesses.fill(-1);
  if (place === 0) {
    for (let i = 0; i < 3; i++) {
      const into = newest[INTO][near[i]], out = newest[OUT_OF][near[i]];
      if (into >= 0) guesses[i] = tails[into];
      if (out >= 0) guesses[3 + i] = heads[out];
    }
    guesses[9] = 2 * near[0] - near[3];
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
  for (let i = 0; i < 3; i++) guesses[11 + i] = near[i];
  guesses[14] = before + 1;
  guesses[15] = before - 1;
}

/** Keep which guesses at a corner were right; `winner` is the first of them, or `GUESSES` and the state. */
export function remember({ guesses, successes, trail, winners }, place, vertex, winner) {
  const right = successes[place];
  for (let g = 0; g < GUESSES; g++) if (guesses[g] >= 0) right[g] = ((right[g] << 1) | (guesses[g] === vertex ? 1 : 0)) & 255;
  const here = winners[place];
  trail[2] = trail[1];
  trail[1] = trail[0];
  here[1] = here[0];
  trail[0] = here[0] = winner;
}

/** Where it is remembered what came after the last three differences of corners: bits 32 to 47 of a product mod 2^64. */
export function slotOf(corners, corner, place) {
  const third = corners[corner - 2], second = corners[corner - 1], first = (corners[corner] - second) * FACTOR + second - third;
  const high = Math.floor(first / WORD), low = (first - high * WORD) * FACTOR + third - corners[corner - 3], carry = Math.floor(low / WORD);
  const lower = 4 * (low - carry * WORD) + place;
  return spread(lower, 4 * (high * FACTOR + carry) + Math.floor(lower / WORD)) & (REPEATS - 1);
}
