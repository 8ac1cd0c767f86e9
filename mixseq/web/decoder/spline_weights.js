// Weights of the values at knots in the cubic spline through them. Mirrors mixseq/spaces/temporal.py.
import { solveLinear, zeroMatrix } from "./linear_solve.js";

/**
 * The weights of values at knots, two or more, in the spline at a time. At the ends it has no second derivative, or,
 * `smooth`, its first two pieces are one cubic, and its last two ("not-a-knot").
 */
export function splineWeights(knots, time, smooth) {
  const count = knots.length, end = count - 1, steps = knots.slice(1).map((knot, k) => knot - knots[k]);
  // Second derivatives at the knots are system^-1 right; the transposed system gives their weights at one time.
  const system = zeroMatrix(count), right = zeroMatrix(count), set = (row, column, value) => (system[column][row] = value);
  set(0, 0, 1);
  set(end, end, 1);
  for (let k = 1; k < end; k++) {
    const before = steps[k - 1], after = steps[k];
    set(k, k - 1, before);
    set(k, k, 2 * (before + after));
    set(k, k + 1, after);
    right[k][k - 1] = 6 / before;
    right[k][k] = -6 / before - 6 / after;
    right[k][k + 1] = 6 / after;
  }
  if (smooth && count > 3) {
    [steps[1], -steps[0] - steps[1], steps[0]].forEach((value, k) => set(0, k, value));
    [steps[end - 2], -steps[end - 1] - steps[end - 2], steps[end - 1]].forEach((value, k) => set(end, end - k, value));
  } else if (smooth && count === 3) { // both ends give the same condition: a parabola
    set(0, 1, -1);
    set(2, 1, -1);
  }
  let left = 0;
  while (left < end - 1 && knots[left + 1] <= time) left++;
  const width = steps[left], after = (time - knots[left]) / width, before = 1 - after, share = (width * width) / 6;
  const bends = new Float64Array(count), weights = new Float64Array(count);
  bends[left] = (before ** 3 - before) * share;
  bends[left + 1] = (after ** 3 - after) * share;
  solveLinear(system, bends).forEach((bend, k) => right[k].forEach((value, j) => (weights[j] += bend * value)));
  weights[left] += before;
  weights[left + 1] += after;
  return weights;
}
