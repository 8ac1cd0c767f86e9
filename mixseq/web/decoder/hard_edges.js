// Hard edges: which corners at a vertex share a normal, as mixseq/compression/bitstream/corner_values.py decodes it.
import { checkOf, refuseOthers, withoutCheck } from "./decoded_check.js";
import { cornersOf, growingOrder } from "./growing.js";
import { hashedBits } from "./hashed_contexts.js";
import { SEAM_KINDS, walkSeams } from "./uv_seams.js";

/** Numbers `Int32Array(C)` of normals at the corners: 0, 1, 2, ... as they come. */
export function decodeHardEdges(bytes, counts, corners, vertexCount) {
  const { data, expected } = withoutCheck(bytes), mesh = cornersOf(counts, corners, vertexCount);
  const { nodes, count } = walkSeams(hashedBits(data, SEAM_KINDS), mesh, growingOrder(mesh));
  const numbers = new Int32Array(count).fill(-1);
  let used = 0;
  const found = nodes.map((node) => (numbers[node] < 0 ? (numbers[node] = used++) : numbers[node]));
  refuseOthers(checkOf(found), expected);
  return found;
}
