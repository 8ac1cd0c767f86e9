// Predictions, their weights, and similar nodes. Mirrors the loops of mixseq/compression/bitstream/predictor.py.
//
// Values are whole, in units of 1/64 step, weights multiples of 2^-24. Neighbours and weights are N x width; the first
// `counts[node]` of a row count. Only `solveWeights` rounds: + - * / and roots, in the order of the specification.

export const UNITS_PER_STEP = 64; // units of values in a step
const MAX_PREDICTION = 2 ** 50; // largest magnitude
const ROUNDING_OFFSET = 1.5 * 2 ** 28; // its addition and subtraction rounds to multiples of 2^-24
const RELATIVE_RIDGE = 1e-12; // share of a matrix's trace added to the ridge

/** The value of a node predicted from the values before it. */
export function predict(node, { width, neighbours, counts, weights }, values) {
  let total = 0.5;
  for (let at = node * width, end = at + counts[node]; at < end; at++) total += weights[at] * values[neighbours[at]];
  if (total > MAX_PREDICTION) total = MAX_PREDICTION;
  else if (!(total > -MAX_PREDICTION)) total = -MAX_PREDICTION;
  return Math.floor(total);
}

/** Weights, rounded to multiples of 2^-24. */
export const roundWeights = (weights) => weights.map((weight) => weight + ROUNDING_OFFSET - ROUNDING_OFFSET);

/** The power of two near 1 / (1 + m / roughnessScale), m the mean square of differences of nodes and first neighbours. */
export function computeTrust(values, roughnessScale, { width, neighbours, counts }) {
  let total = 0, pairs = 0, share = 1;
  for (let node = 0; node < values.length; node++) {
    if (!counts[node]) continue;
    const nearestDistances = values[node] - values[neighbours[node * width]];
    total += nearestDistances * nearestDistances;
    pairs++;
  }
  const target = roughnessScale * pairs;
  total += target;
  while (share * total > 1.5 * target) share *= 0.5;
  return share;
}

/** Number of entries of a node's matrix and right side, the lower triangle row by row. */
export const entries = (count) => (count > 1 ? (count * (count + 1)) / 2 - 1 : 0);

/** Add the products of the differences of signals, times their trusts, to the Gram matrices. */
export function accumulateGram(signals, trusts, { width, neighbours, counts }, gram) {
  const nearestDistances = new Float64Array(width), size = counts.length;
  for (let node = 0, place = 0; node < size; node++) {
    const last = counts[node] - 1, row = node * width;
    if (last < 1) continue;
    for (let k = 0; k < signals.length; k++) {
      const values = signals[k], weight = trusts[k], first = values[neighbours[row]];
      for (let i = 0; i < last; i++) nearestDistances[i] = values[neighbours[row + i + 1]] - first;
      nearestDistances[last] = values[node] - first;
      for (let i = 0, at = place; i <= last; i++) {
        const difference = weight * nearestDistances[i], end = i < last ? i + 1 : last;
        for (let j = 0; j < end; j++) gram[at++] += difference * nearestDistances[j];
      }
    }
    place += entries(last + 1);
  }
}

/**
 * Write the weights of sum one that minimise w G w + ridge |w - w^0|^2, by Cholesky: initial weights w^0.
 *
 * A row of the factor is computed from the left, and each entry is subtracted from all that follow. Operations have the
 * order of the specification, but none waits for the previous one.
 */
