// The curve through the rows of frames, and rows at their midpoints from the temporal operator. Mirrors
// mixseq/signals/curve.py, for compressed models.
import { TemporalOperator, lowerBound } from "./operator.js";
import { splineWeights } from "./spline_weights.js";

const KNOTS_PER_SIDE = 24; // knots on either side; the weights of others are negligible
const MAX_CACHED_MIDDLES = 256; // rows at midpoints

/** A curve through rows `row(frame)` of `width` numbers at `times`, which are decoded on demand. */
export class Curve {
  constructor(times, between, width, row) {
    Object.assign(this, { times, width, row, operator: new TemporalOperator(times, between), middles: new Map() });
    this.count = 2 * times.length - 1; // of knots
  }

  /** The row at a time. */
  at(time) {
    const place = lowerBound(this.times, time), { count } = this;
    if (this.times[place] === time) return this.row(place);
    const first = Math.max(2 * place - 1 - KNOTS_PER_SIDE, 0), end = Math.min(2 * place + KNOTS_PER_SIDE, count);
    const knots = Float64Array.from({ length: end - first }, (_, k) => this.knot(first + k));
    return this.sum(splineWeights(knots, time, true), (k) => this.value(first + k));
  }

  /** The time of a frame, or of the midpoint after it. */
  knot(number) {
    const frame = number >> 1;
    return number & 1 ? (this.times[frame] + this.times[frame + 1]) / 2 : this.times[frame];
  }

  value(number) {
    if (!(number & 1)) return this.row(number >> 1);
    let sum = this.middles.get(number);
    if (!sum) {
      const { first, weights } = this.operator.at(this.knot(number));
      sum = this.sum(weights, (k) => this.row(first + k));
      this.middles.set(number, sum);
      if (this.middles.size > MAX_CACHED_MIDDLES) this.middles.delete(this.middles.keys().next().value);
    }
    return sum;
  }

  sum(weights, row) {
    const sum = new Float64Array(this.width);
    weights.forEach((weight, k) => {
      const values = row(k);
      for (let i = 0; i < sum.length; i++) sum[i] += weight * values[i];
    });
    return sum;
  }
}
