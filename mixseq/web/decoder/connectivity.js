// Polygons without loss, in their order, as mixseq/compression/bitstream/connectivity.py and its kernels decode them.
import { BASES, GUESSES, makeGuesses, noPast, remember, slotOf } from "./corner_guesses.js";
import { checkOf, refuseOthers, withoutCheck } from "./decoded_check.js";
import { MixseqError } from "./errors.js";
import { CLOSED, OPEN, UNUSED, addPolygon, move, noHalfEdges, rankOf, vertexOf } from "./half_edges.js";
import { INPUTS, hashedBits } from "./hashed_contexts.js";

const COUNTS = 3, STATES = 4; // what numbers are about; 0 to 2 are distances among unused, open, closed vertices
const KINDS = 4 * GUESSES + 4 * 5, LONGEST = 33, LOOKED_AT = 32;

/** Polygons `{counts, corners}`: their numbers of corners, and the vertices of these. */
export function decodePolygons(bytes, polygonCount, cornerCount, vertexCount) {
  const whole = [polygonCount, cornerCount, vertexCount].every((count) => count >= 0 && count < 2 ** 31 && count % 1 === 0);
  if (!whole || cornerCount < 3 * polygonCount) throw damaged();
  if (!polygonCount || !vertexCount) {
    if (bytes.length || cornerCount) throw damaged();
    return { counts: new Uint32Array(0), corners: new Uint32Array(0) };
  }
  const mesh = { counts: new Uint32Array(polygonCount), corners: new Uint32Array(cornerCount) };
  const { data, expected } = withoutCheck(bytes);
  walk(hashedBits(data, KINDS), noHalfEdges(cornerCount, vertexCount), noPast(vertexCount), mesh.counts, mesh.corners);
  refuseOthers(checkOf(mesh.corners, checkOf(mesh.counts)), expected);
  return mesh;
}

const damaged = () => new MixseqError("the mesh is damaged");

/** Decode all polygons into `counts` and `corners`. */
function walk(bits, mesh, past, counts, corners) {
  const { guesses, near } = past;
  let corner = 0, first = 0, previous = 0; // corners that the polygon before, and the one before that, start from
  let lastNew = -1, repeat = 0, run = 0; // the corner that comes after the same differences, and for how long it was right
  for (let polygon = 0; polygon < counts.length; polygon++) {
    const start = corner, old = polygon ? counts[polygon - 1] : 3, older = polygon > 1 ? counts[polygon - 2] : 3;
    past.about.fill((Math.min(old, 63) << 6) | Math.min(older, 63));
    const count = old + readNumber(bits, past.about, COUNTS), stop = start + count;
    if (count < 3 || stop > corners.length) throw damaged();
    counts[polygon] = count;
    for (; corner < stop; corner++) {
      const j = corner - start, place = corner === stop - 1 ? 3 : Math.min(j, 2), before = corner ? corners[corner - 1] : 0;
      makeGuesses(mesh, past, place, before, j ? corners[start] : before, lastNew);
      if (repeat) guesses[8] = before + corners[repeat] - corners[repeat - 1];
      if (j && first + j < start) guesses[9] = before + corners[first + j] - corners[first + j - 1];
      if (j && previous + j < first) guesses[10] = before + corners[previous + j] - corners[previous + j - 1];
      const winner = readWinner(bits, mesh, past, corners, polygon, start, corner, place, run);
      const vertex = winner < GUESSES ? guesses[winner] : readNamed(bits, mesh, past, winner - GUESSES, before, place, lastNew);
      corners[corner] = vertex;
      remember(past, place, vertex, winner);
      if (repeat && guesses[8] === vertex) {
        repeat++;
        run++;
      } else repeat = run = 0;
      if (corner > 2) {
        const slot = slotOf(corners, corner, place);
        repeat ||= past.repeats[slot];
        past.repeats[slot] = corner + 1;
      }
      if (mesh.states[vertex] === UNUSED) {
        lastNew = vertex;
        move(mesh, vertex, OPEN);
      }
      past.used[vertex] = polygon;
    }
    addPolygon(mesh, corners, start, stop);
    near.copyWithin(3, 0, 3);
    near.set([corners[start], corners[start + 1], corners[stop - 1]]);
    previous = first;
    first = start;
  }
  if (corner !== corners.length) throw damaged();
}

