// The spatial basis and its coefficients, from streams of bytes. Mirrors coding/bitstream/spatial_basis.py.
//
// A frame is a sum of fields over the mesh, numbers at its vertices, with weights (x, y, z) each that change over time. A
// basis vector of trajectories is one field. One of shapes is three: x, y and z of it, that only go to x, y and z.
import { MixseqError } from "./errors.js";
import { readLabels } from "./part_labels.js";
import { UNIT } from "./predictor_kernels.js";
import { Reader, SignalCoder, numberModels } from "./signal_coder.js";
import { meshGraph, pathGraph } from "./signal_graph.js";
import { stencils } from "./stencils.js";

const GROUP = 12; // basis vectors in the first group
const LARGEST = 2 ** 127; // of what is float32

/** Which parts are in which stream, with how many vectors, and how many of a part are `left` for others. */
function groupsOfParts(ranks) {
  const groups = [];
  ranks.forEach((rank, part) => {
    for (let left = rank, size = GROUP, group = 0; left; size *= 2, group++) {
      const count = Math.min(size, left);
      left -= count;
      (groups[group] ??= []).push({ part, count, left });
    }
  });
  return groups;
}

/**
 * The basis of a mesh with the graph and levels `mesh`.
 *
 * It has `owners`, the part of every vector in the order of their coefficients, and the vectors' `norms`; and as `fields` how
 * many there are, their `count`, and of all `parts` the `vertices`, increasing, the numbers of the `fields`, and their
 * `values`, vertex by vertex. All is in the units of the sequence. Vectors that are zero are left out.
 */
export function readBasis(streams, { factors, ranks, step }, triangles, mesh) {
  const shapes = factors === "shapes", models = numberModels(), groups = groupsOfParts(ranks);
  if (streams.length !== groups.length) throw new MixseqError("there are not as many groups of basis vectors as it says; it is damaged");
  const readers = streams.map((stream) => new Reader(stream));
  const labels = ranks.length > 1 && readLabels(readers[0], ranks.length, mesh.graph);
  const places = labels ? partsOf(labels, ranks.length, triangles) : [wholeOf(mesh)], coders = [];
  const coderOf = (part) => {
    const own = places[part].mesh();
    return new SignalCoder(own.graph, stencils(own), shapes ? 3 : 1, models);
  };
  const basis = { shapes, parts: places.map(({ vertices }) => ({ vertices, numbers: [], fields: [] })), owners: [], norms: [] };
  if (!shapes) basis.parts.forEach(({ vertices }, part) => add(basis, part, [constant(vertices.length)], 1));
  groups.forEach((group, number) => {
    for (const { part, count, left } of group) {
      const coder = (coders[part] ??= coderOf(part)); // they are large: there only as long as they are needed
      for (let k = 0; k < count; k++) addVector(basis, part, coder, readers[number], step / UNIT);
      if (!left) coders[part] = null;
    }
    readers[number].finish();
  });
  const { parts, owners, norms } = basis, count = (shapes ? 3 : 1) * owners.length;
  return { shapes, owners, norms, fields: { count, parts: parts.map(byVertex) } };
}

/** The vector that is the same everywhere. */
const constant = (size) => new Float32Array(size).fill(1 / Math.sqrt(size));

/** Read a vector, and add it unless it is zero; the first one of shapes, their mean, may be that. */
function addVector(basis, part, coder, reader, unit) {
  let squares = 0;
  const { shapes, owners } = basis, fields = Array.from({ length: shapes ? 3 : 1 }, () => {
    const values = coder.read(reader);
    squares = addSquares(values, squares);
    return Float32Array.from(values, (value) => value * unit);
  });
  const norm = Math.sqrt(squares) * unit;
  if (!(norm < LARGEST)) throw new MixseqError("basis vectors are beyond single precision");
  if (squares || (shapes && !owners.length)) add(basis, part, fields, norm);
}

function addSquares(values, sum) {
  for (let i = 0; i < values.length; i++) sum += values[i] * values[i];
  return sum;
}

function add({ parts, owners, norms }, part, fields, norm) {
  const first = fields.length * owners.length;
  fields.forEach((field, axis) => {
    parts[part].fields.push(field);
    parts[part].numbers.push(first + axis);
  });
  owners.push(part);
  norms.push(norm);
}

/** What is known of a part, with the values of all fields at a vertex side by side. */
function byVertex({ vertices, numbers, fields }) {
  const values = new Float32Array(fields.length * vertices.length);
  fields.forEach((field, k) => {
    for (let vertex = 0, at = k; vertex < field.length; vertex++, at += fields.length) values[at] = field[vertex];
  });
  return { vertices, fields: Uint32Array.from(numbers), values };
}

/** The mesh as its only part. */
const wholeOf = (mesh) => ({ vertices: Uint32Array.from(mesh.graph.order.keys()), mesh: () => mesh });

/** The parts of labels, each with the mesh of the triangles that lie inside it. */
function partsOf(labels, number, triangles) {
  const own = new Int32Array(labels.length), vertices = Array.from({ length: number }, () => []);
  const inside = Array.from({ length: number }, () => []);
  for (let vertex = 0; vertex < labels.length; vertex++) own[vertex] = vertices[labels[vertex]].push(vertex) - 1;
  for (let k = 0; k < triangles.length; k += 3) {
    const a = triangles[k], b = triangles[k + 1], c = triangles[k + 2], part = labels[a];
    if (labels[b] === part && labels[c] === part) inside[part].push(own[a], own[b], own[c]);
  }
  return vertices.map((some, part) => {
    return { vertices: Uint32Array.from(some), mesh: () => meshGraph(Uint32Array.from(inside[part]), some.length) };
  });
}

/** The weights of all fields in the frames of a chunk, frame after frame, of a sequence of so many frames. */
export function readWeights(stream, basis, count, step, frames) {
  const { shapes, owners, norms, fields } = basis, width = 3 * fields.count, graph = pathGraph(count);
  const weights = new Float64Array(count * width), models = numberModels(), reader = new Reader(stream);
  const coders = fields.parts.map(() => new SignalCoder(graph, graph, shapes ? 1 : 3, models));
  owners.forEach((part, vector) => {
    if (shapes && !vector) return spread(weights, width, 0, new Float64Array(count).fill(1 / Math.sqrt(frames)));
    for (let axis = 0; axis < (shapes ? 1 : 3); axis++) {
      const values = coders[part].read(reader), unit = step / UNIT / norms[vector];
      for (let frame = 0; frame < count; frame++) values[frame] *= unit;
      if (shapes) spread(weights, width, 9 * vector, values);
      else for (let frame = 0; frame < count; frame++) weights[frame * width + 3 * vector + axis] = values[frame];
    }
  });
  reader.finish();
  if (!weights.every(Number.isFinite)) throw new MixseqError("coded signals are not finite; it is damaged");
  return weights;
}

/** Give the fields x, y and z of a shape the same weight, for x, y and z. */
function spread(weights, width, first, values) {
  values.forEach((value, frame) => {
    for (let axis = 0; axis < 3; axis++) weights[frame * width + first + 4 * axis] = value;
  });
}
