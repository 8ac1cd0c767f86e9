// Texture coordinates on the polygons of a mesh, as mixseq/compression/bitstream/corner_values.py decodes them.
import { checkOf, refuseOthers, withoutCheck } from "./decoded_check.js";
import { cornersOf, growingOrder } from "./growing.js";
import { hashedBits } from "./hashed_contexts.js";
import { SEAM_KINDS, walkSeams } from "./uv_seams.js";
import { VALUE_KINDS, walkValues } from "./uv_values.js";

/** Coordinates `Int32Array(2C)` at the corners, u and v of each, in units of 1 / `uv_steps`. */
export function decodeUvs(bytes, counts, corners, vertexCount) {
  const { data, expected } = withoutCheck(bytes), bits = hashedBits(data, SEAM_KINDS + VALUE_KINDS);
  const mesh = cornersOf(counts, corners, vertexCount), { nodes, count } = walkSeams(bits, mesh, growingOrder(mesh));
  const seamed = cornersOf(counts, nodes, count), values = walkValues(bits, seamed, growingOrder(seamed), count);
  const found = new Int32Array(2 * corners.length);
  nodes.forEach((node, corner) => found.set([values[2 * node], values[2 * node + 1]], 2 * corner));
  refuseOthers(checkOf(found), expected);
  return found;
}