/** The first right guess at a corner, or `GUESSES` and the state of the vertex that none had. */
function readWinner(bits, mesh, past, corners, polygon, start, corner, place, run) {
  const { degrees, openEdges } = mesh, { guesses, trail, used } = past, { contexts, above } = bits;
  const before = corner ? corners[corner - 1] : 0, first = corner > start ? corners[start] : before;
  const around = corner ? Math.min(degrees[before], 8) * 4 + Math.min(openEdges[before], 3) : 0;
  const winners = past.winners[place], successes = past.successes[place];
  for (let g = 0; g < GUESSES; g++) {
    const guess = guesses[g];
    if (guess < 0 || guess >= degrees.length) continue;
    let agreeing = 0, again = 0;
    for (let h = 0; h < GUESSES; h++) if (guesses[h] === guess) agreeing |= 1 << h;
    if (agreeing & ((1 << g) - 1)) continue; // it was said already that it is not this one
    for (let other = Math.max(start, corner - LOOKED_AT); other < corner; other++) if (corners[other] === guess) again = 1;
    const kind = place * GUESSES + g, fan = (again * 4 + Math.min(openEdges[guess], 3)) * 9 + Math.min(degrees[guess], 8);
    const age = used[guess] >= 0 ? bitLength(polygon - used[guess]) : 63, right = successes[g];
    const long = (((agreeing << 5) | trail[0]) << 7) | fan;
    contexts[0] = (((right << 7) | (again ? fan : 0)) << 7) | kind;
    contexts[1] = (((agreeing << 1) | again) << 7) | kind;
    contexts[2] = (((((trail[0] << 5) | trail[1]) << 5) | trail[2]) << 7) | kind;
    contexts[3] = (((((winners[0] << 5) | winners[1]) << 5) | trail[0]) << 7) | kind;
    contexts[4] = (((fan << 6) | around) << 7) | kind;
    contexts[5] = (((((clamped(guess - before) << 6) | clamped(guess - first)) << 5) | trail[0]) << 7) | kind;
    contexts[6] = (long << 7) | kind;
    contexts[7] = (((((age << 4) | Math.min(run, 15)) << 3) | (right & 7)) << 7) | kind;
    above.fill(0);
    above[6] = long >>> 25;
    if (bits.next(kind)) return g;
  }
  const { about } = past, last = winners[0], two = (((trail[0] << 5) | trail[1]) << 2) | place;
  [place, two, (last << 2) | place, (two << 5) | last].forEach((known, i) => (about[i] = about[4 + i] = known));
  const state = OPEN + readNumber(bits, about, STATES);
  if (state < UNUSED || state > CLOSED) throw damaged();
  return GUESSES + state;
}

/** The vertex that no guess had, by its distance among the vertices of its state from a base. */
function readNamed(bits, mesh, past, state, before, place, lastNew) {
  const { about, bases } = past, distances = past.distances[state][place], members = mesh.members[state];
  bases[0] = lastNew + 1;
  bases[1] = before;
  bases[2] = past.named[place];
  bases.set(past.near, 3);
  let best = 0, second = 1;
  for (let base = 1; base < BASES; base++) {
    if (distances[base] < distances[best]) [best, second] = [base, best];
    else if (distances[base] < distances[second]) second = base;
  }
  const origin = rankOf(mesh, state, bases[best]), apart = rankOf(mesh, state, bases[second]) - origin;
  const last = (bitLength(past.lastDistances[state]) << 2) | place, near = ((Math.min(Math.max(apart, -7), 7) + 7) << 2) | place;
  const far = (best << 7) | (bitLength(apart) << 1) | (apart < 0 ? 1 : 0);
  const share = (Math.floor((origin * 16) / (members + 1)) << 6) | bitLength(members);
  about.set([0, near, far, (far << 8) | near, last, (last << 8) | near, share, ((distances[best] >> 6) << 2) | place]);
  const distance = readNumber(bits, about, state), rank = origin + distance;
  if (rank < 0 || rank >= members) throw damaged();
  past.lastDistances[state] = distance;
  for (let base = 0; base < BASES; base++) distances[base] += (256 * bitLength(rankOf(mesh, state, bases[base]) - rank) - distances[base]) >> 4;
  return (past.named[place] = vertexOf(mesh, state, rank));
}

/** A number: whether it is not 0, its sign, how many bits its magnitude has, and those after the first. */
function readNumber(bits, about, what) {
  const next = (stage, node, known) => {
    for (let i = 0; i < INPUTS; i++) {
      bits.contexts[i] = (known ? about[i] << 20 : 0) | (node << 5) | (what << 2) | stage;
      bits.above[i] = (known ? about[i] >>> 12 : 0) | (1 << 28);
    }
    return bits.next(4 * (GUESSES + what) + stage);
  };
  if (!next(0, 0, true)) return 0;
  const negative = next(1, 0, true);
  let length = 1, value = 1;
  while (next(2, (length << 1) | negative, true) && length < LONGEST) length++;
  for (let shift = length - 2; shift >= 0; shift--) value = 2 * value + next(3, (length << 6) | (value < 16 ? value : 16 + shift), value < 4);
  return negative ? -value : value;
}

const bitLength = (number) => 32 - Math.clz32(Math.abs(number));

/** A small number as one from 1 to 63, larger ones as the nearest of these. */
const clamped = (number) => Math.min(Math.max(number, -31), 31) + 32;
