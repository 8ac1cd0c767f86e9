// The residual layer: corrections of decoded frames that bring every vertex within a bound. Mirrors mixseq/compression/bitstream/residual_layer.py.
import { BitModels } from "./arithmetic.js";
import { lowerBound } from "./curve.js";
import { MixseqError, guarded } from "./errors.js";
import { Reader } from "./signal_coder.js";
import { NEIGHBOUR_COUNTS } from "./signal_graph.js";

const MAX_MODELLED_NUMBER = 8, MAX_EXCESS_BITS = 62; // largest number with models; largest bit length of the excess
const CONTEXTS_PER_BIT = 3, CONTEXT_VALUES = 3 * NEIGHBOUR_COUNTS * NEIGHBOUR_COUNTS, POSITION_COUNT = 4 + MAX_MODELLED_NUMBER;

/** Models of the bits of a run. */
const newResidualModels = () => new BitModels(CONTEXTS_PER_BIT, CONTEXT_VALUES, POSITION_COUNT);

/** A frame without residuals: `numbers` (N x 3) of nodes, and whether they are `displaced`. */
const emptyFrame = (size) => ({ numbers: new Float64Array(3 * size), displaced: new Uint8Array(size) });

/** Read a frame, in contexts of the last frame. */
function readFrame(stream, models, { width, neighbours, counts, ring, ringStarts }, last) {
  const contexts = models.contexts.fill(0), frame = emptyFrame(counts.length), { numbers, displaced } = frame;
  if (!models.read(stream, 0)) return frame;
  const sums = new Int32Array(3);
  for (let node = 0; node < counts.length; node++) {
    const count = counts[node], own = last.displaced[node];
    let displacedCount = 0, lastDisplaced = 0, nonzeroAxes = 0;
    sums.fill(0);
    for (let at = node * width, end = at + count; at < end; at++) {
      const neighbour = neighbours[at];
      if (!displaced[neighbour]) continue;
      displacedCount++;
      for (let k = 0; k < 3; k++) sums[k] += Math.sign(numbers[3 * neighbour + k]);
    }
    for (let place = ringStarts[node]; place < ringStarts[node + 1]; place++) lastDisplaced += last.displaced[ring[place]];
    const around = own ? 2 : Math.min(lastDisplaced, 1);
    contexts[0] = (displacedCount * NEIGHBOUR_COUNTS + count) * 3 + around;
    contexts[1] = (Math.min(lastDisplaced, NEIGHBOUR_COUNTS - 1) * NEIGHBOUR_COUNTS + Math.min(displacedCount, 3)) * 2 + own;
    contexts[2] = Math.min(displacedCount, 3) * 3 + around;
    if (!models.read(stream, 1)) continue;
    for (let k = 0; k < 3; k++) {
      const here = clamp(last.numbers[3 * node + k]) + 3, around = clamp(sums[k]) + 3;
      contexts[0] = here * 7 + around;
      contexts[1] = (nonzeroAxes * 7 + around) * 3 + k;
      contexts[2] = (nonzeroAxes * 7 + here) * 3 + k;
      const number = readCoordinate(stream, models);
      numbers[3 * node + k] = number;
      if (number) nonzeroAxes |= 1 << k;
    }
    displaced[node] = nonzeroAxes ? 1 : 0;
  }
  return frame;
}

function readCoordinate(stream, models) {
  if (!models.read(stream, 2)) return 0;
  const negative = models.read(stream, 3);
  let value = 0;
  while (value < MAX_MODELLED_NUMBER && models.read(stream, 4 + value)) value++;
  if (value === MAX_MODELLED_NUMBER) {
    let length = 0;
    while (length < MAX_EXCESS_BITS && stream.rawBits(1)) length++;
    value += stream.rawBits(length);
  }
  return negative ? -(value + 1) : value + 1;
}

const clamp = (number) => Math.min(Math.max(number, -3), 3);

const FRAMES_PER_RUN = 16; // frames coded together
const MAX_CACHED_RUNS = 8; // decoded runs that are kept
const FRAME_TOLERANCE = 1e-9; // times this near to a frame, in frames, are the frame's

/**
 * The residual layer of a sequence, decoded on demand from `chunks` with `first`, `count` and `residuals`. `graphOf()` is the
 * graph of the mesh.
 */
