// A compressed sequence: its mesh, and its frames at any time.
import { decodePolygons, triangulated } from "./connectivity.js";
import { CutCurve } from "./curve.js";
import { MixseqError, guarded } from "./errors.js";
import { readFacts } from "./parameters.js";
import { addPartFields, readPartVertices } from "./part_fields.js";
import { ResidualLayer } from "./residual_layer.js";
import { meshGraph } from "./signal_graph.js";
import { evaluate, readBasis, readLevels, readWeights } from "./spatial_basis.js";
import { checkSizes, decompressed, readIndex, readTimes } from "./stream_index.js";
export { MixseqError };

const SURFACE_BYTES_PER_CORNER = 64, TEXT_BYTES = 1 << 24; // limits of the size of a surface

/**
 * Open a sequence: `text` is the attribute `coding` of a compressed model, `bytes` are those of its dataset. All bytes
 * are checked; times and surface are decompressed, and nothing is decoded yet.
 */
export async function open(text, bytes) {
  const facts = guarded("the sequence", () => readFacts(text)), { parameters, cornerCount, frameCount } = facts;
  const streams = guarded("the sequence", () => readIndex(text, bytes, parameters));
  guarded("the sequence", () => checkSizes(facts, streams));
  const surface = await decompressed(streams.surface, SURFACE_BYTES_PER_CORNER * cornerCount + TEXT_BYTES, "the surface's bytes");
  const times = await decompressed(streams.times, 8 * frameCount, "the times");
  return guarded("the sequence", () => new Sequence(facts, streams, surface, times));
}

/** A sequence that is decoded on demand: the mesh, the fields over it, and chunk by chunk their weights over time. */
export class Sequence {
  #between;
  #polygons;
  #triangles;
  #basis;
  #weights = [];
  #sum = null; // positions in double precision, used again
  #inbetweens = []; // of every chunk, level by level; null if all are zero

  constructor({ firstTime, between, ...facts }, streams, surface, times) {
    Object.assign(this, facts, { streams, surface });
    this.chunks = this.streams.chunks.map(({ first, count }) => ({ first, count, loaded: false }));
    if (this.chunks.reduce((sum, { count }) => sum + count, 0) !== this.frameCount) {
      throw new MixseqError(`its chunks are not of ${this.frameCount} frames; it is damaged`);
    }
    this.times = readTimes(times, firstTime, this.frameCount, this.fps);
    this.#between = between;
  }

