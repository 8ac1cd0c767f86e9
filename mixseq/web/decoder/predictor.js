// Predict signals over a graph from earlier ones. Mirrors mixseq/compression/bitstream/predictor.py.
import { UNITS_PER_STEP, accumulateGram, computeTrust, entries, findSimilarNodes, roundWeights, solveWeights } from "./predictor_kernels.js";
import { MAX_NEIGHBOURS, find } from "./signal_graph.js";

// Initial weights of signals over a mesh, from connectivity alone: those of least bending.

const MAX_STENCIL_NODES = 16; // largest number of nodes in a stencil
const MAX_SLOPE_NEIGHBOURS = 32; // slopes at nodes of more neighbours are ignored

/** The initial stencils of a mesh's graph: `neighbours` (N x width), `counts`, `weights`. */
export function graphStencils({ graph, levels }) {
  const size = graph.order.length, width = MAX_STENCIL_NODES;
  const found = { width, neighbours: new Int32Array(size * width), counts: graph.counts.slice(), weights: new Float64Array(size * width) };
  copyRows(graph, found);
  let lengths = levels.length ? new Float64Array(levels[0].adjacent.length).fill(1) : null;
  levels.forEach((level) => {
    const after = updateLengths(level, lengths);
    fitStencils(level, lengths, after, graph.place, found);
    lengths = after;
  });
  return found;
}

/** Copy neighbours and weights to rows that may be wider. */
function copyRows({ width, neighbours, counts, weights }, to) {
  for (let node = 0; node < counts.length; node++) {
    for (let i = 0; i < counts[node]; i++) {
      to.neighbours[node * to.width + i] = neighbours[node * width + i];
      to.weights[node * to.width + i] = weights[node * width + i];
    }
  }
}

/** Write the stencils of removed vertices, from edge lengths before and after. */
function fitStencils({ removed, starts, adjacent, newStarts, newAdjacent }, lengths, newLengths, place, found) {
  const slot = new Int32Array(place.length).fill(-1); // where a vertex is in the two lists
  const listed = new Int32Array(MAX_NEIGHBOURS * (MAX_SLOPE_NEIGHBOURS + 1)), rawWeights = new Float64Array(MAX_NEIGHBOURS * (MAX_SLOPE_NEIGHBOURS + 1));
  const across = new Uint8Array(MAX_SLOPE_NEIGHBOURS); // whether the path to a neighbour leads across the vertex
  for (let k = 0; k < removed.length; k++) {
    const vertex = removed[k], first = starts[vertex], degree = Math.min(starts[vertex + 1] - first, MAX_NEIGHBOURS);
    let slope = 0; // of the vertex, by its own value
    for (let at = first; at < first + degree; at++) slope += 1 / lengths[at];
    slope /= degree;
    for (let i = 0; i < degree; i++) {
      listed[i] = adjacent[first + i];
      rawWeights[i] = slope / (degree * lengths[first + i]);
      slot[listed[i]] = i;
    }
    let size = degree, total = slope * slope;
    for (let i = 0; i < degree; i++) {
      const neighbour = adjacent[first + i], length = lengths[first + i], low = newStarts[neighbour], high = newStarts[neighbour + 1];
      if (high - low > MAX_SLOPE_NEIGHBOURS) continue;
      let number = 1; // of remaining neighbours, plus one
      for (let at = low; at < high; at++) {
        const where = slot[newAdjacent[at]];
        across[at - low] = where >= 0 && where < degree && newLengths[at] >= length + lengths[first + where] ? 1 : 0;
        number += 1 - across[at - low];
      }
      const slope = 1 / (number * length);
      for (let at = low; at < high; at++) {
        if (across[at - low]) continue;
        const other = newAdjacent[at];
        if (slot[other] < 0) {
          slot[other] = size;
          listed[size] = other;
          rawWeights[size++] = 0;
        }
        const rawWeight = slope / (number * newLengths[at]);
        rawWeights[i] += rawWeight;
        rawWeights[slot[other]] -= rawWeight;
      }
      total += slope * slope;
      rawWeights[i] += slope * slope;
    }
    for (let i = 0; i < size; i++) slot[listed[i]] = -1;
    writeStencil(place[vertex], degree, size, total, listed, rawWeights, place, found);
  }
}

