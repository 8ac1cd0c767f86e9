// The curve through rows of numbers at frames, and what the operator in time says of the middles between them. Mirrors
// signals/curve.py, of a model that was compressed.
import { Operator, placeIn } from "./operator.js";
import { splineWeights } from "./spline_weights.js";

const REACH = 24; // knots on either side: those farther away have no weight that could be seen
const KEPT = 256; // middles that are known

/** A curve through `row(frame)`, as long as `width`, at `times`; rows are asked for where they are needed. */
export class Curve {
  constructor(times, between, width, row) {
    Object.assign(this, { times, width, row, operator: new Operator(times, between), middles: new Map() });
    this.count = 2 * times.length - 1; // of knots
  }

  /** Where the curve is at a time. */
  at(time) {
    const place = placeIn(this.times, time), { count } = this;
    if (this.times[place] === time) return this.row(place);
    const first = Math.max(2 * place - 1 - REACH, 0), end = Math.min(2 * place + REACH, count);
    const knots = Float64Array.from({ length: end - first }, (_, k) => this.knot(first + k));
    return this.sum(splineWeights(knots, time, true), (k) => this.value(first + k));
  }

  /** The time of a frame, or of the middle after it. */
  knot(number) {
    const frame = number >> 1;
    return number & 1 ? (this.times[frame] + this.times[frame + 1]) / 2 : this.times[frame];
  }

  value(number) {
    if (!(number & 1)) return this.row(number >> 1);
    let found = this.middles.get(number);
    if (!found) {
      const { first, weights } = this.operator.at(this.knot(number));
      found = this.sum(weights, (k) => this.row(first + k));
      this.middles.set(number, found);
      if (this.middles.size > KEPT) this.middles.delete(this.middles.keys().next().value);
    }
    return found;
  }

  sum(weights, row) {
    const found = new Float64Array(this.width);
    weights.forEach((weight, k) => {
      const values = row(k);
      for (let i = 0; i < found.length; i++) found[i] += weight * values[i];
    });
    return found;
  }
}
