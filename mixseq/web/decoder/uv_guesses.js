// Guesses at the texture coordinates of a node from adjacent nodes. Mirrors mixseq/compression/bitstream/uv_seams.py.

/** Kinds of guesses. */
export const COPIED = 0;
export const AROUND = 1;
export const BEYOND = 2;
export const BESIDE = 3;
export const ANYWHERE = 4;

/** An empty guess; the names are those of the Python module, with `kind`, `count` and `spread` for `facts`. */
export const newGuess = () => ({ value: [0, 0], drawBack: [0, 0], low: [0, 0], high: [0, 0], kind: ANYWHERE, count: 0, spread: 0 });

/** Guess the coordinates at a corner; `last` is the last known node, -1 for none. */
export function makeGuess(corners, { values, isKnown }, corner, last, guess) {
  const { starts, polygon, node, twin, before, after, aroundStarts, around } = corners, x = node[corner];
  const { value, drawBack, low, high } = guess;
  let count = 0;
  value.fill(0);
  drawBack.fill(0);

  function addToMean(u, v) {
    value[0] += u;
    value[1] += v;
    low[0] = count ? Math.min(low[0], u) : u;
    low[1] = count ? Math.min(low[1], v) : v;
    high[0] = count ? Math.max(high[0], u) : u;
    high[1] = count ? Math.max(high[1], v) : v;
    count++;
  }

  for (let place = aroundStarts[x]; place < aroundStarts[x + 1]; place++) {
    const other = around[place], a = node[before[other]], edge = after[other], b = node[edge], size = starts[polygon[other] + 1] - starts[polygon[other]];
    let across = after[edge];
    if (size === 3 && twin[edge] >= 0) across = before[twin[edge]];
    else if (size !== 4) continue;
    const z = node[across];
    if (!(isKnown[a] && isKnown[b] && isKnown[z]) || z === x) continue;
    const u = values[2 * a] + values[2 * b], v = values[2 * a + 1] + values[2 * b + 1], zu = values[2 * z], zv = values[2 * z + 1];
    drawBack[0] += u - zu - (u >> 1);
    drawBack[1] += v - zv - (v >> 1);
    addToMean(u - zu, v - zv);
  }
  guess.kind = AROUND;
  if (count) for (let i = 0; i < 2; i++) drawBack[i] = Math.floor((3 * Math.floor(drawBack[i] / count)) / 8);
  else guessBeyond();

  function guessBeyond() {
    const a = before[corner], b = after[corner];
    const addBeyond = (near, edge, next) => {
      if (edge < 0 || !isKnown[near]) return;
      const e = node[next(edge)];
      if (isKnown[e]) addToMean(2 * values[2 * near] - values[2 * e], 2 * values[2 * near + 1] - values[2 * e + 1]);
    };
    guess.kind = BEYOND;
    addBeyond(node[a], twin[before[a]], (edge) => before[edge]);
    addBeyond(node[b], twin[b], (edge) => after[after[edge]]);
    if (count) return;
    guess.kind = BESIDE;
    for (const near of [node[a], node[b]]) if (isKnown[near]) addToMean(values[2 * near], values[2 * near + 1]);
    if (count) return;
    guess.kind = ANYWHERE;
    addToMean(last < 0 ? 0 : values[2 * last], last < 0 ? 0 : values[2 * last + 1]);
  }

  guess.count = count;
  guess.spread = high[0] - low[0] + high[1] - low[1];
  for (let i = 0; i < 2; i++) value[i] = Math.floor((2 * value[i] + count) / (2 * count));
}
