// What is added to decoded frames to bring every vertex below a bound. Mirrors coding/bitstream/residual_layer.py.
import { MixseqError, guarded } from "./errors.js";
import { placeIn } from "./operator.js";
import { Reader } from "./signal_coder.js";
import { emptyFrame, readFrame, residualModels } from "./residual_kernels.js";

const RUN = 16; // frames that are coded together
const KEPT = 8; // decoded runs
const NEAR = 1e-9; // frames: a frame is a frame, after rounding

/**
 * The residual layer of a sequence, decoded where it is asked for: of `chunks` with `first`, `count` and `residuals`.
 * `graphOf()` is the graph of the mesh.
 */
export class ResidualLayer {
  constructor(times, chunks, graphOf, unit) {
    Object.assign(this, { times, chunks, graphOf, unit });
    this.runs = new Map();
    this.taken = []; // frames of chunks that were decoded elsewhere
  }

  /** The residuals of all frames of a chunk. */
  chunk(number) {
    const { first, count } = this.chunks[number];
    return Array.from({ length: count }, (_, k) => this.frame(first + k));
  }

  /** Take what `chunk` made. */
  take(number, frames) {
    this.taken[number] = frames;
  }

  /** Add the displacements at a time to positions; whether there were any. */
  addTo(positions, time) {
    const { frame, share } = placeOf(this.times, time);
    const before = this.addFrame(positions, frame, 1 - share);
    return (share > 0 && this.addFrame(positions, frame + 1, share)) || before;
  }

  addFrame(positions, frame, share) {
    const { vertices, numbers } = this.frame(frame), unit = share * this.unit;
    for (let i = 0; i < vertices.length; i++) {
      for (let axis = 0; axis < 3; axis++) positions[3 * vertices[i] + axis] += unit * numbers[3 * i + axis];
    }
    return vertices.length > 0;
  }

  /** Which vertices of a frame are displaced, and how far, in units of the layer. */
  frame(frame) {
    const place = this.chunks.findIndex(({ first, count }) => frame < first + count), chunk = this.chunks[place];
    if (this.taken[place]) return this.taken[place][frame - chunk.first];
    const number = Math.floor((frame - chunk.first) / RUN), key = chunk.first + number * RUN;
    let run = this.runs.get(key);
    if (!run) {
      run = guarded(`the residuals of frames ${key} and on`, () => readResiduals(chunk, number, this.graphOf()));
      this.runs.set(key, run);
      if (this.runs.size > KEPT) this.runs.delete(this.runs.keys().next().value);
    }
    return run[frame - key];
  }
}

/** The frame at or before a time, and how far it is on the way to the next. */
function placeOf(times, time) {
  const after = placeIn(times, time), share = after && (time - times[after - 1]) / (times[after] - times[after - 1]);
  if (!after || share > 1 - NEAR) return { frame: after, share: 0 };
  return { frame: after - 1, share: share < NEAR ? 0 : share };
}

/** The residuals of a run of frames. */
function readResiduals({ count, residuals }, run, graph) {
  const frames = Math.min(RUN, count - run * RUN), runs = Math.ceil(count / RUN), nothing = { vertices: [], numbers: [] };
  let start = 4 * runs, from = 0, to = 0;
  if (!residuals.length) return new Array(frames).fill(nothing);
  const view = new DataView(residuals.buffer, residuals.byteOffset, residuals.length);
  for (let k = 0; k < runs && start <= residuals.length; k++) {
    from = k === run ? start : from;
    start += view.getUint32(4 * k, true);
    to = k === run ? start : to;
  }
  if (start !== residuals.length) throw new MixseqError("a residual layer has another length than it says; it is damaged");
  return from === to ? new Array(frames).fill(nothing) : readRun(residuals.subarray(from, to), frames, graph);
}

function readRun(stream, count, graph) {
  const reader = new Reader(stream), models = residualModels(), frames = [];
  let last = emptyFrame(graph.order.length);
  for (let frame = 0; frame < count; frame++) {
    last = readFrame(reader.bits(), models, graph, last);
    reader.checked(last.numbers);
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
