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

/** Which vectors of which parts are in which stream. */
function groupsOfParts(ranks) {
  const groups = [];
  ranks.forEach((rank, part) => {
    for (let done = 0, size = GROUP, group = 0; done < rank; done += size, size *= 2, group++) {
      (groups[group] ??= []).push({ part, count: Math.min(size, rank - done) });
    }
  });
  return groups;
}

/**
 * The basis of a mesh with the graph and levels `mesh`.
 *
 * It has `parts`, each with `vertices`, increasing, and `fields` over them; `owners`, the part of every vector in the order
 * of their coefficients; and `norms` of the vectors, all in the units of the sequence. Vectors that are zero are left out.
 */
export function readBasis(streams, { factors, ranks, step }, triangles, mesh) {
  const shapes = factors === "shapes", models = numberModels(), groups = groupsOfParts(ranks);
  if (streams.length !== groups.length) throw new MixseqError("there are not as many groups of basis vectors as it says; it is damaged");
  const readers = streams.map((stream) => new Reader(stream));
  const labels = ranks.length > 1 && readLabels(readers[0], ranks.length, mesh.graph);
  const places = labels ? partsOf(labels, ranks.length, triangles) : [wholeOf(mesh)];
  const coders = places.map(({ mesh: own }) => new SignalCoder(own.graph, stencils(own), shapes ? 3 : 1, models));
  const basis = { shapes, parts: places.map(({ vertices }) => ({ vertices, fields: [] })), owners: [], norms: [] };
  if (!shapes) basis.parts.forEach((part, owner) => addConstant(basis, part, owner));
  groups.forEach((group, number) => {
    for (const { part, count } of group) {
      for (let k = 0; k < count; k++) addVector(basis, part, coders[part], readers[number], step / UNIT);
    }
    readers[number].finish();
  });
  return basis;
}

/** Add the vector that is the same everywhere. */
function addConstant({ owners, norms }, { vertices, fields }, owner) {
  fields.push(new Float32Array(vertices.length).fill(1 / Math.sqrt(vertices.length)));
  owners.push(owner);
  norms.push(1);
}

/** Read a vector, and add it unless it is zero; the first one of shapes, their mean, may be that. */
function addVector({ shapes, parts, owners, norms }, part, coder, reader, unit) {
  let squares = 0;
  const mean = shapes && !owners.length, fields = Array.from({ length: shapes ? 3 : 1 }, () => {
    const values = coder.read(reader), field = new Float32Array(values.length);
    for (let i = 0; i < values.length; i++) {
      squares += values[i] * values[i];
      field[i] = values[i] * unit;
    }
    return field;
  });
  if (!squares && !mean) return;
  parts[part].fields.push(...fields);
  owners.push(part);
  norms.push(Math.sqrt(squares) * unit);
}

/** The mesh as its only part. */
const wholeOf = (mesh) => ({ vertices: Uint32Array.from(mesh.graph.order.keys()), mesh });

/** The parts of labels, each with the triangles that lie inside it. */
function partsOf(labels, number, triangles) {
  const own = new Int32Array(labels.length), vertices = Array.from({ length: number }, () => []);
  const inside = Array.from({ length: number }, () => []);
  for (let vertex = 0; vertex < labels.length; vertex++) own[vertex] = vertices[labels[vertex]].push(vertex) - 1;
  for (let k = 0; k < triangles.length; k += 3) {
    const a = triangles[k], b = triangles[k + 1], c = triangles[k + 2], part = labels[a];
    if (labels[b] === part && labels[c] === part) inside[part].push(own[a], own[b], own[c]);
  }
  return vertices.map((some, part) => ({ vertices: Uint32Array.from(some), mesh: meshGraph(inside[part], some.length) }));
}

/**
 * Number of weights of a frame: three for every field.
 */
export const widthOf = ({ shapes, owners }) => (shapes ? 9 : 3) * owners.length;

/** The weights of all fields in the frames of a chunk, frame after frame, of a sequence of so many frames. */
export function readWeights(stream, basis, count, step, frames) {
  const { shapes, parts, owners, norms } = basis, width = widthOf(basis), graph = pathGraph(count);
  const weights = new Float64Array(count * width), models = numberModels(), reader = new Reader(stream);
  const coders = parts.map(() => new SignalCoder(graph, graph, shapes ? 1 : 3, models));
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
