// Which corners at a vertex share texture coordinates, or normals, as mixseq/compression/bitstream/uv_seams.py decodes it.

/** Kinds of bits with weights of their own. */
export const SEAM_KINDS = 4;

const INTO = 0, OUT = 1, OTHER = 2, BOTH = 3, MOST_NODES = 32; // that are looked at, of a vertex

/** The node `Int32Array(C)` of every corner, numbered as they come, and how many there are. */
export function walkSeams(bits, corners, order) {
  const { starts, node: vertex, twin, before, after, aroundStarts } = corners, nodes = new Int32Array(vertex.length).fill(-1);
  const newest = new Int32Array(aroundStarts.length - 1).fill(-1), older = new Int32Array(vertex.length);
  const several = new Int32Array(newest.length), done = new Int32Array(newest.length); // nodes of a vertex, and its corners that have one
  let count = 0, history = 0;
  for (const polygon of order) {
    for (let corner = starts[polygon]; corner < starts[polygon + 1]; corner++) {
      const at = vertex[corner], last = before[corner], following = after[corner];
      let into = -1, out = -1, alongInto = 2, alongOut = 2, chosen = -1;
      if (twin[last] >= 0) {
        into = nodes[twin[last]];
        alongInto = along(nodes[last], nodes[after[twin[last]]]);
      }
      if (twin[corner] >= 0) {
        out = nodes[after[twin[corner]]];
        alongOut = along(nodes[following], nodes[twin[corner]]);
      }
      const left = aroundStarts[at + 1] - aroundStarts[at] - done[at], own = Math.min(several[at], 3) * 8 + Math.min(left, 7);
      const edges = (alongOut * 3 + alongInto) * 4 + (out >= 0 ? 1 : 0) + (into >= 0 ? 2 : 0);
      const around = (own * 4 + Math.min(several[vertex[last]], 3)) * 4 + Math.min(several[vertex[following]], 3);
      const ask = (kind) => {
        const share = Math.min(several[at], 7);
        bits.contexts.set([edges, (around << 8) | edges, ((history & 15) << 8) | edges, (share << 8) | edges, (own << 8) | edges, around, history, ((around >> 4) << 12) | (edges << 4) | (history & 15)]);
        for (let i = 0; i < 8; i++) bits.contexts[i] = (bits.contexts[i] << 4) | kind;
        const bit = bits.next(kind);
        if (kind !== OTHER) history = ((history << 1) | bit) & 255;
        return bit;
      };
      if (into >= 0 && ask(into === out ? BOTH : INTO)) chosen = into;
      if (chosen < 0 && out >= 0 && out !== into && ask(OUT)) chosen = out;
      for (let node = newest[at], looked = 0; chosen < 0 && node >= 0 && looked < MOST_NODES; node = older[node], looked++) {
        if (node !== into && node !== out && ask(OTHER)) chosen = node;
      }
      if (chosen < 0) {
        chosen = count++;
        older[chosen] = newest[at];
        newest[at] = chosen;
        several[at]++;
      }
      nodes[corner] = chosen;
      done[at]++;
    }
  }
  return { nodes, count };
}

/** Whether the other end of an edge has one node on both sides; 2 if that is not known. */
const along = (one, other) => (one < 0 || other < 0 ? 2 : one === other ? 1 : 0);
