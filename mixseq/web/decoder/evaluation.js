// From fields and their weights to positions.

/** The fields of a basis, as `Sequence.fields` tells them. */
export function fieldsOf({ shapes, parts, owners }) {
  const each = shapes ? 3 : 1, numbers = parts.map(() => []);
  owners.forEach((part, vector) => {
    for (let axis = 0; axis < each; axis++) numbers[part].push(each * vector + axis);
  });
  return {
    count: each * owners.length,
    parts: parts.map(({ vertices, fields }, part) => ({ vertices, fields: Uint32Array.from(numbers[part]), values: byVertex(fields, vertices.length) })),
  };
}

function byVertex(fields, count) {
  const values = new Float32Array(fields.length * count);
  fields.forEach((field, k) => {
    for (let vertex = 0, at = k; vertex < count; vertex++, at += fields.length) values[at] = field[vertex];
  });
  return values;
}

/** Write the positions of all vertices. */
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