export function solveWeights(ridge, { width, counts }, gram, initialWeights, weights) {
  const columns = new Float64Array(width * width), row = new Float64Array(width);
  const inverse = new Float64Array(width), similarCounts = new Float64Array(width);
  for (let node = 0, place = 0; node < counts.length; node++) {
    const last = counts[node] - 1, first = node * width;
    if (last < 1) continue;
    let damping = ridge;
    for (let i = 0; i < last; i++) damping += RELATIVE_RIDGE * gram[place + (i * (i + 3)) / 2];
    for (let i = 0; i <= last; i++) {
      const end = i < last ? i + 1 : last; // of the row; the last row is the right side
      for (let j = 0; j < end; j++) row[j] = gram[place++] + damping; // the first weight, one minus the others, is damped as well
      if (i < last) row[i] += damping;
      else for (let j = 0; j < last; j++) row[j] += damping * (initialWeights[first + j + 1] - initialWeights[first]);
      for (let k = 0; k < last && k < i; k++) {
        const share = row[k] * inverse[k], column = k * width;
        columns[column + i] = share;
        for (let j = k + 1; j < end; j++) row[j] -= share * columns[column + j];
      }
      if (i < last) inverse[i] = 1 / Math.sqrt(row[i] > damping ? row[i] : damping);
    }
    let left = 1;
    for (let i = last - 1; i >= 0; i--) {
      const column = i * width;
      let entry = columns[column + last];
      for (let k = i + 1; k < last; k++) entry -= columns[column + k] * similarCounts[k];
      similarCounts[i] = entry * inverse[i] + ROUNDING_OFFSET - ROUNDING_OFFSET;
      left -= similarCounts[i];
    }
    weights[first] = left;
    for (let i = 0; i < last; i++) weights[first + i + 1] = similarCounts[i];
  }
}

/**
 * The nodes before every node that are nearest to it in signals, without its neighbours: `similar` (N x most), nearest
 * first, and their `similarCounts` (N). The first `exhaustive` nodes search all nodes before them.
 */
export function findSimilarNodes(signals, { width, neighbours, counts }, exhaustive, most) {
  const size = counts.length, dim = signals.length, similar = new Int32Array(size * most), similarCounts = new Int32Array(size);
  const points = new Float64Array(size * dim), visitor = new Int32Array(size).fill(-1); // the last node that visited a node
  const nearestDistances = new Float64Array(most), distances = new Float64Array(Math.min(size, exhaustive));
  for (let axis = 0; axis < dim; axis++) {
    for (let node = 0; node < size; node++) points[node * dim + axis] = signals[axis][node];
  }
  for (let node = 0; node < size; node++) {
    const first = node * width, end = first + counts[node];
    nearestDistances.fill(Infinity);
    for (let at = first; at < end; at++) visitor[neighbours[at]] = node;
    if (node < exhaustive) {
      distancesBefore(signals, node, distances);
      for (let other = 0; other < node; other++) {
        if (distances[other] < nearestDistances[most - 1] && visitor[other] !== node) insert(node, other, distances[other], nearestDistances, similar, similarCounts);
      }
      continue;
    }
    for (let at = first; at < end; at++) {
      const beside = neighbours[at];
      for (let j = 0; j < counts[beside]; j++) visit(node, neighbours[beside * width + j], points, dim, visitor, nearestDistances, similar, similarCounts);
      for (let j = 0; j < similarCounts[beside]; j++) visit(node, similar[beside * most + j], points, dim, visitor, nearestDistances, similar, similarCounts);
    }
  }
  return { similar, similarCounts };
}

/** Insert another node into the similar ones of a node, if it is near enough and was not visited. */
function visit(node, other, points, dim, visitor, nearestDistances, similar, similarCounts) {
  if (visitor[other] === node) return;
  visitor[other] = node;
  const farthest = nearestDistances[nearestDistances.length - 1];
  let distance = 0;
  for (let a = node * dim, b = other * dim, end = a + dim; a < end; a++, b++) {
    const difference = points[a] - points[b];
    distance += difference * difference;
    if (distance >= farthest) return;
  }
  insert(node, other, distance, nearestDistances, similar, similarCounts);
}

function insert(node, other, distance, nearestDistances, similar, similarCounts) {
  const most = nearestDistances.length, row = node * most;
  let place = most - 1;
  for (; place > 0 && nearestDistances[place - 1] > distance; place--) {
    nearestDistances[place] = nearestDistances[place - 1];
    similar[row + place] = similar[row + place - 1];
  }
  nearestDistances[place] = distance;
  similar[row + place] = other;
  if (similarCounts[node] < most) similarCounts[node]++;
}

/** Write the squared distances of a node from all nodes before it, signal by signal. */
function distancesBefore(signals, node, distances) {
  distances.fill(0, 0, node);
  for (let k = 0; k < signals.length; k++) addDistances(signals[k], node, distances);
}

function addDistances(signal, node, distances) {
  const here = signal[node];
  for (let other = 0; other < node; other++) {
    const difference = signal[other] - here;
    distances[other] += difference * difference;
  }
}
