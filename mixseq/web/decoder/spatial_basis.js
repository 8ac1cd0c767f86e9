// The spatial basis and its coefficients, from streams of bytes. Mirrors mixseq/compression/bitstream/spatial_basis.py.
//
// A frame is a sum of fields over the mesh, numbers at its vertices, times weights (x, y, z) that change over time. A basis
// vector of trajectories is one field. One of shapes is three fields, for x, y and z only.
import { BitModels } from "./arithmetic.js";
import { MixseqError } from "./errors.js";
import { graphStencils } from "./predictor.js";
import { UNITS_PER_STEP } from "./predictor_kernels.js";
import { Reader, SignalCoder, newNumberModels } from "./signal_coder.js";
import { NEIGHBOUR_COUNTS, meshGraph, pathGraph } from "./signal_graph.js";

// Decode the part of the mesh that every vertex belongs to.

const LABEL_BITS = 7; // of a label

/** Read the labels of all vertices. */
export function readLabels(reader, partCount, { order, width, neighbours, counts }) {
  const models = new BitModels(2, NEIGHBOUR_COUNTS * NEIGHBOUR_COUNTS, 2 + (1 << LABEL_BITS)), stream = reader.stream();
  const nodes = new Int32Array(order.length), labels = new Int32Array(order.length), votes = new Int32Array(1 << LABEL_BITS);
  for (let node = 0; node < order.length; node++) {
    const begin = node * width, end = begin + counts[node] - 1;
    for (let at = begin; at <= end; at++) votes[nodes[neighbours[at]]]++;
    const first = majorityLabel(nodes, neighbours, begin, end, votes, -1), second = majorityLabel(nodes, neighbours, begin, end, votes, first), firstVotes = first < 0 ? 0 : votes[first];
    models.contexts[0] = firstVotes * NEIGHBOUR_COUNTS + (second < 0 ? 0 : votes[second]);
    models.contexts[1] = firstVotes * NEIGHBOUR_COUNTS + counts[node];
    for (let at = begin; at <= end; at++) votes[nodes[neighbours[at]]] = 0;
    if (first >= 0 && models.read(stream, 0)) nodes[node] = first;
    else if (second >= 0 && models.read(stream, 1)) nodes[node] = second;
    else {
      models.contexts.fill(0);
      let prefix = 1;
      for (let bit = 0; bit < LABEL_BITS; bit++) prefix = 2 * prefix + models.read(stream, 1 + prefix);
      nodes[node] = prefix - (1 << LABEL_BITS);
    }
  }
  reader.addToChecksum(nodes);
  const used = new Set(nodes);
  if (used.size !== partCount || Math.max(...used) >= partCount) throw new MixseqError("labels are not those of the parts; it is damaged");
  for (let node = 0; node < order.length; node++) labels[order[node]] = nodes[node];
  return labels;
}

/** The label with the most votes, without one; ties go to the label of the nearest neighbour, the last one. */
function majorityLabel(nodes, neighbours, begin, end, votes, without) {
  let best = -1;
  for (let at = end; at >= begin; at--) {
    const label = nodes[neighbours[at]];
    if (label !== without && (best < 0 || votes[label] > votes[best])) best = label;
  }
  return best;
}

const FIRST_GROUP_SIZE = 12; // basis vectors in the first group
const MAX_EXACT = 2 ** 24; // largest whole number up to which all are exact in single precision
const MAX_NORM = 2 ** 127; // largest norm in single precision

/** The parts in every stream, the `count` of their vectors, and the number `remaining` for later streams. */
function partGroups(ranks) {
  const groups = [];
  ranks.forEach((rank, part) => {
    for (let remaining = rank, size = FIRST_GROUP_SIZE, group = 0; remaining; size *= 2, group++) {
      const count = Math.min(size, remaining);
      remaining -= count;
      (groups[group] ??= []).push({ part, count, remaining });
    }
  });
  return groups;
}

/**
 * The basis of a mesh with the graph and levels `mesh`.
 *
 * It has `coded`, what the coefficients are of: `owners`, the part of every vector in their order, of how many `parts`, the `norms`
 * of vectors and the `numbers` of their first fields; the same of `inbetweens`; the `unit` of the mean of shapes, and `fields`: their `count`, and for every one of the `parts` its `vertices`, ascending, the numbers of its
 * `fields`, and their `values`, vertex by vertex. Values are the whole numbers of the streams, so they are exact; weights are in
 * the units of the sequence. Zero vectors are left out.
 */
