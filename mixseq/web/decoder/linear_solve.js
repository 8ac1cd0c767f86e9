// Small systems of linear equations.

/** Solve a system, a list of rows, for a right side, by Gaussian elimination with pivoting; both are overwritten. */
export function solveLinear(rows, right) {
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
export const zeroMatrix = (size) => Array.from({ length: size }, () => new Float64Array(size));