  /** The numbers of corners of the polygons, `counts`, and the vertices of all `corners`. */
  polygons() {
    return (this.#polygons ??= guarded("the connectivity", () =>
      decodePolygons(this.streams.connectivity, this.polygonCount, this.cornerCount, this.vertexCount)));
  }

  /** The triangles of the polygons, three vertices each. */
  triangles() {
    const { counts, corners } = this.polygons();
    return (this.#triangles ??= guarded("the polygons", () => triangulated(counts, corners)));
  }

  /**
   * Fields over the mesh: their `count`, and `parts` of the mesh, which share no vertices. A part has `vertices`, the
   * numbers of its `fields`, and their `values` at the vertices, vertex by vertex, Float64Array if they need it. A frame is the
   * sum of all fields times their `weights`, relative to `origin`.
   */
  fields() {
    return this.#decoded().basis.fields;
  }

  /** Decode the weights in the frames of a chunk, unless they are decoded. */
  load(number) {
    const chunk = this.chunks[number];
    if (!chunk || chunk.loaded) return;
    const { basis } = this.#decoded(), { first, count } = chunk, { coefficients } = this.streams.chunks[number];
    this.#weights[number] ??= guarded(`the coefficients of frames ${first} to ${first + count - 1}`, () =>
      readWeights(coefficients, basis, count, this.parameters.step, this.frameCount));
    this.#inbetweens[number] = guarded(`the in-betweens of frames ${first} to ${first + count - 1}`, () => this.#readInbetweens(number, basis));
    chunk.loaded = true;
  }

  /** The weights of all fields at a time, x, y and z of each; times are clamped to the first and last frame. */
  weights(time, out = new Float32Array(this.#decoded().width)) {
    out.set(this.#at(time));
    return out;
  }

  /**
   * The positions of the vertices at a time, relative to `origin`, three doubles: place the mesh there by a node. They are
   * computed in double precision, and rounded once if `out` is a Float32Array.
   */
  at(time, out = new Float32Array(3 * this.vertexCount)) {
    const sum = (this.#sum ??= new Float64Array(3 * this.vertexCount));
    evaluate(this.fields(), this.#at(time), sum);
    this.#residuals()?.addTo(sum, this.#inside(time));
    out.set(sum);
    return out;
  }

  /** The positions of the vertices in a frame. */
  frame(number, out) {
    return this.at(this.times[Math.min(Math.max(Math.round(number), 0), this.frameCount - 1)], out);
  }

  /** The displacements to add to the sum of the fields at a time; null if there are none. */
  residuals(time) {
    const out = this.#residuals() && new Float32Array(3 * this.vertexCount);
    return out && this.#residuals().addTo(out, this.#inside(time)) ? out : null;
  }

  /** The decoded mesh, fields and weights of a chunk, which another thread can `take`. */
  share(number) {
    this.load(number);
    const { basis, residuals } = this.#decoded();
    return { polygons: this.polygons(), triangles: this.triangles(), basis, number, weights: this.#weights[number], inbetweens: this.#inbetweens[number], residuals: residuals?.chunk(number) };
  }

  /** Take the result of `share` of the same sequence, instead of decoding it. */
  take({ polygons, triangles, basis, number, weights, inbetweens, residuals }) {
    this.#polygons ??= polygons;
    this.#triangles ??= triangles;
    this.#basis ??= this.#playable(basis, () => meshGraph(triangles, this.vertexCount).graph);
    this.#weights[number] = weights;
    this.#inbetweens[number] = inbetweens;
    this.chunks[number].loaded = true;
    if (residuals) this.#residuals().take(number, residuals);
  }

  #inside(time) {
    if (Number.isNaN(Number(time))) throw new MixseqError("a time is no number");
    return Math.min(Math.max(time, this.times[0]), this.times[this.frameCount - 1]);
  }

  #at(time) {
    return this.#decoded().curve.at(this.#inside(time));
  }

  #residuals() {
    return this.#decoded().residuals;
  }

  #decoded() {
    const triangles = this.triangles();
    return (this.#basis ??= guarded("the basis vectors", () => {
      const mesh = meshGraph(triangles, this.vertexCount), basis = readBasis(this.streams.basis, this.parameters, triangles, mesh);
      return this.#playable(this.parameters.inbetweenParts ? this.#withParts(basis, triangles) : basis, () => mesh.graph);
    }));
  }

  /** A basis with the fields of in-betweens of parts, which are those of the positions in the first frame. */
  #withParts(basis, triangles) {
    const { vertexCount, streams, parameters: { labelCount, step, diagonal } } = this, [{ count, coefficients }] = streams.chunks;
    const parts = readPartVertices(streams.labels, labelCount, triangles, vertexCount), points = new Float64Array(3 * vertexCount);
    basis.fields.count += 4 * parts.length;
    this.#weights[0] = readWeights(coefficients, basis, count, step, this.frameCount);
    evaluate(basis.fields, this.#weights[0].subarray(0, 3 * basis.fields.count), points);
    return addPartFields(basis, parts, points, diagonal);
  }

  #playable(basis, graphOf) {
    const { chunks } = this.streams, width = 3 * basis.fields.count, displaced = chunks.some(({ residuals }) => residuals.length);
    return {
      basis, width,
      curve: new CutCurve(this.times, this.#between, width, (frame) => this.#row(frame), this.parameters.inbetweenLevels,
        (level, number) => this.#offsets(level, number)),
      residuals: displaced ? new ResidualLayer(this.times, chunks, graphOf, this.parameters.correction) : null,
    };
  }

  #readInbetweens(number, basis) {
    const { first, count, inbetweens } = this.streams.chunks[number], intervals = Math.min(count, this.frameCount - 1 - first);
    const counts = Array.from({ length: this.parameters.inbetweenLevels }, (_, level) => intervals << level);
    return inbetweens.length ? readLevels(inbetweens, basis.inbetweens, counts, this.parameters.inbetweenStep, 3 * basis.fields.count) : null;
  }

  /** The offsets of weights at a middle between knots, of a level from 0 on; null if they are zero. */
  #offsets(level, middle) {
    const number = this.#chunkOf(middle >> level), inbetweens = this.#inbetweens[number];
    const { width } = this.#decoded(), start = (middle - (this.chunks[number].first << level)) * width;
    return inbetweens && inbetweens[level].subarray(start, start + width);
  }

  /** The number of the chunk of a frame, which is loaded. */
  #chunkOf(frame) {
    const number = this.chunks.findIndex(({ first, count }) => frame < first + count);
    this.load(number);
    return number;
  }

  #row(frame) {
    const number = this.#chunkOf(frame);
    const { width } = this.#decoded(), start = (frame - this.chunks[number].first) * width;
    return this.#weights[number].subarray(start, start + width);
  }
}
