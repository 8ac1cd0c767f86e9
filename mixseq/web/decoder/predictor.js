// Predict the values of signals over a graph, from those before it. Mirrors coding/bitstream/predictor.py.
import { UNIT, entries, learn, nearest, rounded, solve, trust } from "./predictor_kernels.js";
import { copyRows } from "./stencils.js";

const SIMILAR = 8, SIMILAR_FRAMES = 16; // nodes that are most like a node are joined to it: vertices, or frames
const SEARCHED = 5; // signals, times their coordinates, when these are looked for
const EXHAUSTIVE = 2048; // nodes that look at all nodes before them
const RIDGE = 0.5; // squared rounding error of a known signal, in steps
const ROUGH = 10; // signals whose squared differences are above this teach less
const DOUBLED = 16, AGES = 512; // every so many signals trust is doubled, at most so many times
const SELDOM = 2; // weights are renewed after a share of the signals, as a power of 1/2
const FINER = 9, FINEST = 38; // tenths of a step that that of a coarser level is, at least so many units
const EQUAL = 3; // signals, times their coordinates, of which all nodes have the same step

/**
 * What is known about signals over a graph. Whoever decodes fills `values` node by node, and calls `finish` after the last.
 * `stencil` is what nodes are predicted from at first; a graph over time is its own.
 */
export class Predictor {
  constructor(graph, stencil, coordinates) {
    const size = graph.order.length;
    this.graph = graph;
    this.searched = SEARCHED * coordinates;
    this.equal = graph.overTime ? Infinity : EQUAL * coordinates;
    this.known = 0;
    this.due = 1;
    this.pending = []; // signals that the weights do not know yet
    this.signals = []; // all, until similar nodes are looked for
    this.values = new Float64Array(size);
    this.steps = new Float64Array(size).fill(UNIT);
    this.join(stencil);
  }

  /** Predict nodes from these, with these weights as long as nothing is known about them. */
  join({ width, neighbours, counts, weights }) {
    this.start = rounded(weights);
    this.from = { width, neighbours, counts, weights: this.start.slice() };
    this.gram = new Float64Array(counts.reduce((sum, count) => sum + entries(count), 0));
    this.ridge = 0;
  }

  /** Learn from the signal whose values are all known, and be ready for the next one. */
  finish() {
    const signal = this.values.slice(), known = ++this.known;
    this.pending.push(signal);
    if (known === this.equal) this.steps = finerSteps(this.steps.length);
    if (known <= this.searched) this.signals.push(signal);
    if (known === this.searched) this.joinSimilar();
    if (known === this.searched || known >= this.due) {
      this.renew();
      this.due = known + Math.max(1, known >> SELDOM);
    }
  }

  /** Learn from the signals that are waiting, and find weights. */
  renew() {
    const { from, pending, gram } = this, first = this.known - pending.length;
    const trusts = pending.map((signal, k) => {
      let share = trust(signal, ROUGH * UNIT * UNIT, from);
      for (let age = Math.min(Math.floor((first + k) / DOUBLED), AGES); age > 0; age--) share *= 2;
      return share;
    });
    this.ridge += RIDGE * UNIT * UNIT * trusts.reduce((sum, one) => sum + one, 0);
    learn(pending, trusts, from, gram);
    solve(this.ridge, from, gram, this.start, from.weights);
    this.pending = [];
  }

  /** Join every node to those before it that are most like it in all signals that are known. */
  joinSimilar() {
    const { graph, signals } = this, most = graph.overTime ? SIMILAR_FRAMES : SIMILAR;
    this.join(withMore(graph, nearest(signals, graph, EXHAUSTIVE, most), most));
    this.pending = signals;
    this.signals = [];
  }
}

/** The neighbours of a graph, and `most` further ones at most, at first without weight. */
function withMore(graph, { similar, found }, most) {
  const size = graph.order.length, width = graph.width + most;
  const neighbours = new Int32Array(size * width), weights = new Float64Array(size * width);
  const counts = graph.counts.map((count, node) => count + found[node]);
  copyRows(graph, { width, neighbours, weights });
  addSimilar(graph.counts, similar, found, most, neighbours, width);
  return { width, neighbours, counts, weights };
}

function addSimilar(counts, similar, found, most, neighbours, width) {
  for (let node = 0; node < counts.length; node++) {
    const first = node * width + counts[node];
    for (let i = 0; i < found[node]; i++) neighbours[first + i] = similar[node * most + i];
  }
}

/** Steps of so many nodes, in units: smaller on coarse levels, whose errors finer ones inherit. */
function finerSteps(size) {
  const steps = new Float64Array(size).fill(UNIT);
  for (let first = size >> 1, step = UNIT; first; first >>= 1) {
    step = Math.max(Math.floor((step * FINER) / 10), FINEST);
    steps.fill(step, 0, first);
  }
  return steps;
}
