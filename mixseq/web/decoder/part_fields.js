// The affine basis of in-betweens: in every labelled part, fields 1, x, y and z of the position in the first frame. Mirrors
// affine_basis of mixseq/compression/bitstream/spatial_basis.py and label_vertices of mixseq/mesh/polygons.py.
import { Reader } from "./signal_coder.js";
import { meshGraph } from "./signal_graph.js";
import { readLabels } from "./spatial_basis.js";

const MIN_FIELD_NORM = 1e-6; // in diagonals, up to which fields have no weights

/** The vertices of every part, by the label that most triangles of a vertex have, from the stream of `count` labels of triangles. */
export function readPartVertices(stream, count, triangles, vertexCount) {
  const reader = new Reader(stream), labels = readLabels(reader, count, faceGraph(triangles)), votes = new Int32Array(count * vertexCount);
  reader.finish();
  triangles.forEach((vertex, corner) => votes[count * vertex + labels[Math.floor(corner / 3)]]++);
  const parts = Array.from({ length: count }, () => []);
  for (let vertex = 0; vertex < vertexCount; vertex++) {
    const own = votes.subarray(count * vertex, count * (vertex + 1));
    parts[own.indexOf(Math.max(...own))].push(vertex);
  }
  return parts.filter(({ length }) => length);
}

/** The graph of triangles that share an edge with exactly one other. */
function faceGraph(triangles) {
  const sides = new Map(), pairs = [];
  triangles.forEach((a, corner) => {
    const b = triangles[corner % 3 === 2 ? corner - 2 : corner + 1], key = Math.min(a, b) * 2 ** 26 + Math.max(a, b);
    sides.has(key) ? sides.get(key).push(Math.floor(corner / 3)) : sides.set(key, [Math.floor(corner / 3)]);
  });
  for (const faces of sides.values()) if (faces.length === 2) pairs.push(...[faces[0], faces[1], faces[1]]);
  return meshGraph(pairs, triangles.length / 3).graph;
}

/**
 * Add fields of parts with `vertices` at `points` to a basis: four for every part, also if they are too short for weights. The
 * basis has its `inbetweens` coded for these then.
 */
export function addPartFields(basis, parts, points, diagonal) {
  const first = basis.fields.count - 4 * parts.length, all = parts.map((vertices) => affineFields(vertices, points, diagonal));
  const inbetweens = { shapes: false, parts: parts.length, owners: [], norms: [], numbers: [] };
  const add = (part, k) => {
    const norm = Math.sqrt(dot(all[part][k], all[part][k]));
    if (norm) [inbetweens.owners, inbetweens.norms, inbetweens.numbers].forEach((list, i) => list.push([part, norm, first + 4 * part + k][i]));
  };
  parts.forEach((_, part) => add(part, 0));
  parts.forEach((_, part) => [1, 2, 3].forEach((k) => add(part, k)));
  const places = new Map(parts.flatMap((vertices, part) => vertices.map((vertex, i) => [vertex, [part, i]])));
  return { ...basis, inbetweens, fields: { ...basis.fields, parts: basis.fields.parts.flatMap((part) => splitPart(part, places, all, first)) } };
}

/** The fields of a part at its vertices: 1, and coordinates relative to the mean, each orthogonal to those before. */
function affineFields(vertices, points, diagonal) {
  const fields = [Float64Array.from(vertices, () => 1)];
  for (let axis = 0; axis < 3; axis++) {
    const field = Float64Array.from(vertices, (vertex) => points[3 * vertex + axis]);
    for (const other of fields) subtract(field, dot(field, other) / Math.max(dot(other, other), Number.MIN_VALUE), other);
    if (Math.sqrt(dot(field, field)) <= MIN_FIELD_NORM * diagonal) field.fill(0);
    fields.push(field);
  }
  return fields;
}

function dot(a, b) {
  let sum = 0;
  for (let i = 0; i < a.length; i++) sum += a[i] * b[i];
  return sum;
}

function subtract(field, share, other) {
  for (let i = 0; i < field.length; i++) field[i] -= share * other[i];
}

/** Split a part of the fields by the labelled parts at `places`, whose fields join its own. */
function splitPart({ vertices, fields, values }, places, all, first) {
  const groups = new Map(), count = fields.length;
  vertices.forEach((vertex, i) => {
    const [part] = places.get(vertex);
    groups.has(part) ? groups.get(part).push(i) : groups.set(part, [i]);
  });
  return [...groups].map(([part, rows]) => {
    const joined = new Float64Array(rows.length * (count + 4));
    rows.forEach((i, row) => {
      joined.set(values.subarray(i * count, (i + 1) * count), row * (count + 4));
      joined.set(all[part].map((field) => field[places.get(vertices[i])[1]]), row * (count + 4) + count);
    });
    return { vertices: Uint32Array.from(rows, (i) => vertices[i]), fields: Uint32Array.from([...fields, ...[0, 1, 2, 3].map((k) => first + 4 * part + k)]), values: joined };
  });
}
