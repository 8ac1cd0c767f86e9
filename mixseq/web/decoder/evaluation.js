// Positions from fields and their weights.

/** Write the positions of all vertices: the sums of fields (`Sequence.fields`) times weights. */
export function evaluate({ parts }, weights, positions) {
  for (const { vertices, fields, values } of parts) {
    const count = fields.length, own = new Float64Array(3 * count);
    fields.forEach((field, k) => own.set(weights.subarray(3 * field, 3 * field + 3), 3 * k));
    for (let i = 0, at = 0; i < vertices.length; i++) {
      let x = 0, y = 0, z = 0;
      for (let k = 0; k < own.length; k += 3) {
        const value = values[at++];
        x += value * own[k];
        y += value * own[k + 1];
        z += value * own[k + 2];
      }
      const place = 3 * vertices[i];
      positions[place] = x;
      positions[place + 1] = y;
      positions[place + 2] = z;
    }
  }
}
