// Signals over a graph, one after another: basis vectors over a mesh, coefficients over time. Mirrors
// coding/bitstream/signal_coder.py.
import { Bits } from "./arithmetic.js";
import { BitModels } from "./bit_models.js";
import { checkOf, refuseOthers, withoutCheck } from "./decoded_check.js";
import { MixseqError } from "./errors.js";
import { Predictor } from "./predictor.js";
import { CONTEXTS, INPUTS, POSITIONS, learnSizes, readSignal } from "./signal_kernels.js";

/** A stream, and a check of what it decodes to. */
export class Reader {
  constructor(stream) {
    const { data, expected } = withoutCheck(stream);
    this.coded = new Bits(data);
    this.expected = expected;
    this.check = 0;
  }

  /** Where to read. */
  bits() {
    if (this.coded.isBeyond()) throw new MixseqError("coded numbers end early; it is damaged");
    return this.coded;
  }

  /** Add whole numbers to what was found. */
  checked(numbers) {
    this.check = checkOf(numbers, this.check);
  }

  /** Make sure that what was read is what was written. */
  finish() {
    refuseOthers(this.check, this.expected);
  }
}

/** What is known of the bits of numbers; coders of several graphs can share it. */
export const numberModels = () => new BitModels(INPUTS, CONTEXTS, POSITIONS);

/** Reads signals over a graph; `coordinates` of them belong together. */
export class SignalCoder {
  constructor(graph, stencil, coordinates, models) {
    const size = graph.order.length;
    this.graph = graph;
    this.models = models;
    this.predictor = new Predictor(graph, stencil, coordinates);
    this.numbers = new Float64Array(size);
    this.activity = new Float64Array(size);
    this.around = new Float64Array(size);
    this.known = 0;
  }

  /** The next signal, in 64ths of a step, in the order of vertices, or frames. */
  read(reader) {
    const { graph, predictor, numbers, activity, around } = this;
    if (this.known) { // nothing has to be learned from the last signal
      learnSizes(numbers, graph, activity, around);
      predictor.finish();
    }
    readSignal(reader.bits(), this.models, this.known++, predictor, numbers, activity, around);
    reader.checked(predictor.values);
    return inOrderOf(graph.order, predictor.values);
  }
}

/** The values of nodes in the order of vertices, or frames. */
function inOrderOf(order, nodes) {
  const values = new Float64Array(nodes.length);
  for (let node = 0; node < nodes.length; node++) values[order[node]] = nodes[node];
  return values;
}
