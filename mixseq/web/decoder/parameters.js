// Parse and check the text of a compressed sequence. Mirrors CodingParameters of
// mixseq/compression/bitstream/compressed_sequence.py.
import { MixseqError } from "./errors.js";

const MAX_PARTS = 128;
const MAX_UV_STEPS = 2 ** 26;
const MAX_INBETWEEN_LEVELS = 3;
const MIN_NUMBER = 1e-100, MAX_NUMBER = 1e100; // range of numbers in the text
const PARAMETERS = [
  "factors", "rank", "frame_count", "step", "diagonal", "max_error", "kg_percent", "promised", "correction", "ranks", "uv_steps",
  "uv_error", "label_count", "inbetween_levels", "inbetween_step", "inbetween_error",
  "inbetween_parts", "origin",
];

const isCount = (value) => Number.isInteger(value) && value > 0;
const isNonNegative = (value) => typeof value === "number" && value >= 0 && value < Infinity;

/** The facts of a text, with JavaScript names; `parameters` are those of the coding. */
export function readFacts(text) {
  const facts = parseText(text), given = facts.coding, unknown = Object.keys(given).find((name) => !PARAMETERS.includes(name));
  if (unknown !== undefined) throw new MixseqError(`the parameter ${unknown} is unknown to this decoder; take a newer one`);
  const { vertex_count: vertices, polygon_count: polygons, corner_count: corners, frame_count: frames, fps } = facts;
  const { name, up_axis: upAxis, metres_per_unit: metresPerUnit, order = "keep" } = facts;
  const { factors, rank, ranks = [], correction = 0, uv_steps: steps = null, uv_error: error = null, label_count: labels = null } = given, shapes = factors === "shapes";
  const { inbetween_levels: levels = null, inbetween_step: betweenStep = null, inbetween_error: betweenError = null } = given;
  const { inbetween_parts: ofParts = null } = given;
  const { origin = [0, 0, 0] } = given;
  const parts = Array.isArray(ranks) ? ranks : [0];
  const checks = {
    name: typeof name === "string" && !/[\0\ud800-\udfff]/u.test(name),
    up_axis: ["X", "Y", "Z"].includes(upAxis),
    metres_per_unit: isNonNegative(metresPerUnit) && metresPerUnit > 0,
    order: ["keep", "vertices", "free"].includes(order),
    vertex_count: Number.isInteger(vertices) && vertices >= 3,
    polygon_count: isCount(polygons),
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
    correction: isNonNegative(correction),
    uv_steps: steps === null ? error === null : isCount(steps) && steps <= MAX_UV_STEPS && isNonNegative(error),
    label_count: labels === null || (isCount(labels) && labels <= MAX_PARTS),
    inbetween_levels: levels === null || (isCount(levels) && levels <= MAX_INBETWEEN_LEVELS),
    inbetween_step: levels === null ? betweenStep === null : isNonNegative(betweenStep) && betweenStep > 0,
    inbetween_parts: ofParts === null || (ofParts === true && levels !== null && labels !== null),
    inbetween_error: betweenError === null || isNonNegative(betweenError),
    origin: Array.isArray(origin) && origin.length === 3 && origin.every(Number.isFinite),
    fps: isNonNegative(fps) && fps > 0,
    first_time: Number.isFinite(facts.first_time),
  };
  const wrong = Object.keys(checks).find((name) => !checks[name]);
  if (wrong) throw new MixseqError(`${wrong} is out of range; it is damaged`);
  return {
    name, fps, upAxis, metresPerUnit,
    vertexCount: vertices, polygonCount: polygons, cornerCount: corners, frameCount: frames, firstTime: facts.first_time, origin,
    between: readInterpolation(facts.between, frames),
    parameters: {
      factors, rank, ranks: parts.length ? parts : [rank], step: given.step, diagonal: given.diagonal, maxError: given.max_error,
      kgPercent: given.kg_percent, promised: given.promised, correction, uvSteps: steps, uvError: error,
      labelCount: labels, inbetweenLevels: levels ?? 0, inbetweenStep: betweenStep, inbetweenError: betweenError,
      inbetweenParts: ofParts === true,
    },
  };
}

function parseText(text) {
  let facts = null;
  try {
    facts = JSON.parse(text, checkNumber);
  } catch (error) {
    if (error instanceof MixseqError) throw error; // others are reported below
  }
  const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
  if (!isObject(facts) || !isObject(facts.coding)) throw new MixseqError("the text of the coding is damaged, or of something else");
  return facts;
}

function checkNumber(_, value) {
  const isInside = typeof value !== "number" || !value || (Math.abs(value) >= MIN_NUMBER && Math.abs(value) <= MAX_NUMBER);
  if (isInside) return value;
  throw new MixseqError("a number is out of range");
}

/** The interpolation of weights between frames: that of the sequence, or a default. */
function readInterpolation(given, frames) {
  if (given === undefined || given === null) return { length: null, cubic: [0.5, 0.5], cuts: [] };
  const { length, cubic, cuts = [], ...others } = given;
  const inside = (value, least, most) => typeof value === "number" && value >= least && value <= most;
  const areWeights = Array.isArray(cubic) && cubic.length === 2 && cubic.every((weight) => inside(weight, 0, 1));
  const areCuts = Array.isArray(cuts) && cuts.every((cut, k) => Number.isInteger(cut) && cut > (k ? cuts[k - 1] : 0) && cut < frames);
  if (areWeights && areCuts && (length === null || inside(length, 0.5, 64)) && !Object.keys(others).length) return { length, cubic, cuts };
  throw new MixseqError("between is out of range; it is damaged");
}
