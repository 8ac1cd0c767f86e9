// The temporal operator: weights of frames at any time. Mirrors mixseq/spaces/temporal.py, without its selection.
import { solveLinear, zeroMatrix } from "./linear_solve.js";
import { splineWeights } from "./spline_weights.js";

export const WINDOW_FRAMES = 48; // nearest frames that have weights

/** Weights of frames at `times`: `length` of the covariance, null if infinite; weights of the usual `cubic` spline at both ends. */
export class TemporalOperator {
  constructor(times, { length, cubic }) {
    Object.assign(this, { times, length, cubic });
    this.step = (times[times.length - 1] - times[0]) / Math.max(times.length - 1, 1) || 1;
  }

  /** The weights of the frames from `first` on at a time. */
  at(time) {
    const { times, step, cubic } = this, count = times.length, size = Math.min(WINDOW_FRAMES, count);
    const first = Math.min(Math.max(lowerBound(times, time) - (size >> 1), 0), count - size);
    const own = times.subarray(first, first + size);
    if (size === 1) return { first, weights: Float64Array.of(1) };
    const knots = own.map((knot) => (knot - own[0]) / step), wanted = (time - own[0]) / step;
    const weights = this.length === null ? splineWeights(knots, wanted, false) : kriging(knots, wanted, this.length);
    const weight = count < 3 ? 0 : time < times[1] ? cubic[0] : time > times[count - 2] ? cubic[1] : 0;
    if (weight) splineWeights(knots, wanted, true).forEach((cubicWeight, k) => (weights[k] += weight * (cubicWeight - weights[k])));
    return { first, weights };
  }
}

/** The number of ascending numbers that are below another one. */
export function lowerBound(numbers, wanted) {
  let low = 0, high = numbers.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (numbers[middle] < wanted) low = middle + 1;
    else high = middle;
  }
  return low;
}

function kriging(knots, time, length) {
  const count = knots.length, mean = knots.reduce((sum, knot) => sum + knot, 0) / count;
  const covariance = (distance) => {
    const scaled = (Math.sqrt(3) * Math.abs(distance)) / length;
    return (1 + scaled) * Math.exp(-scaled);
  };
  const trend = (at) => (at - mean) / count, system = zeroMatrix(count + 2), right = new Float64Array(count + 2);
  knots.forEach((knot, k) => {
    knots.forEach((other, j) => (system[k][j] = covariance(knot - other)));
    system[k][count] = system[count][k] = 1;
    system[k][count + 1] = system[count + 1][k] = trend(knot);
    right[k] = covariance(time - knot);
  });
  right[count] = 1;
  right[count + 1] = trend(time);
  return solveLinear(system, right).slice(0, count);
}
