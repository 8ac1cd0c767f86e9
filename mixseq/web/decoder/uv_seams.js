// Decode which corners at a vertex share texture coordinates, or normals. Mirrors mixseq/compression/bitstream/uv_seams.py.

/** Kinds of bits with weights of their own. */
export const SEAM_KINDS = 4;

const INTO = 0, OUT = 1, OTHER = 2, BOTH = 3, MAX_SEARCHED_NODES = 32; // of a vertex

/** Read the nodes `Int32Array(C)` of corners, numbered in order of first use, and their number. */
export function readSeams(bits, corners, order) {
  const { starts, node: vertices, twin, before, after, aroundStarts } = corners, nodes = new Int32Array(vertices.length).fill(-1);
  const newest = new Int32Array(aroundStarts.length - 1).fill(-1), older = new Int32Array(vertices.length);
  const nodeCounts = new Int32Array(newest.length), codedCounts = new Int32Array(newest.length); // nodes of a vertex, and its corners that have a node
  let count = 0, history = 0;
  for (const polygon of order) {
    for (let corner = starts[polygon]; corner < starts[polygon + 1]; corner++) {
      const vertex = vertices[corner], previous = before[corner], following = after[corner];
      let into = -1, out = -1, sharedInto = 2, sharedOut = 2, chosen = -1;
      if (twin[previous] >= 0) {
        into = nodes[twin[previous]];
        sharedInto = isShared(nodes[previous], nodes[after[twin[previous]]]);
      }
      if (twin[corner] >= 0) {
        out = nodes[after[twin[corner]]];
        sharedOut = isShared(nodes[following], nodes[twin[corner]]);
      }
      const remaining = aroundStarts[vertex + 1] - aroundStarts[vertex] - codedCounts[vertex], own = Math.min(nodeCounts[vertex], 3) * 8 + Math.min(remaining, 7);
      const edges = (sharedOut * 3 + sharedInto) * 4 + (out >= 0 ? 1 : 0) + (into >= 0 ? 2 : 0);
      const around = (own * 4 + Math.min(nodeCounts[vertices[previous]], 3)) * 4 + Math.min(nodeCounts[vertices[following]], 3);
      const readBit = (kind) => {
        const ownCount = Math.min(nodeCounts[vertex], 7);
        bits.contexts.set([edges, (around << 8) | edges, ((history & 15) << 8) | edges, (ownCount << 8) | edges, (own << 8) | edges, around, history, ((around >> 4) << 12) | (edges << 4) | (history & 15)]);
        for (let i = 0; i < 8; i++) bits.contexts[i] = (bits.contexts[i] << 4) | kind;
        const bit = bits.next(kind);
        if (kind !== OTHER) history = ((history << 1) | bit) & 255;
        return bit;
      };
      if (into >= 0 && readBit(into === out ? BOTH : INTO)) chosen = into;
      if (chosen < 0 && out >= 0 && out !== into && readBit(OUT)) chosen = out;
      for (let node = newest[vertex], searched = 0; chosen < 0 && node >= 0 && searched < MAX_SEARCHED_NODES; node = older[node], searched++) {
        if (node !== into && node !== out && readBit(OTHER)) chosen = node;
      }
      if (chosen < 0) {
        chosen = count++;
        older[chosen] = newest[vertex];
        newest[vertex] = chosen;
        nodeCounts[vertex]++;
      }
      nodes[corner] = chosen;
      codedCounts[vertex]++;
    }
  }
  return { nodes, count };
}

/** Whether the other end of an edge has one node on both sides; 2 if unknown. */
const isShared = (node, other) => (node < 0 || other < 0 ? 2 : node === other ? 1 : 0);
