// Decode polygons, in their order; corners on nodes, and the growing order. Mirrors mixseq/compression/bitstream/connectivity.py and corners.py.
import { CONTEXTS_PER_BIT, checksumOf, hashedBits, splitChecksum, verifyChecksum } from "./arithmetic.js";
import { BASE_COUNT, CLOSED, GUESS_COUNT, OPEN, UNUSED, addPolygon, makeGuesses, newHalfEdges, newHistory, recordGuesses, repeatSlot, setState, vertexAtRank, vertexRank } from "./connectivity_kernels.js";
import { MixseqError } from "./errors.js";

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

const COUNT_TOPIC = 3, STATE_TOPIC = 4; // topics of numbers; 0 to 2 are distances among unused, open, closed vertices
const BIT_KINDS = 4 * GUESS_COUNT + 4 * 5, MAX_NUMBER_BITS = 33, MAX_SEARCHED_CORNERS = 32;

/** Decode polygons `{counts, corners}`: their numbers of corners, and the vertices of these. */
export function decodePolygons(bytes, polygonCount, cornerCount, vertexCount) {
  const whole = [polygonCount, cornerCount, vertexCount].every((count) => count >= 0 && count < 2 ** 31 && count % 1 === 0);
  if (!whole || cornerCount < 3 * polygonCount) throw damaged();
  if (!polygonCount || !vertexCount) {
    if (bytes.length || cornerCount) throw damaged();
    return { counts: new Uint32Array(0), corners: new Uint32Array(0) };
  }
  const mesh = { counts: new Uint32Array(polygonCount), corners: new Uint32Array(cornerCount) };
  const { data, expected } = splitChecksum(bytes);
  readPolygons(hashedBits(data, BIT_KINDS), newHalfEdges(cornerCount, vertexCount), newHistory(vertexCount), mesh.counts, mesh.corners);
  verifyChecksum(checksumOf(mesh.corners, checksumOf(mesh.counts)), expected);
  return mesh;
}

const damaged = () => new MixseqError("the mesh is damaged");

/** Decode all polygons into `counts` and `corners`. */
function readPolygons(bits, mesh, history, counts, corners) {
  const { guesses, recentCorners } = history;
  let corner = 0, first = 0, previous = 0; // first corners of the last two polygons
  let lastNew = -1, repeat = 0, run = 0; // the corner after the same differences, and for how long it was right
  for (let polygon = 0; polygon < counts.length; polygon++) {
    const start = corner, lastCount = polygon ? counts[polygon - 1] : 3, olderCount = polygon > 1 ? counts[polygon - 2] : 3;
    history.facts.fill((Math.min(lastCount, 63) << 6) | Math.min(olderCount, 63));
    const count = lastCount + readNumber(bits, history.facts, COUNT_TOPIC), stop = start + count;
    if (count < 3 || stop > corners.length) throw damaged();
    counts[polygon] = count;
    for (; corner < stop; corner++) {
      const j = corner - start, place = corner === stop - 1 ? 3 : Math.min(j, 2), before = corner ? corners[corner - 1] : 0;
      makeGuesses(mesh, history, place, before, j ? corners[start] : before, lastNew);
      if (repeat) guesses[8] = before + corners[repeat] - corners[repeat - 1];
      if (j && first + j < start) guesses[9] = before + corners[first + j] - corners[first + j - 1];
      if (j && previous + j < first) guesses[10] = before + corners[previous + j] - corners[previous + j - 1];
      const winner = readWinner(bits, mesh, history, corners, polygon, start, corner, place, run);
      const vertex = winner < GUESS_COUNT ? guesses[winner] : readUnguessed(bits, mesh, history, winner - GUESS_COUNT, before, place, lastNew);
      corners[corner] = vertex;
      recordGuesses(history, place, vertex, winner);
      if (repeat && guesses[8] === vertex) {
        repeat++;
        run++;
      } else repeat = run = 0;
      if (corner > 2) {
        const slot = repeatSlot(corners, corner, place);
        repeat ||= history.repeats[slot];
        history.repeats[slot] = corner + 1;
      }
      if (mesh.states[vertex] === UNUSED) {
        lastNew = vertex;
        setState(mesh, vertex, OPEN);
      }
      history.lastPolygons[vertex] = polygon;
    }
    addPolygon(mesh, corners, start, stop);
    recentCorners.copyWithin(3, 0, 3);
    recentCorners.set([corners[start], corners[start + 1], corners[stop - 1]]);
    previous = first;
    first = start;
  }
  if (corner !== corners.length) throw damaged();
}

