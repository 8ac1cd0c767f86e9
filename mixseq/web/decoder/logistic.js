// Tables of the logistic function and its inverse, in whole numbers, as mixseq/coding/bitstream/logistic.py makes them.

/** Largest magnitude of x, in units of 2^-8. */
export const FAR = 2047;

/** x of the chances p in units of 2^-12, and p in units of 2^-16 of x from -FAR to FAR. */
export function logisticTables() {
  const growth = new Float64Array(2 * FAR + 1).fill(1), squash = new Int32Array(2 * FAR + 1), stretch = new Int32Array(4096);
  for (let x = 0; x < FAR; x++) growth[FAR + x + 1] = growth[FAR + x] * 1.0039138893383475; // near exp(1 / 256)
  for (let x = 1; x <= FAR; x++) growth[FAR - x] = 1 / growth[FAR + x];
  growth.forEach((g, k) => (squash[k] = Math.floor(65536 * (g / (1 + g)))));
  let x = 0;
  for (let p = 0; p < 4096; p++) {
    while (x < 2 * FAR && squash[x] < 16 * p + 8) x++;
    stretch[p] = x - FAR;
  }
  return { stretch, squash };
}
