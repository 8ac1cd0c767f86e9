// Decode texture coordinates on the polygons of a mesh. Mirrors mixseq/compression/bitstream/corner_values.py.
import { checksumOf, verifyChecksum, splitChecksum } from "./decoded_check.js";
import { cornersOnNodes, growingOrder } from "./growing.js";
import { hashedBits } from "./hashed_contexts.js";
import { SEAM_KINDS, readSeams } from "./uv_seams.js";
import { VALUE_KINDS, readValues } from "./uv_values.js";

/** Coordinates `Int32Array(2C)` at the corners, u and v of each, in units of 1 / `uv_steps`. */
export function decodeUvs(bytes, counts, corners, vertexCount) {
  const { data, expected } = splitChecksum(bytes), bits = hashedBits(data, SEAM_KINDS + VALUE_KINDS);
  const mesh = cornersOnNodes(counts, corners, vertexCount), { nodes, count } = readSeams(bits, mesh, growingOrder(mesh));
  const seamed = cornersOnNodes(counts, nodes, count), values = readValues(bits, seamed, growingOrder(seamed), count);
  const found = new Int32Array(2 * corners.length);
  nodes.forEach((node, corner) => found.set([values[2 * node], values[2 * node + 1]], 2 * corner));
  verifyChecksum(checksumOf(found), expected);
  return found;
}
