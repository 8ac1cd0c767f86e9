// Guesses at the texture coordinates of a node from those around it, as in mixseq/compression/bitstream/uv_seams.py.

/** What a guess is made of. */
export const COPIED = 0;
export const AROUND = 1;
export const BEYOND = 2;
export const BESIDE = 3;
export const ANYWHERE = 4;

/** Room for a guess; the names are those of the Python module, but for `facts`, which are `kind`, `count` and `spread`. */
export const noGuess = () => ({ at: [0, 0], back: [0, 0], low: [0, 0], high: [0, 0], kind: ANYWHERE, count: 0, spread: 0 });

/** Guess the coordinates at a corner; `last` is the node that was known last, -1 for none. */
export function makeGuess(corners, { values, there }, corner, last, guess) {
  const { starts, polygon, node, twin, before, after, aroundStarts, around } = corners, x = node[corner];
  const { at, back, low, high } = guess;
  let count = 0;
  at.fill(0);
  back.fill(0);

  function add(u, v) {
    at[0] += u;
    at[1] += v;
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
    if (!(there[a] && there[b] && there[z]) || z === x) continue;
    const u = values[2 * a] + values[2 * b], v = values[2 * a + 1] + values[2 * b + 1], zu = values[2 * z], zv = values[2 * z + 1];
    back[0] += u - zu - (u >> 1);
    back[1] += v - zv - (v >> 1);
    add(u - zu, v - zv);
  }
  guess.kind = AROUND;
  if (count) for (let i = 0; i < 2; i++) back[i] = Math.floor((3 * Math.floor(back[i] / count)) / 8);
  else beyond();

  function beyond() {
    const a = before[corner], b = after[corner];
    const reach = (beside, edge, next) => {
      if (edge < 0 || !there[beside]) return;
      const e = node[next(edge)];
      if (there[e]) add(2 * values[2 * beside] - values[2 * e], 2 * values[2 * beside + 1] - values[2 * e + 1]);
    };
    guess.kind = BEYOND;
    reach(node[a], twin[before[a]], (edge) => before[edge]);
    reach(node[b], twin[b], (edge) => after[after[edge]]);
    if (count) return;
    guess.kind = BESIDE;
    for (const beside of [node[a], node[b]]) if (there[beside]) add(values[2 * beside], values[2 * beside + 1]);
    if (count) return;
    guess.kind = ANYWHERE;
    add(last < 0 ? 0 : values[2 * last], last < 0 ? 0 : values[2 * last + 1]);
  }

  guess.count = count;
  guess.spread = high[0] - low[0] + high[1] - low[1];
  for (let i = 0; i < 2; i++) at[i] = Math.floor((2 * at[i] + count) / (2 * count));
}
