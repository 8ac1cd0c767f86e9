// The curve through the rows of frames and in-betweens. Rows at the middles between frames are from the temporal operator,
// and at the middles between knots of a level from its spline; in-betweens are added. Mirrors `Playback.curve` of
// mixseq/compression/bitstream/compressed_sequence.py.

/** Solve a system, a list of rows, for a right side, by Gaussian elimination with pivoting; both are overwritten. */
function solveLinear(rows, right) {
  const size = right.length;
  for (let k = 0; k < size; k++) {
    let best = k;
    for (let i = k + 1; i < size; i++) if (Math.abs(rows[i][k]) > Math.abs(rows[best][k])) best = i;
    [rows[k], rows[best]] = [rows[best], rows[k]];
    [right[k], right[best]] = [right[best], right[k]];
    const own = rows[k];
    for (let i = k + 1; i < size; i++) {
      const row = rows[i], share = row[k] / own[k];
      if (share === 0) continue;
      for (let j = k; j < size; j++) row[j] -= share * own[j];
      right[i] -= share * right[k];
    }
  }
  for (let k = size - 1; k >= 0; k--) {
    for (let j = k + 1; j < size; j++) right[k] -= rows[k][j] * right[j];
    right[k] /= rows[k][k];
  }
  return right;
}

/** A matrix of zeros, as a list of rows. */
const zeroMatrix = (size) => Array.from({ length: size }, () => new Float64Array(size));

// Weights of the values at knots in the cubic spline through them.

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

// The temporal operator: weights of frames at any time.

const WINDOW_FRAMES = 48; // nearest frames that have weights

/** Weights of frames at `times`: `length` of the covariance, null if infinite; weights of the usual `cubic` spline at both ends. */
class TemporalOperator {
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

  /** The row at a time; before the first and after the last frame, on a straight line. */
  at(time) {
    const { times, row, width } = this, last = times.length - 1;
    if (last && (time < times[0] || time > times[last])) {
      const [end, beside] = time < times[0] ? [0, 1] : [last, last - 1], share = (time - times[end]) / (times[end] - times[beside]);
      const weights = [1 + share, -share], rows = [end, beside];
      return this.sum(weights, (k) => row(rows[k]));
    }
    if (time < times[0] || time > times[last]) return row(0).slice(0, width);
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

/** Curves through the frames between two cuts, each until half-way to the next frame; see `Curve`. */
export class CutCurve {
  constructor(times, { cuts, ...between }, width, row, levels, offsets) {
    const bounds = [0, ...cuts, times.length];
    this.edges = cuts.map((frame) => times[frame - 1] + 0.5 * (times[frame] - times[frame - 1]));
    this.sections = bounds.slice(1).map((end, k) => {
      const first = bounds[k], offset = (level, middle) => offsets(level, middle + (first << level));
      return new Curve(times.subarray(first, end), between, width, (frame) => row(first + frame), levels, offset);
    });
  }

  /** The row at a time. */
  at(time) {
    return this.sections[this.edges.filter((edge) => edge <= time).length].at(time);
  }
}
