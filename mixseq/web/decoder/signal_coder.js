// Read signals over a graph: basis vectors over a mesh, coefficients over time. Mirrors
// mixseq/compression/bitstream/signal_coder.py.
import { BitStream } from "./arithmetic.js";
import { BitModels } from "./bit_models.js";
import { checksumOf, verifyChecksum, splitChecksum } from "./decoded_check.js";
import { MixseqError } from "./errors.js";
import { Predictor } from "./predictor.js";
import { CONTEXT_VALUES, CONTEXTS_PER_BIT, POSITION_COUNT, updateActivity, readSignal } from "./signal_kernels.js";

/** A stream, and the checksum of its decoded values. */
export class Reader {
  #stream;

  constructor(stream) {
    const { data, expected } = splitChecksum(stream);
    this.#stream = new BitStream(data);
    this.expected = expected;
    this.checksum = 0;
  }

  /** The stream; it must not have ended. */
  stream() {
    if (this.#stream.isPastEnd()) throw new MixseqError("the coded signals are damaged, they end early");
    return this.#stream;
  }

  /** Add decoded values to the checksum. */
  addToChecksum(numbers) {
    this.checksum = checksumOf(numbers, this.checksum);
  }

  /** Verify that the decoded values are those that were written. */
  finish() {
    verifyChecksum(this.checksum, this.expected);
  }
}

/** Models of the bits of numbers; coders of several graphs can share them. */
export const newNumberModels = () => new BitModels(CONTEXTS_PER_BIT, CONTEXT_VALUES, POSITION_COUNT);

/** Reads signals over a graph; `coordinates` of them belong together. */
export class SignalCoder {
  constructor(graph, stencil, coordinates, models) {
    const size = graph.order.length;
    this.graph = graph;
    this.models = models;
    this.predictor = new Predictor(graph, stencil, coordinates);
    this.numbers = new Float64Array(size);
    this.activity = new Float64Array(size);
    this.ringActivity = new Float64Array(size);
    this.signalCount = 0;
  }

  /** The next signal, in 64ths of a step, in the order of vertices, or frames. */
  read(reader) {
    const { graph, predictor, numbers, activity, ringActivity } = this;
    if (this.signalCount) { // the last signal of all needs no update
      updateActivity(numbers, graph, activity, ringActivity);
      predictor.finish();
    }
    readSignal(reader.stream(), this.models, this.signalCount++, predictor, numbers, activity, ringActivity);
    reader.addToChecksum(predictor.values);
    return inOrderOf(graph.order, predictor.values);
  }
}

/** The values of nodes in the order of vertices, or frames. */
function inOrderOf(order, nodes) {
  const values = new Float64Array(nodes.length);
  for (let node = 0; node < nodes.length; node++) values[order[node]] = nodes[node];
  return values;
}