/** Write a stencil: neighbours first, then the nodes of the largest weights. */
function writeStencil(node, degree, size, total, listed, rawWeights, place, { width, neighbours, counts, weights }) {
  const kept = Math.min(size, width);
  let remainder = 1;
  for (let i = 0; i < kept; i++) {
    let best = i;
    for (let j = i + 1; i >= degree && j < size; j++) if (Math.abs(rawWeights[j]) > Math.abs(rawWeights[best])) best = j;
    const vertex = listed[i], weight = rawWeights[i];
    listed[i] = listed[best];
    rawWeights[i] = rawWeights[best];
    listed[best] = vertex;
    rawWeights[best] = weight;
    remainder -= rawWeights[i] / total;
  }
  counts[node] = kept;
  for (let i = 0; i < kept; i++) {
    neighbours[node * width + i] = place[listed[i]];
    weights[node * width + i] = rawWeights[i] / total + remainder / kept;
  }
}

/** The lengths of edges after vertices were removed, the shortest each, from those before. */
function updateLengths({ removed, starts, adjacent, ends, newStarts, newAdjacent }, lengths) {
  const found = new Float64Array(newAdjacent.length).fill(Infinity);
  copyLengths(starts, adjacent, lengths, newStarts, newAdjacent, found);
  for (let k = 0, count = 0; k < removed.length; k++) {
    const vertex = removed[k], first = starts[vertex], last = starts[vertex + 1];
    if (last - first < 2) continue;
    const best = ends[count], length = lengths[find(adjacent, first, last, best)];
    for (let at = first; at < last; at++) {
      if (adjacent[at] === best) continue;
      shorten(best, adjacent[at], length + lengths[at], newStarts, newAdjacent, found);
      shorten(adjacent[at], best, length + lengths[at], newStarts, newAdjacent, found);
      count++;
    }
  }
  return found;
}

/** Copy the lengths of remaining edges. */
function copyLengths(starts, adjacent, lengths, newStarts, newAdjacent, found) {
  for (let vertex = 0; vertex < starts.length - 1; vertex++) {
    let at = starts[vertex];
    const end = starts[vertex + 1];
    for (let where = newStarts[vertex]; where < newStarts[vertex + 1]; where++) {
      while (at < end && adjacent[at] < newAdjacent[where]) at++;
      if (at < end && adjacent[at] === newAdjacent[where]) found[where] = lengths[at];
    }
  }
}

function shorten(rawWeight, other, length, starts, adjacent, lengths) {
  const where = find(adjacent, starts[rawWeight], starts[rawWeight + 1], other);
  lengths[where] = Math.min(lengths[where], length);
}

const SIMILAR_VERTICES = 8, SIMILAR_FRAMES = 16; // most similar nodes joined to a node: vertices, or frames
const SIMILARITY_SEARCH_SIGNALS = 5; // signals, times their coordinates, at which these are searched for
const EXHAUSTIVE_SEARCH_NODES = 2048; // first nodes that search all nodes before them
const RIDGE_PER_SIGNAL = 0.5; // squared rounding error of a known signal, in steps
const ROUGHNESS_SCALE = 10; // mean squared difference of neighbours, in squared steps, above which trust falls
const TRUST_DOUBLING_SIGNALS = 16, MAX_TRUST_DOUBLINGS = 512; // signals after which trust is doubled; largest number of doublings
const RENEWAL_SHIFT = 2; // weights are updated after a quarter more signals: 1/2 to this power
const STEP_RATIO_TENTHS = 9, MIN_STEP_UNITS = 38; // ratio of steps of successive coarser levels, in tenths; smallest step
const UNIFORM_STEP_SIGNALS = 3; // signals, times their coordinates, with the same step at all nodes

/**
 * Weights fitted to signals over a graph. The decoder fills `values` node by node, and calls `finish` after the last one.
 * `stencil` has the initial neighbours and weights; a graph over time is its own stencil.
 */
