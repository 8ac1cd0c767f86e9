// The curve through the rows of frames and in-betweens. Rows at the middles between frames are from the temporal operator,
// and at the middles between knots of a level from its spline; in-betweens are added. Mirrors `Playback.curve` of
// mixseq/compression/bitstream/compressed_sequence.py.
import { TemporalOperator, lowerBound } from "./operator.js";
import { splineWeights } from "./spline_weights.js";

const KNOTS_PER_SIDE = 24; // knots on either side; the weights of others are negligible
const MAX_CACHED_MIDDLES = 256; // rows at middles between knots

/**
 * A curve through rows `row(frame)` of `width` numbers at `times`, and `levels` of in-betweens, `offsets(level, middle)` or
 * null. All are decoded on demand. Knots of level 0 are frames; each level has the middles between them as well.
 */
export class Curve {
  constructor(times, between, width, row, levels = 0, offsets = () => null) {
    Object.assign(this, { times, width, row, levels, offsets, operator: new TemporalOperator(times, between), middles: new Map() });
  }

  /** The row at a time. */
  at(time) {
    const place = lowerBound(this.times, time);
    return this.times[place] === time ? this.row(place) : this.spline(time, place - 1, Math.max(this.levels, 1));
  }

  /** The row at a time after a frame, in the spline through the knots of a level. */
  spline(time, frame, level) {
    const middle = (2 * frame + 1) << (level - 1), count = ((this.times.length - 1) << level) + 1;
    const first = Math.max(middle - KNOTS_PER_SIDE, 0), end = Math.min(middle + KNOTS_PER_SIDE + 1, count);
    const knots = Float64Array.from({ length: end - first }, (_, k) => this.knot(first + k, level));
    return this.sum(splineWeights(knots, time, true), (k) => this.value(first + k, level));
  }

  /** The time of a knot of a level. */
  knot(number, level) {
    if (!level) return this.times[number];
    const before = this.knot(number >> 1, level - 1);
    return number & 1 ? (before + this.knot((number >> 1) + 1, level - 1)) / 2 : before;
  }

  /** The row at a knot of a level. */
  value(number, level) {
    if (!level) return this.row(number);
    if (!(number & 1)) return this.value(number >> 1, level - 1);
    const key = 4 * number + level; // there are up to three levels
    let sum = this.middles.get(key);
    if (!sum) {
      sum = this.middle(number, level);
      this.offsets(level - 1, number >> 1)?.forEach((offset, i) => (sum[i] += offset));
      this.middles.set(key, sum);
      if (this.middles.size > MAX_CACHED_MIDDLES) this.middles.delete(this.middles.keys().next().value);
    }
    return sum;
  }

  /** The row at a middle without its in-between. */
  middle(number, level) {
    const time = this.knot(number, level);
    if (level > 1) return this.spline(time, number >> level, level - 1);
    const { first, weights } = this.operator.at(time);
    return this.sum(weights, (k) => this.row(first + k));
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
