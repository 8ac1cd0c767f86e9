// Texture coordinates on the polygons of a mesh, as mixseq/coding/bitstream/texture_coordinates.py decodes them.
import { mixedBits } from "./bit_mixing.js";
import { unpackQueues } from "./bit_queues.js";
import { MixseqError } from "./errors.js";
import { cornersOf, growingOrder } from "./growing.js";
import { MOST_NODES, SEAM_KINDS, walkSeams } from "./uv_seams.js";
import { LONGEST, VALUE_KINDS, walkValues } from "./uv_values.js";

const FIRST_WEIGHT = 11000;

/**
 * Coordinates `Int32Array(2C)` at the corners, u and v of each, in units of 1 / `uv_steps`. `bytes` are those before the check.
 */
export function decodeUvs(bytes, counts, corners, vertexCount) {
  const size = corners.length, most = size * (2 + MOST_NODES) + (size + counts.length) * 2 * (2 * LONGEST + 1);
  const bits = mixedBits(unpackQueues(bytes, 0, most, "texture coordinates"), SEAM_KINDS + VALUE_KINDS, FIRST_WEIGHT);
  const mesh = cornersOf(counts, corners, vertexCount), { nodes, count } = walkSeams(bits, mesh, growingOrder(mesh));
  const seamed = cornersOf(counts, nodes, count), values = walkValues(bits, seamed, growingOrder(seamed), count);
  if (!bits.ended()) throw new MixseqError("texture coordinates are damaged, or those of another mesh");
  const found = new Int32Array(2 * size);
  nodes.forEach((node, corner) => found.set([values[2 * node], values[2 * node + 1]], 2 * corner));
  return found;
}