export class Predictor {
  constructor(graph, stencil, coordinates) {
    const size = graph.order.length;
    this.graph = graph;
    this.similaritySearchAt = SIMILARITY_SEARCH_SIGNALS * coordinates;
    this.uniformStepsUntil = graph.isOverTime ? Infinity : UNIFORM_STEP_SIGNALS * coordinates;
    this.signalCount = 0;
    this.nextUpdate = 1;
    this.pending = []; // signals that are not in the Gram matrices
    this.signals = []; // all, until similar nodes are searched for
    this.values = new Float64Array(size);
    this.steps = new Float64Array(size).fill(UNITS_PER_STEP);
    this.setNeighbours(stencil);
  }

  /** Set the neighbours of nodes, and their initial weights. */
  setNeighbours({ width, neighbours, counts, weights }) {
    this.initialWeights = roundWeights(weights);
    this.stencil = { width, neighbours, counts, weights: this.initialWeights.slice() };
    this.gram = new Float64Array(counts.reduce((sum, count) => sum + entries(count), 0));
    this.ridge = 0;
  }

  /** Learn from the finished signal, and prepare for the next one. */
  finish() {
    const signal = this.values.slice(), signalCount = ++this.signalCount;
    this.pending.push(signal);
    if (signalCount === this.uniformStepsUntil) this.steps = levelSteps(this.steps.length);
    if (signalCount <= this.similaritySearchAt) this.signals.push(signal);
    if (signalCount === this.similaritySearchAt) this.addSimilarNodes();
    if (signalCount === this.similaritySearchAt || signalCount >= this.nextUpdate) {
      this.updateWeights();
      this.nextUpdate = signalCount + Math.max(1, signalCount >> RENEWAL_SHIFT);
    }
  }

  /** Add the pending signals to the Gram matrices, and solve for weights. */
  updateWeights() {
    const { stencil, pending, gram } = this, first = this.signalCount - pending.length;
    const trusts = pending.map((signal, k) => {
      let trust = computeTrust(signal, ROUGHNESS_SCALE * UNITS_PER_STEP * UNITS_PER_STEP, stencil);
      for (let age = Math.min(Math.floor((first + k) / TRUST_DOUBLING_SIGNALS), MAX_TRUST_DOUBLINGS); age > 0; age--) trust *= 2;
      return trust;
    });
    this.ridge += RIDGE_PER_SIGNAL * UNITS_PER_STEP * UNITS_PER_STEP * trusts.reduce((sum, one) => sum + one, 0);
    accumulateGram(pending, trusts, stencil, gram);
    solveWeights(this.ridge, stencil, gram, this.initialWeights, stencil.weights);
    this.pending = [];
  }

  /** Join every node to the most similar nodes before it in all known signals. */
  addSimilarNodes() {
    const { graph, signals } = this, most = graph.isOverTime ? SIMILAR_FRAMES : SIMILAR_VERTICES;
    this.setNeighbours(withExtraNeighbours(graph, findSimilarNodes(signals, graph, EXHAUSTIVE_SEARCH_NODES, most), most));
    this.pending = signals;
    this.signals = [];
  }
}

/** The neighbours of a graph, and up to `most` more with initial weight zero. */
function withExtraNeighbours(graph, { similar, similarCounts }, most) {
  const size = graph.order.length, width = graph.width + most;
  const neighbours = new Int32Array(size * width), weights = new Float64Array(size * width);
  const counts = graph.counts.map((count, node) => count + similarCounts[node]);
  copyRows(graph, { width, neighbours, weights });
  copySimilar(graph.counts, similar, similarCounts, most, neighbours, width);
  return { width, neighbours, counts, weights };
}

function copySimilar(counts, similar, similarCounts, most, neighbours, width) {
  for (let node = 0; node < counts.length; node++) {
    const first = node * width + counts[node];
    for (let i = 0; i < similarCounts[node]; i++) neighbours[first + i] = similar[node * most + i];
  }
}

/** Steps of `size` nodes in units, smaller on coarse levels, whose errors finer ones inherit. */
function levelSteps(size) {
  const steps = new Float64Array(size).fill(UNITS_PER_STEP);
  for (let first = size >> 1, step = UNITS_PER_STEP; first; first >>= 1) {
    step = Math.max(Math.floor((step * STEP_RATIO_TENTHS) / 10), MIN_STEP_UNITS);
    steps.fill(step, 0, first);
  }
  return steps;
}
