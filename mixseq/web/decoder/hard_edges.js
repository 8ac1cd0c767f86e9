// Decode hard edges: which corners at a vertex share a normal. Mirrors mixseq/compression/bitstream/corner_values.py.
import { checksumOf, verifyChecksum, splitChecksum } from "./decoded_check.js";
import { cornersOnNodes, growingOrder } from "./growing.js";
import { hashedBits } from "./hashed_contexts.js";
import { SEAM_KINDS, readSeams } from "./uv_seams.js";

/** Numbers `Int32Array(C)` of normals at the corners: 0, 1, 2, ... in order of first use. */
export function decodeHardEdges(bytes, counts, corners, vertexCount) {
  const { data, expected } = splitChecksum(bytes), mesh = cornersOnNodes(counts, corners, vertexCount);
  const { nodes, count } = readSeams(hashedBits(data, SEAM_KINDS), mesh, growingOrder(mesh));
  const numbers = new Int32Array(count).fill(-1);
  let used = 0;
  const found = nodes.map((node) => (numbers[node] < 0 ? (numbers[node] = used++) : numbers[node]));
  verifyChecksum(checksumOf(found), expected);
  return found;
}
