// Hard edges: which corners at a vertex share a normal, as mixseq/coding/bitstream/hard_edges.py decodes it.
import { mixedBits } from "./bit_mixing.js";
import { unpackQueues } from "./bit_queues.js";
import { MixseqError } from "./errors.js";
import { cornersOf, growingOrder } from "./growing.js";
import { MOST_NODES, SEAM_KINDS, walkSeams } from "./uv_seams.js";

const FIRST_WEIGHT = 11000;

/** Numbers `Int32Array(C)` of normals at the corners: 0, 1, 2, ... as they come. `bytes` are those before the check. */
export function decodeHardEdges(bytes, counts, corners, vertexCount) {
  const most = corners.length * (2 + MOST_NODES), mesh = cornersOf(counts, corners, vertexCount);
  const bits = mixedBits(unpackQueues(bytes, 0, most, "hard edges"), SEAM_KINDS, FIRST_WEIGHT);
  const { nodes, count } = walkSeams(bits, mesh, growingOrder(mesh));
  if (!bits.ended()) throw new MixseqError("hard edges are damaged, or those of another mesh");
  const numbers = new Int32Array(count).fill(-1);
  let used = 0;
  return nodes.map((node) => (numbers[node] < 0 ? (numbers[node] = used++) : numbers[node]));
}
