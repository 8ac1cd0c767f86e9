// Parse and check the text of a compressed sequence. Mirrors CodingParameters of
// mixseq/compression/bitstream/compressed_sequence.py.
import { MixseqError } from "./errors.js";

const MAX_PARTS = 128;
const MAX_UV_STEPS = 2 ** 26;
const MAX_INBETWEEN_LEVELS = 3;
const MAX_MEMORY = 2 ** 32; // bytes that a sequence may take
const PARAMETERS = [
  "factors", "rank", "frame_count", "step", "diagonal", "max_error", "kg_percent", "promised", "correction", "ranks", "uv_steps",
  "uv_error", "label_count", "inbetween_levels", "inbetween_step", "inbetween_error", "origin",
];

const isCount = (value) => Number.isInteger(value) && value > 0;
const isNonNegative = (value) => typeof value === "number" && value >= 0 && value < Infinity;

/** The facts of a text, with JavaScript names; `parameters` are those of the coding. */
export function readFacts(text) {
  const facts = parseText(text), given = facts.coding, unknown = Object.keys(given).find((name) => !PARAMETERS.includes(name));
  if (unknown !== undefined) throw new MixseqError(`the parameter ${unknown} is unknown to this decoder; take a newer one`);
  const { vertex_count: vertices, polygon_count: polygons, corner_count: corners, frame_count: frames, fps } = facts;
  const { factors, rank, ranks = [], uv_steps: steps = null, uv_error: error = null, label_count: labels = null } = given, shapes = factors === "shapes";
  const { inbetween_levels: levels = null, inbetween_step: betweenStep = null, inbetween_error: betweenError = null } = given;
  const { origin = [0, 0, 0] } = given;
  const parts = Array.isArray(ranks) ? ranks : [0];
  const checks = {
    vertex_count: isCount(vertices),
    polygon_count: Number.isInteger(polygons) && polygons >= 0,
    corner_count: Number.isInteger(corners) && corners >= 3 * polygons,
    frame_count: isCount(frames) && frames === given.frame_count,
    factors: shapes || factors === "trajectories",
    rank: isCount(rank) && rank <= 3 * Math.min(Math.max(parts.length, 1) * frames, vertices) + Math.max(parts.length, 1),
    ranks: parts.every(isCount) && parts.length <= MAX_PARTS && (!parts.length || (!shapes && parts.reduce((a, b) => a + b) === rank)),
    step: isNonNegative(given.step) && given.step > 0,
    diagonal: isNonNegative(given.diagonal) && given.diagonal > 0,
    max_error: isNonNegative(given.max_error),
    kg_percent: isNonNegative(given.kg_percent),
    promised: typeof given.promised === "boolean",
    correction: isNonNegative(given.correction ?? 0),
    uv_steps: steps === null ? error === null : isCount(steps) && steps <= MAX_UV_STEPS && isNonNegative(error),
    label_count: labels === null || (isCount(labels) && labels <= MAX_PARTS),
    inbetween_levels: levels === null || (isCount(levels) && levels <= MAX_INBETWEEN_LEVELS),
    inbetween_step: levels === null ? betweenStep === null : isNonNegative(betweenStep) && betweenStep > 0,
    inbetween_error: betweenError === null || isNonNegative(betweenError),
    origin: Array.isArray(origin) && origin.length === 3 && origin.every(Number.isFinite),
    fps: isNonNegative(fps) && fps > 0,
    first_time: Number.isFinite(facts.first_time),
  };
  const wrong = Object.keys(checks).find((name) => !checks[name]);
  if (wrong) throw new MixseqError(`${wrong} is out of range; it is damaged`);
  const bytes = 64 * (vertices + frames) + 320 * corners + 16 * rank * ((shapes ? 3 : 1) * vertices + (shapes ? 9 : 3) * frames * 2 ** (levels ?? 0));
  if (bytes > MAX_MEMORY) throw new MixseqError(`it would take ${Math.ceil(bytes / 2 ** 30)} GiB of memory, more than the allowed 4 GiB`);
  return {
    name: String(facts.name ?? ""), fps, upAxis: String(facts.up_axis ?? "y"), metresPerUnit: Number(facts.metres_per_unit ?? 1),
    vertexCount: vertices, polygonCount: polygons, cornerCount: corners, frameCount: frames, firstTime: facts.first_time, origin,
    between: readInterpolation(facts.between),
    parameters: {
      factors, rank, ranks: parts.length ? parts : [rank], step: given.step, diagonal: given.diagonal, maxError: given.max_error,
      kgPercent: given.kg_percent, promised: given.promised, correction: given.correction ?? 0, uvSteps: steps, uvError: error,
      labelCount: labels, inbetweenLevels: levels ?? 0, inbetweenStep: betweenStep, inbetweenError: betweenError,
    },
  };
}

function parseText(text) {
  let facts = null;
  try {
    facts = JSON.parse(text);
  } catch {
    // reported below
  }
  const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
  if (!isObject(facts) || !isObject(facts.coding)) throw new MixseqError("the text of the coding is damaged, or of something else");
  return facts;
}

/** The interpolation of weights between frames: that of the sequence, or a default. */
function readInterpolation(given) {
  if (given === undefined || given === null) return { length: null, cubic: [0.5, 0.5] };
  const { length, cubic, ...others } = given;
  const inside = (value, least, most) => typeof value === "number" && value >= least && value <= most;
  const areWeights = Array.isArray(cubic) && cubic.length === 2 && cubic.every((weight) => inside(weight, 0, 1));
  if (areWeights && (length === null || inside(length, 0.5, 64)) && !Object.keys(others).length) return { length, cubic };
  throw new MixseqError("between is out of range; it is damaged");
}
