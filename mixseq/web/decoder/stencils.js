// Weights to begin with, of signals over a mesh of which only the connectivity is known: what bends the mesh least.
// Mirrors coding/bitstream/stencils.py.
import { MOST, find } from "./signal_graph_kernels.js";

const WIDEST = 16; // nodes of a stencil
const HUB = 32; // slopes at nodes with more neighbours do not count

/** What every node of a mesh's graph is predicted from at first: `neighbours` (N x width), `counts`, `weights`. */
export function stencils({ graph, levels }) {
  const size = graph.order.length, width = WIDEST;
  const found = { width, neighbours: new Int32Array(size * width), counts: graph.counts.slice(), weights: new Float64Array(size * width) };
  copyRows(graph, found);
  let lengths = levels.length ? new Float64Array(levels[0].beside.length).fill(1) : null;
  levels.forEach((level) => {
    const after = lengthsAfter(level, lengths);
    bend(level, lengths, after, graph.place, found);
    lengths = after;
  });
  return found;
}

/** Copy what nodes are predicted from to rows that may be wider. */
export function copyRows({ width, neighbours, counts, weights }, to) {
  for (let node = 0; node < counts.length; node++) {
    for (let i = 0; i < counts[node]; i++) {
      to.neighbours[node * to.width + i] = neighbours[node * width + i];
      to.weights[node * to.width + i] = weights[node * width + i];
    }
  }
}

/** Write the stencils of vertices that go, from lengths of edges before and after. */
function bend({ gone, starts, beside, newStarts, newBeside }, lengths, newLengths, place, found) {
  const slot = new Int32Array(place.length).fill(-1); // where a vertex is in the two lists
  const listed = new Int32Array(MOST * (HUB + 1)), shares = new Float64Array(MOST * (HUB + 1));
  const across = new Uint8Array(HUB); // whether the way there leads over the vertex
  for (let k = 0; k < gone.length; k++) {
    const vertex = gone[k], first = starts[vertex], degree = Math.min(starts[vertex + 1] - first, MOST);
    let slope = 0; // of the vertex, by its own value
    for (let at = first; at < first + degree; at++) slope += 1 / lengths[at];
    slope /= degree;
    for (let i = 0; i < degree; i++) {
      listed[i] = beside[first + i];
      shares[i] = slope / (degree * lengths[first + i]);
      slot[listed[i]] = i;
    }
    let size = degree, total = slope * slope;
    for (let i = 0; i < degree; i++) {
      const around = beside[first + i], side = lengths[first + i], low = newStarts[around], high = newStarts[around + 1];
      if (high - low > HUB) continue;
      let number = 1; // of neighbours that are left, and one
      for (let at = low; at < high; at++) {
        const where = slot[newBeside[at]];
        across[at - low] = where >= 0 && where < degree && newLengths[at] >= side + lengths[first + where] ? 1 : 0;
        number += 1 - across[at - low];
      }
      const own = 1 / (number * side);
      for (let at = low; at < high; at++) {
        if (across[at - low]) continue;
        const other = newBeside[at];
        if (slot[other] < 0) {
          slot[other] = size;
          listed[size] = other;
          shares[size++] = 0;
        }
        const one = own / (number * newLengths[at]);
        shares[i] += one;
        shares[slot[other]] -= one;
      }
      total += own * own;
      shares[i] += own * own;
    }
    for (let i = 0; i < size; i++) slot[listed[i]] = -1;
    write(place[vertex], degree, size, total, listed, shares, place, found);
  }
}

/** Write a stencil of a list: neighbours first, then those with the largest shares. */
function write(node, degree, size, total, listed, shares, place, { width, neighbours, counts, weights }) {
  const kept = Math.min(size, width);
  let left = 1;
  for (let i = 0; i < kept; i++) {
    let best = i;
    for (let j = i + 1; i >= degree && j < size; j++) if (Math.abs(shares[j]) > Math.abs(shares[best])) best = j;
    const vertex = listed[i], share = shares[i];
    listed[i] = listed[best];
    shares[i] = shares[best];
    listed[best] = vertex;
    shares[best] = share;
    left -= shares[i] / total;
  }
  counts[node] = kept;
  for (let i = 0; i < kept; i++) {
    neighbours[node * width + i] = place[listed[i]];
    weights[node * width + i] = shares[i] / total + left / kept;
  }
}

/** The lengths of the edges after vertices went, from those before: always the shortest. */
function lengthsAfter({ gone, starts, beside, ends, newStarts, newBeside }, lengths) {
  const found = new Float64Array(newBeside.length).fill(Infinity);
  keepLengths(starts, beside, lengths, newStarts, newBeside, found);
  for (let k = 0, count = 0; k < gone.length; k++) {
    const vertex = gone[k], first = starts[vertex], last = starts[vertex + 1];
    if (last - first < 2) continue;
    const best = ends[count], side = lengths[find(beside, first, last, best)];
    for (let at = first; at < last; at++) {
      if (beside[at] === best) continue;
      shorten(best, beside[at], side + lengths[at], newStarts, newBeside, found);
      shorten(beside[at], best, side + lengths[at], newStarts, newBeside, found);
      count++;
    }
  }
  return found;
}

/** Take over the lengths of edges that stay. */
function keepLengths(starts, beside, lengths, newStarts, newBeside, found) {
  for (let vertex = 0; vertex < starts.length - 1; vertex++) {
    let at = starts[vertex];
    const end = starts[vertex + 1];
    for (let where = newStarts[vertex]; where < newStarts[vertex + 1]; where++) {
      while (at < end && beside[at] < newBeside[where]) at++;
      if (at < end && beside[at] === newBeside[where]) found[where] = lengths[at];
    }
  }
}

function shorten(one, other, length, starts, beside, lengths) {
  const where = find(beside, starts[one], starts[one + 1], other);
  lengths[where] = Math.min(lengths[where], length);
}