export function readBasis(streams, { factors, ranks, step }, triangles, mesh) {
  const shapes = factors === "shapes", models = newNumberModels(), groups = partGroups(ranks);
  if (streams.length !== groups.length) throw new MixseqError("the number of groups of basis vectors is wrong; it is damaged");
  const readers = streams.map((stream) => new Reader(stream));
  const labels = ranks.length > 1 && readLabels(readers[0], ranks.length, mesh.graph);
  const meshParts = labels ? splitParts(labels, ranks.length, triangles) : [wholeMesh(mesh)], coders = [];
  const coderOf = (part) => {
    const own = meshParts[part].mesh();
    return new SignalCoder(own.graph, graphStencils(own), shapes ? 3 : 1, models);
  };
  const basis = { shapes, parts: meshParts.map(({ vertices }) => ({ vertices, numbers: [], fields: [] })), owners: [], norms: [], unit: step / UNITS_PER_STEP };
  if (!shapes) basis.parts.forEach(({ vertices }, part) => addFields(basis, part, [new Float32Array(vertices.length).fill(1)], Math.sqrt(vertices.length)));
  groups.forEach((group, number) => {
    for (const { part, count, remaining } of group) {
      const coder = (coders[part] ??= coderOf(part)); // large, so created on demand and freed after use
      for (let k = 0; k < count; k++) addVector(basis, part, coder, readers[number]);
      if (!remaining) coders[part] = null;
    }
    readers[number].finish();
  });
  const { parts, owners, norms, unit } = basis, count = (shapes ? 3 : 1) * owners.length;
  const coded = { shapes, parts: parts.length, owners, norms, numbers: owners.map((_, vector) => (shapes ? 3 : 1) * vector) };
  return { coded, inbetweens: coded, unit, fields: { count, parts: parts.map(interleaveFields) } };
}

/** Read a vector, and add it unless it is zero; the mean of shapes may be zero. */
function addVector(basis, part, coder, reader) {
  let squares = 0;
  const { shapes, owners, unit } = basis, fields = Array.from({ length: shapes ? 3 : 1 }, () => {
    const values = coder.read(reader);
    squares = addSquares(values, squares);
    return values.every((value) => Math.abs(value) <= MAX_EXACT) ? Float32Array.from(values) : Float64Array.from(values);
  });
  const norm = Math.sqrt(squares);
  if (!(norm * unit < MAX_NORM)) throw new MixseqError("basis vectors are too large for single precision");
  if (squares || (shapes && !owners.length)) addFields(basis, part, fields, norm);
}

function addSquares(values, sum) {
  for (let i = 0; i < values.length; i++) sum += values[i] * values[i];
  return sum;
}

function addFields({ parts, owners, norms }, part, fields, norm) {
  const first = fields.length * owners.length;
  fields.forEach((field, axis) => {
    parts[part].fields.push(field);
    parts[part].numbers.push(first + axis);
  });
  owners.push(part);
  norms.push(norm);
}

/** A part with the values of all its fields, vertex by vertex. */
function interleaveFields({ vertices, numbers, fields }) {
  const Values = fields.some((field) => field instanceof Float64Array) ? Float64Array : Float32Array;
  const values = new Values(fields.length * vertices.length);
  fields.forEach((field, k) => {
    for (let vertex = 0, at = k; vertex < field.length; vertex++, at += fields.length) values[at] = field[vertex];
  });
  return { vertices, fields: Uint32Array.from(numbers), values };
}

/** The mesh as its only part. */
const wholeMesh = (mesh) => ({ vertices: Uint32Array.from(mesh.graph.order.keys()), mesh: () => mesh });

/** The parts of labels, each with the mesh of the triangles that lie inside it. */
function splitParts(labels, number, triangles) {
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

/** Read the weights of all fields in the frames of a chunk, frame by frame, of a sequence of `frames` frames. */
export function readWeights(stream, basis, count, step, frames) {
  const [weights] = readLevels(stream, basis.coded, [count], step, 3 * basis.fields.count);
  if (basis.coded.shapes) spreadAxes(weights, 3 * basis.fields.count, 0, new Float64Array(count).fill(basis.unit / Math.sqrt(frames)));
  return weights;
}

/**
 * Read weights at as many times as each of `counts` says, time by time, rows of `width` numbers: of the frames of a chunk, or of
 * its levels of in-betweens. The weight of the mean of shapes stays zero, and that of fields without coefficients.
 */
export function readLevels(stream, { shapes, parts, owners, norms, numbers }, counts, step, width) {
  const models = newNumberModels(), reader = new Reader(stream);
  const levels = counts.map((count) => {
    const weights = new Float64Array(count * width), graph = pathGraph(count);
    const coders = Array.from({ length: parts }, () => new SignalCoder(graph, graph, shapes ? 1 : 3, models));
    owners.forEach((part, vector) => {
      if (shapes && !vector) return;
      for (let axis = 0; axis < (shapes ? 1 : 3); axis++) {
        const values = coders[part].read(reader), unit = step / UNITS_PER_STEP / norms[vector];
        for (let k = 0; k < count; k++) values[k] *= unit;
        if (shapes) spreadAxes(weights, width, 3 * numbers[vector], values);
        else for (let k = 0; k < count; k++) weights[k * width + 3 * numbers[vector] + axis] = values[k];
      }
    });
    return weights;
  });
  reader.finish();
  if (!levels.every((weights) => weights.every(Number.isFinite))) throw new MixseqError("coded signals are not finite; it is damaged");
  return levels;
}

/** Set the weights of the fields x, y and z of a shape, for x, y and z. */
function spreadAxes(weights, width, first, values) {
  values.forEach((value, frame) => {
    for (let axis = 0; axis < 3; axis++) weights[frame * width + first + 4 * axis] = value;
  });
}

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
