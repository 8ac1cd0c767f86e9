// Predictions, their weights, and nodes that are alike. Mirrors coding/bitstream/predictor_kernels.py.
//
// Values are whole, in units of 1/64 step, weights multiples of 2^-24. Neighbours and weights are N x width; the first
// `counts[node]` of a row count. Only `solve` rounds: + - * / and roots, in the order of the specification.

export const UNIT = 64; // of values, in a step
const FARTHEST = 2 ** 50; // predictions are not beyond this
const ROUNDING = 1.5 * 2 ** 28; // a number that is added to this and taken from it again is a multiple of 2^-24
const LEAST = 1e-12; // share of the traces of matrices that is added to the ridge

/** What the values before a node let expect of it. */
export function predict(node, { width, neighbours, counts, weights }, values) {
  let total = 0.5;
  for (let at = node * width, end = at + counts[node]; at < end; at++) total += weights[at] * values[neighbours[at]];
  if (total > FARTHEST) total = FARTHEST;
  else if (!(total > -FARTHEST)) total = -FARTHEST;
  return Math.floor(total);
}

/** Weights, rounded to multiples of 2^-24. */
export const rounded = (weights) => weights.map((weight) => weight + ROUNDING - ROUNDING);

/** A power of two, about 1 / (1 + m / rough), with the mean square m of differences of nodes and first neighbours. */
export function trust(values, rough, { width, neighbours, counts }) {
  let total = 0, pairs = 0, share = 1;
  for (let node = 0; node < values.length; node++) {
    if (!counts[node]) continue;
    const apart = values[node] - values[neighbours[node * width]];
    total += apart * apart;
    pairs++;
  }
  const whole = rough * pairs;
  total += whole;
  while (share * total > 1.5 * whole) share *= 0.5;
  return share;
}

/** Numbers of a node's matrix and right side, the lower triangle row by row. */
export const entries = (count) => (count > 1 ? (count * (count + 1)) / 2 - 1 : 0);

/** Add the products of the differences of signals, times their trusts, to the Gram matrices. */
export function learn(signals, trusts, { width, neighbours, counts }, gram) {
  const apart = new Float64Array(width), size = counts.length;
  for (let node = 0, place = 0; node < size; node++) {
    const last = counts[node] - 1, row = node * width;
    if (last < 1) continue;
    for (let k = 0; k < signals.length; k++) {
      const values = signals[k], weight = trusts[k], first = values[neighbours[row]];
      for (let i = 0; i < last; i++) apart[i] = values[neighbours[row + i + 1]] - first;
      apart[last] = values[node] - first;
      for (let i = 0, at = place; i <= last; i++) {
        const one = weight * apart[i], end = i < last ? i + 1 : last;
        for (let j = 0; j < end; j++) gram[at++] += one * apart[j];
      }
    }
    place += entries(last + 1);
  }
}

/**
 * Write the weights that minimise w G w + ridge |w - start|^2, with a sum of one, by Cholesky's factors.
 *
 * A row of the factors is found from the left: what is known of it is taken from all that follows. So every number comes
 * from the operations of the specification in their order, but none waits for the one before.
 */
