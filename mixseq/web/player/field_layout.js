// Layout of fields, their weights and the triangles around vertices in textures with rows of a fixed width.

/** Texels in a row of a texture, which all graphics cards support. */
export const WIDTH = 2048;

/**
 * Fields as texels of four numbers: four fields of a part at its first vertex, at its second, and so on, then the next four.
 *
 * `places` has four integers for every vertex: its first texel, the stride to the next ones, their number, and the first row
 * of its weights. Texels are float32: half floats would cause errors of up to a quarter of a bound of 1e-3 diagonals.
 * `order` has the four fields of every row of weights, -1 for none.
 */
export function fieldLayout({ parts }, vertexCount) {
  const rows = parts.map(({ fields }) => Math.ceil(fields.length / 4)), places = new Int32Array(4 * vertexCount);
  const texels = new Float32Array(4 * inRows(parts.reduce((sum, { vertices }, p) => sum + vertices.length * rows[p], 0)));
  const order = new Int32Array(4 * rows.reduce((sum, count) => sum + count, 0)).fill(-1);
  let first = 0, row = 0;
  parts.forEach(({ vertices, fields, values }, p) => {
    const size = vertices.length, count = fields.length;
    for (let i = 0; i < size; i++) {
      places.set([first + i, size, rows[p], row], 4 * vertices[i]);
      for (let k = 0; k < count; k++) texels[4 * (first + (k >> 2) * size + i) + (k & 3)] = values[i * count + k];
    }
    order.set(fields, 4 * row);
    first += size * rows[p];
    row += rows[p];
  });
  return { texels, places, order };
}

/** Weights as rows of three texels: x of the four fields of a row, y of these, z of these. */
export function weightRows(order, weights, out) {
  order.forEach((field, slot) => {
    const place = 12 * (slot >> 2) + (slot & 3);
    for (let axis = 0; field >= 0 && axis < 3; axis++) out[place + 4 * axis] = weights[3 * field + axis];
  });
  return out;
}

/**
 * The triangles around vertices: `pairs` of the two other vertices of each, and in `places` the first pair of every vertex,
 * and their number. Vertices of one group have all triangles of the group.
 */
export function ringLayout(triangles, groups) {
  const starts = new Int32Array(groups.reduce((most, group) => Math.max(most, group), 0) + 2), pairs = new Int32Array(2 * inRows(triangles.length));
  for (const vertex of triangles) starts[groups[vertex] + 1]++;
  for (let group = 1; group < starts.length; group++) starts[group] += starts[group - 1];
  const filled = starts.slice(), places = new Int32Array(2 * groups.length);
  triangles.forEach((vertex, corner) => {
    const first = corner - (corner % 3), beside = triangles[first + ((corner + 1) % 3)], last = triangles[first + ((corner + 2) % 3)];
    pairs.set([beside, last], 2 * filled[groups[vertex]]++);
  });
  groups.forEach((group, vertex) => places.set([starts[group], starts[group + 1] - starts[group]], 2 * vertex));
  return { pairs, places };
}

/** The least number of texels, from a number on, that fill their rows. */
export const inRows = (count) => Math.max(Math.ceil(count / WIDTH), 1) * WIDTH;
