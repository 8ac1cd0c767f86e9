// Predict signals over a graph from earlier ones. Mirrors mixseq/compression/bitstream/predictor.py.
import { UNITS_PER_STEP, entries, accumulateGram, findSimilarNodes, roundWeights, solveWeights, computeTrust } from "./predictor_kernels.js";
import { copyRows } from "./stencils.js";

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