/** Read the first right guess at a corner, or `GUESS_COUNT` plus the state of an unguessed vertex. */
function readWinner(bits, mesh, history, corners, polygon, start, corner, place, run) {
  const { degrees, openEdges } = mesh, { guesses, recentWinners, lastPolygons } = history, { contexts, above } = bits;
  const before = corner ? corners[corner - 1] : 0, first = corner > start ? corners[start] : before;
  const around = corner ? Math.min(degrees[before], 8) * 4 + Math.min(openEdges[before], 3) : 0;
  const winners = history.winners[place], successes = history.successes[place];
  for (let g = 0; g < GUESS_COUNT; g++) {
    const guess = guesses[g];
    if (guess < 0 || guess >= degrees.length) continue;
    let agreeing = 0, isRepeated = 0;
    for (let h = 0; h < GUESS_COUNT; h++) if (guesses[h] === guess) agreeing |= 1 << h;
    if (agreeing & ((1 << g) - 1)) continue; // excluded already
    for (let other = Math.max(start, corner - MAX_SEARCHED_CORNERS); other < corner; other++) if (corners[other] === guess) isRepeated = 1;
    const kind = place * GUESS_COUNT + g, fan = (isRepeated * 4 + Math.min(openEdges[guess], 3)) * 9 + Math.min(degrees[guess], 8);
    const age = lastPolygons[guess] >= 0 ? bitLength(polygon - lastPolygons[guess]) : 63, right = successes[g];
    const long = (((agreeing << 5) | recentWinners[0]) << 7) | fan;
    contexts[0] = (((right << 7) | (isRepeated ? fan : 0)) << 7) | kind;
    contexts[1] = (((agreeing << 1) | isRepeated) << 7) | kind;
    contexts[2] = (((((recentWinners[0] << 5) | recentWinners[1]) << 5) | recentWinners[2]) << 7) | kind;
    contexts[3] = (((((winners[0] << 5) | winners[1]) << 5) | recentWinners[0]) << 7) | kind;
    contexts[4] = (((fan << 6) | around) << 7) | kind;
    contexts[5] = (((((clamp(guess - before) << 6) | clamp(guess - first)) << 5) | recentWinners[0]) << 7) | kind;
    contexts[6] = (long << 7) | kind;
    contexts[7] = (((((age << 4) | Math.min(run, 15)) << 3) | (right & 7)) << 7) | kind;
    above.fill(0);
    above[6] = long >>> 25;
    if (bits.next(kind)) return g;
  }
  const { facts } = history, last = winners[0], two = (((recentWinners[0] << 5) | recentWinners[1]) << 2) | place;
  [place, two, (last << 2) | place, (two << 5) | last].forEach((known, i) => (facts[i] = facts[4 + i] = known));
  const state = OPEN + readNumber(bits, facts, STATE_TOPIC);
  if (state < UNUSED || state > CLOSED) throw damaged();
  return GUESS_COUNT + state;
}

/** Read an unguessed vertex, by its distance from a base among the vertices of its state. */
function readUnguessed(bits, mesh, history, state, before, place, lastNew) {
  const { facts, bases } = history, distances = history.distances[state][place], stateCounts = mesh.stateCounts[state];
  bases[0] = lastNew + 1;
  bases[1] = before;
  bases[2] = history.lastUnguessed[place];
  bases.set(history.recentCorners, 3);
  let best = 0, second = 1;
  for (let base = 1; base < BASE_COUNT; base++) {
    if (distances[base] < distances[best]) [best, second] = [base, best];
    else if (distances[base] < distances[second]) second = base;
  }
  const origin = vertexRank(mesh, state, bases[best]), apart = vertexRank(mesh, state, bases[second]) - origin;
  const last = (bitLength(history.lastDistances[state]) << 2) | place, recentCorners = ((Math.min(Math.max(apart, -7), 7) + 7) << 2) | place;
  const far = (best << 7) | (bitLength(apart) << 1) | (apart < 0 ? 1 : 0);
  const share = (Math.floor((origin * 16) / (stateCounts + 1)) << 6) | bitLength(stateCounts);
  facts.set([0, recentCorners, far, (far << 8) | recentCorners, last, (last << 8) | recentCorners, share, ((distances[best] >> 6) << 2) | place]);
  const distance = readNumber(bits, facts, state), rank = origin + distance;
  if (rank < 0 || rank >= stateCounts) throw damaged();
  history.lastDistances[state] = distance;
  for (let base = 0; base < BASE_COUNT; base++) distances[base] += (256 * bitLength(vertexRank(mesh, state, bases[base]) - rank) - distances[base]) >> 4;
  return (history.lastUnguessed[place] = vertexAtRank(mesh, state, rank));
}

/** Read a number: whether it is not 0, its sign, the bit length of its magnitude, and the bits after the first. */
function readNumber(bits, facts, topic) {
  const next = (stage, node, known) => {
    for (let i = 0; i < CONTEXTS_PER_BIT; i++) {
      bits.contexts[i] = (known ? facts[i] << 20 : 0) | (node << 5) | (topic << 2) | stage;
      bits.above[i] = (known ? facts[i] >>> 12 : 0) | (1 << 28);
    }
    return bits.next(4 * (GUESS_COUNT + topic) + stage);
  };
  if (!next(0, 0, true)) return 0;
  const negative = next(1, 0, true);
  let length = 1, value = 1;
  while (next(2, (length << 1) | negative, true) && length < MAX_NUMBER_BITS) length++;
  for (let shift = length - 2; shift >= 0; shift--) value = 2 * value + next(3, (length << 6) | (value < 16 ? value : 16 + shift), value < 4);
  return negative ? -value : value;
}

const bitLength = (number) => 32 - Math.clz32(Math.abs(number));

/** Clamp a number for use as a context, which is from 1 to 63. */
const clamp = (number) => Math.min(Math.max(number, -31), 31) + 32;

/**
 * The triangles `Uint32Array(3F)` of polygons: the fans about their first corners. `counts` are the numbers of corners,
 * `corners` their vertices.
 */
export function triangulated(counts, corners) {
  const faces = new Uint32Array(3 * (corners.length - 2 * counts.length));
  let start = 0, k = 0;
  for (const count of counts) {
    for (let corner = start + 1; corner < start + count - 1; corner++) {
      faces[k++] = corners[start];
      faces[k++] = corners[corner];
      faces[k++] = corners[corner + 1];
    }
    start += count;
  }
  return faces;
}