export function solve(ridge, { width, counts }, gram, start, weights) {
  const columns = new Float64Array(width * width), row = new Float64Array(width);
  const inverse = new Float64Array(width), found = new Float64Array(width);
  for (let node = 0, place = 0; node < counts.length; node++) {
    const last = counts[node] - 1, first = node * width;
    if (last < 1) continue;
    let pull = ridge;
    for (let i = 0; i < last; i++) pull += LEAST * gram[place + (i * (i + 3)) / 2];
    for (let i = 0; i <= last; i++) {
      const end = i < last ? i + 1 : last; // of the row; the last one is the right side
      for (let j = 0; j < end; j++) row[j] = gram[place++] + pull; // the ridge of the first weight, one minus the others
      if (i < last) row[i] += pull;
      else for (let j = 0; j < last; j++) row[j] += pull * (start[first + j + 1] - start[first]);
      for (let k = 0; k < last && k < i; k++) {
        const share = row[k] * inverse[k], column = k * width;
        columns[column + i] = share;
        for (let j = k + 1; j < end; j++) row[j] -= share * columns[column + j];
      }
      if (i < last) inverse[i] = 1 / Math.sqrt(row[i] > pull ? row[i] : pull);
    }
    let left = 1;
    for (let i = last - 1; i >= 0; i--) {
      const column = i * width;
      let entry = columns[column + last];
      for (let k = i + 1; k < last; k++) entry -= columns[column + k] * found[k];
      found[i] = entry * inverse[i] + ROUNDING - ROUNDING;
      left -= found[i];
    }
    weights[first] = left;
    for (let i = 0; i < last; i++) weights[first + i + 1] = found[i];
  }
}

/**
 * The nodes before every node that are nearest to it in signals, but for its neighbours: `similar` (N x most), the
 * nearest first, and how many were `found` (N). The first `exhaustive` nodes look at all nodes before them.
 */
export function nearest(signals, { width, neighbours, counts }, exhaustive, most) {
  const size = counts.length, dim = signals.length, similar = new Int32Array(size * most), found = new Int32Array(size);
  const points = new Float64Array(size * dim), seen = new Int32Array(size).fill(-1); // the last that looked at a node
  const apart = new Float64Array(most), distances = new Float64Array(Math.min(size, exhaustive));
  for (let axis = 0; axis < dim; axis++) {
    for (let node = 0; node < size; node++) points[node * dim + axis] = signals[axis][node];
  }
  for (let node = 0; node < size; node++) {
    const first = node * width, end = first + counts[node];
    apart.fill(Infinity);
    for (let at = first; at < end; at++) seen[neighbours[at]] = node;
    if (node < exhaustive) {
      distancesBefore(signals, node, distances);
      for (let other = 0; other < node; other++) {
        if (distances[other] < apart[most - 1] && seen[other] !== node) insert(node, other, distances[other], apart, similar, found);
      }
      continue;
    }
    for (let at = first; at < end; at++) {
      const beside = neighbours[at];
      for (let j = 0; j < counts[beside]; j++) look(node, neighbours[beside * width + j], points, dim, seen, apart, similar, found);
      for (let j = 0; j < found[beside]; j++) look(node, similar[beside * most + j], points, dim, seen, apart, similar, found);
    }
  }
  return { similar, found };
}

/** Add another node to those that are nearest to a node, if it is one of them and was not seen yet. */
function look(node, other, points, dim, seen, apart, similar, found) {
  if (seen[other] === node) return;
  seen[other] = node;
  const farthest = apart[apart.length - 1];
  let distance = 0;
  for (let a = node * dim, b = other * dim, end = a + dim; a < end; a++, b++) {
    const one = points[a] - points[b];
    distance += one * one;
    if (distance >= farthest) return;
  }
  insert(node, other, distance, apart, similar, found);
}

function insert(node, other, distance, apart, similar, found) {
  const most = apart.length, row = node * most;
  let place = most - 1;
  for (; place > 0 && apart[place - 1] > distance; place--) {
    apart[place] = apart[place - 1];
    similar[row + place] = similar[row + place - 1];
  }
  apart[place] = distance;
  similar[row + place] = other;
  if (found[node] < most) found[node]++;
}

/** Write the squared distances of a node from all nodes before it, signal by signal. */
function distancesBefore(signals, node, distances) {
  distances.fill(0, 0, node);
  for (let k = 0; k < signals.length; k++) addDistances(signals[k], node, distances);
}

function addDistances(signal, node, distances) {
  const here = signal[node];
  for (let other = 0; other < node; other++) {
    const one = signal[other] - here;
    distances[other] += one * one;
  }
}