export class ResidualLayer {
  constructor(times, chunks, graphOf, unit) {
    Object.assign(this, { times, chunks, graphOf, unit });
    this.runs = new Map();
    this.taken = []; // frames of chunks that were decoded in another thread
  }

  /** The residuals of all frames of a chunk. */
  chunk(number) {
    const { first, count } = this.chunks[number];
    return Array.from({ length: count }, (_, k) => this.frame(first + k));
  }

  /** Take the frames that `chunk` returned in another thread. */
  take(number, frames) {
    this.taken[number] = frames;
  }

  /** Add the displacements at a time to positions; return whether there were any. */
  addTo(positions, time) {
    const { frame, fraction } = locateTime(this.times, time);
    const before = this.addFrame(positions, frame, 1 - fraction);
    return (fraction > 0 && this.addFrame(positions, frame + 1, fraction)) || before;
  }

  addFrame(positions, frame, fraction) {
    const { vertices, numbers } = this.frame(frame), unit = fraction * this.unit;
    for (let i = 0; i < vertices.length; i++) {
      for (let axis = 0; axis < 3; axis++) positions[3 * vertices[i] + axis] += unit * numbers[3 * i + axis];
    }
    return vertices.length > 0;
  }

  /** The displaced vertices of a frame, and their displacements in units of the layer. */
  frame(frame) {
    const place = this.chunks.findIndex(({ first, count }) => frame < first + count), chunk = this.chunks[place];
    if (this.taken[place]) return this.taken[place][frame - chunk.first];
    const number = Math.floor((frame - chunk.first) / FRAMES_PER_RUN), key = chunk.first + number * FRAMES_PER_RUN;
    let run = this.runs.get(key);
    if (!run) {
      run = guarded(`the residuals of frames ${key} and on`, () => readResiduals(chunk, number, this.graphOf()));
      this.runs.set(key, run);
      if (this.runs.size > MAX_CACHED_RUNS) this.runs.delete(this.runs.keys().next().value);
    }
    return run[frame - key];
  }
}

/** The frame at or before a time, and the fraction of the way to the next. */
function locateTime(times, time) {
  const after = lowerBound(times, time), fraction = after && (time - times[after - 1]) / (times[after] - times[after - 1]);
  if (!after || fraction > 1 - FRAME_TOLERANCE) return { frame: after, fraction: 0 };
  return { frame: after - 1, fraction: fraction < FRAME_TOLERANCE ? 0 : fraction };
}

/** The residuals of a run of frames. */
function readResiduals({ count, residuals }, run, graph) {
  const frames = Math.min(FRAMES_PER_RUN, count - run * FRAMES_PER_RUN), runs = Math.ceil(count / FRAMES_PER_RUN), noResiduals = { vertices: [], numbers: [] };
  let start = 4 * runs, from = 0, to = 0;
  if (!residuals.length) return new Array(frames).fill(noResiduals);
  const view = new DataView(residuals.buffer, residuals.byteOffset, residuals.length);
  for (let k = 0; k < runs && start <= residuals.length; k++) {
    from = k === run ? start : from;
    start += view.getUint32(4 * k, true);
    to = k === run ? start : to;
  }
  if (start !== residuals.length) throw new MixseqError("a residual layer has another length than stated; it is damaged");
  return from === to ? new Array(frames).fill(noResiduals) : readRun(residuals.subarray(from, to), frames, graph);
}

function readRun(stream, count, graph) {
  const reader = new Reader(stream), models = newResidualModels(), frames = [];
  let last = emptyFrame(graph.order.length);
  for (let frame = 0; frame < count; frame++) {
    last = readFrame(reader.stream(), models, graph, last);
    reader.addToChecksum(last.numbers);
    frames.push(residualsOf(last, graph.order));
  }
  reader.finish();
  return frames;
}

function residualsOf({ numbers, displaced }, order) {
  const nodes = [];
  for (let node = 0; node < order.length; node++) if (displaced[node]) nodes.push(node);
  return {
    vertices: Uint32Array.from(nodes, (node) => order[node]),
    numbers: Float64Array.from({ length: 3 * nodes.length }, (_, k) => numbers[3 * nodes[Math.floor(k / 3)] + (k % 3)]),
  };
}
