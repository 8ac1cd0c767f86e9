// What the text of a compressed sequence says, and whether that can be. Mirrors CodingParameters of
// coding/bitstream/compressed_sequence.py.
import { MixseqError } from "./errors.js";

const MOST_PARTS = 128;
const LARGEST_STEPS = 2 ** 26;
const LARGEST = 2 ** 32; // bytes that a sequence may take
const PARAMETERS = [
  "factors", "rank", "frame_count", "step", "diagonal", "max_error", "kg_percent", "promised", "correction", "ranks", "uv_steps",
  "uv_error",
];

const isCount = (value) => Number.isInteger(value) && value > 0;
const isSize = (value) => typeof value === "number" && value >= 0 && value < Infinity;

/** The facts of a text, with names as they are in JavaScript; `parameters` are those of the coding. */
export function readFacts(text) {
  const facts = parsed(text), given = facts.coding, strange = Object.keys(given).find((name) => !PARAMETERS.includes(name));
  if (strange !== undefined) throw new MixseqError(`this decoder does not know the parameter ${strange}; take a newer one`);
  const { vertex_count: vertices, polygon_count: polygons, corner_count: corners, frame_count: frames, fps } = facts;
  const { factors, rank, ranks = [], uv_steps: steps = null, uv_error: error = null } = given, shapes = factors === "shapes";
  const parts = Array.isArray(ranks) ? ranks : [0];
  const checks = {
    vertex_count: isCount(vertices),
    polygon_count: Number.isInteger(polygons) && polygons >= 0,
    corner_count: Number.isInteger(corners) && corners >= 3 * polygons,
    frame_count: isCount(frames) && frames === given.frame_count,
    factors: shapes || factors === "trajectories",
    rank: isCount(rank) && rank <= 3 * Math.min(Math.max(parts.length, 1) * frames, vertices) + Math.max(parts.length, 1),
    ranks: parts.every(isCount) && parts.length <= MOST_PARTS && (!parts.length || (!shapes && parts.reduce((a, b) => a + b) === rank)),
    step: isSize(given.step) && given.step > 0,
    diagonal: isSize(given.diagonal) && given.diagonal > 0,
    max_error: isSize(given.max_error),
    kg_percent: isSize(given.kg_percent),
    promised: typeof given.promised === "boolean",
    correction: isSize(given.correction ?? 0),
    uv_steps: steps === null ? error === null : isCount(steps) && steps <= LARGEST_STEPS && isSize(error),
    fps: isSize(fps) && fps > 0,
    first_time: Number.isFinite(facts.first_time),
  };
  const wrong = Object.keys(checks).find((name) => !checks[name]);
  if (wrong) throw new MixseqError(`${wrong} is not what it can be; it is damaged`);
  const bytes = 64 * (vertices + frames) + 320 * corners + 16 * rank * ((shapes ? 3 : 1) * vertices + (shapes ? 9 : 3) * frames);
  if (bytes > LARGEST) throw new MixseqError(`it would take ${Math.ceil(bytes / 2 ** 30)} GiB of memory, more than it may`);
  return {
    name: String(facts.name ?? ""), fps, upAxis: String(facts.up_axis ?? "y"), metresPerUnit: Number(facts.metres_per_unit ?? 1),
    vertexCount: vertices, polygonCount: polygons, cornerCount: corners, frameCount: frames, firstTime: facts.first_time,
    between: betweenOf(facts.between),
    parameters: {
      factors, rank, ranks: parts.length ? parts : [rank], step: given.step, diagonal: given.diagonal, maxError: given.max_error,
      kgPercent: given.kg_percent, promised: given.promised, correction: given.correction ?? 0, uvSteps: steps, uvError: error,
    },
  };
}

function parsed(text) {
  let facts = null;
  try {
    facts = JSON.parse(text);
  } catch {
    // told below
  }
  const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
  if (!isObject(facts) || !isObject(facts.coding)) throw new MixseqError("the text of the coding is damaged, or of something else");
  return facts;
}

/** How weights are predicted between frames: what was chosen for the sequence, or what suits most. */
function betweenOf(given) {
  if (given === undefined || given === null) return { length: null, cubic: [0.5, 0.5] };
  const { length, cubic, ...others } = given;
  const inside = (value, least, most) => typeof value === "number" && value >= least && value <= most;
  const shares = Array.isArray(cubic) && cubic.length === 2 && cubic.every((share) => inside(share, 0, 1));
  if (shares && (length === null || inside(length, 0.5, 64)) && !Object.keys(others).length) return { length, cubic };
  throw new MixseqError("between is not what it can be; it is damaged");
}
