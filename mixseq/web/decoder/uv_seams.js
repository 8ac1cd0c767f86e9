// Decode which corners at a vertex share texture coordinates, or normals; guess coordinates from adjacent nodes and copies.
// Mirrors parts of mixseq/compression/bitstream/corners.py and corner_values.py.

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

/** Kinds of guesses. */
export const COPIED = 0;
export const AROUND = 1;
const BEYOND = 2;
export const BESIDE = 3;
const ANYWHERE = 4;

/** An empty guess; the names are those of the Python module, with `kind`, `count` and `spread` for `facts`. */
export const newGuess = () => ({ value: [0, 0], drawBack: [0, 0], low: [0, 0], high: [0, 0], kind: ANYWHERE, count: 0, spread: 0 });

/** Guess the coordinates at a corner; `last` is the last known node, -1 for none. */
export function makeGuess(corners, { values, isKnown }, corner, last, guess) {
  const { starts, polygon, node, twin, before, after, aroundStarts, around } = corners, x = node[corner];
  const { value, drawBack, low, high } = guess;
  let count = 0;
  value.fill(0);
  drawBack.fill(0);

  function addToMean(u, v) {
    value[0] += u;
    value[1] += v;
    low[0] = count ? Math.min(low[0], u) : u;
    low[1] = count ? Math.min(low[1], v) : v;
    high[0] = count ? Math.max(high[0], u) : u;
    high[1] = count ? Math.max(high[1], v) : v;
    count++;
  }

  for (let place = aroundStarts[x]; place < aroundStarts[x + 1]; place++) {
    const other = around[place], a = node[before[other]], edge = after[other], b = node[edge], size = starts[polygon[other] + 1] - starts[polygon[other]];
    let across = after[edge];
    if (size === 3 && twin[edge] >= 0) across = before[twin[edge]];
    else if (size !== 4) continue;
    const z = node[across];
    if (!(isKnown[a] && isKnown[b] && isKnown[z]) || z === x) continue;
    const u = values[2 * a] + values[2 * b], v = values[2 * a + 1] + values[2 * b + 1], zu = values[2 * z], zv = values[2 * z + 1];
    drawBack[0] += u - zu - (u >> 1);
    drawBack[1] += v - zv - (v >> 1);
    addToMean(u - zu, v - zv);
  }
  guess.kind = AROUND;
  if (count) for (let i = 0; i < 2; i++) drawBack[i] = Math.floor((3 * Math.floor(drawBack[i] / count)) / 8);
  else guessBeyond();

  function guessBeyond() {
    const a = before[corner], b = after[corner];
    const addBeyond = (near, edge, next) => {
      if (edge < 0 || !isKnown[near]) return;
      const e = node[next(edge)];
      if (isKnown[e]) addToMean(2 * values[2 * near] - values[2 * e], 2 * values[2 * near + 1] - values[2 * e + 1]);
    };
    guess.kind = BEYOND;
    addBeyond(node[a], twin[before[a]], (edge) => before[edge]);
    addBeyond(node[b], twin[b], (edge) => after[after[edge]]);
    if (count) return;
    guess.kind = BESIDE;
    for (const near of [node[a], node[b]]) if (isKnown[near]) addToMean(values[2 * near], values[2 * near + 1]);
    if (count) return;
    guess.kind = ANYWHERE;
    addToMean(last < 0 ? 0 : values[2 * last], last < 0 ? 0 : values[2 * last + 1]);
  }

  guess.count = count;
  guess.spread = high[0] - low[0] + high[1] - low[1];
  for (let i = 0; i < 2; i++) value[i] = Math.floor((2 * value[i] + count) / (2 * count));
}

// Regions of texture coordinates that are copies of earlier ones.

const MAX_ROTATION = 1 << 17, PIECE_SIZE = 1 << 14;

/** A state without regions; the names are those of the Python module. */
export function newCopies({ node }, order) {
  const places = new Int32Array(order.length);
  order.forEach((polygon, place) => (places[polygon] = place));
  return {
    places, image: new Int32Array(node.length).fill(-1), mirrored: new Uint8Array(order.length),
    region: new Int32Array(order.length).fill(-1), anchors: new Int32Array(2 * order.length).fill(-1),
  };
}

/** The image of a corner that follows from the polygon across the half-edge from it; -1 if there is none. */
function inheritedImage({ twin, polygon, after }, { region, mirrored, image }, corner) {
  const across = twin[corner];
  if (across < 0 || region[polygon[across]] < 0) return -1;
  if (!mirrored[polygon[across]]) return twin[image[across]];
  const edge = twin[image[after[across]]];
  return edge >= 0 ? after[edge] : -1;
}

/** Set a polygon's image from an adjacent polygon, its corners in order; return whether there is one. */
export function inheritImage(corners, copies, p) {
  const { starts, polygon, twin } = corners;
  for (let corner = starts[p]; corner < starts[p + 1]; corner++) {
    const image = inheritedImage(corners, copies, corner);
    if (image >= 0 && canBeImage(corners, copies, p, polygon[image])) {
      const beside = polygon[twin[corner]];
      setImage(corners, copies, corner, image, copies.mirrored[beside], copies.region[beside]);
      return true;
    }
  }
  return false;
}

/** Whether a polygon can be the image of another one. */
export function canBeImage({ starts }, { places }, p, image) {
  return starts[image + 1] - starts[image] === starts[p + 1] - starts[p] && places[image] < places[p];
}

/** Set the image of a corner, and with it of all corners of its polygon. */
export function setImage({ polygon, starts, after, before }, copies, corner, image, mirrored, region) {
  const p = polygon[corner];
  copies.mirrored[p] = mirrored;
  copies.region[p] = region;
  for (let k = starts[p]; k < starts[p + 1]; k++) {
    copies.image[corner] = image;
    corner = after[corner];
    image = mirrored ? before[image] : after[image];
  }
}

/** Make a corner an anchor of its region, if it is the first one, or its image farther from the first one's. */
export function updateAnchors({ node, polygon }, { image, region, anchors }, { values, isKnown }, corner) {
  const place = 2 * region[polygon[corner]];
  if (!(isKnown[node[corner]] && isKnown[node[image[corner]]])) return;
  if (anchors[place] < 0) {
    anchors[place] = corner;
    return;
  }
  const first = node[image[anchors[place]]];
  const distance = (x) => Math.abs(values[2 * x] - values[2 * first]) + Math.abs(values[2 * x + 1] - values[2 * first + 1]);
  if (distance(node[image[corner]]) > (anchors[place + 1] < 0 ? 0 : distance(node[image[anchors[place + 1]]]))) anchors[place + 1] = corner;
}

/** Set the guess at a corner to the copy of its image; return its number of anchors, 0 if there is no copy. */
export function guessCopy({ node, polygon, before, after }, { image, region, anchors, mirrored }, { values, isKnown }, corner, { value }) {
  const p = polygon[corner], place = 2 * region[p], first = anchors[place], second = anchors[place + 1];
  if (place < 0 || !isKnown[node[image[corner]]] || first < 0) return 0;
  const isUsable = (near) => isKnown[node[near]] && isKnown[node[image[near]]], from = [before[corner], after[corner]].find(isUsable) ?? first;
  const offset = (one, other, i) => values[2 * node[one] + i] - values[2 * node[other] + i], sign = mirrored[p] ? -1 : 1;
  const u = offset(image[corner], image[from], 0), v = offset(image[corner], image[from], 1), [x, y] = [0, 1].map((i) => values[2 * node[from] + i]);
  if (second < 0) {
    value[0] = x + sign * u;
    value[1] = y + v;
    return 1;
  }
  let side = [offset(second, first, 0), offset(second, first, 1)], imageSide = [offset(image[second], image[first], 0), sign * offset(image[second], image[first], 1)];
  let size = [...side, ...imageSide].reduce((sum, each) => sum + Math.abs(each), 0);
  for (; size >= MAX_ROTATION; size = Math.floor(size / 2)) [side, imageSide] = [side, imageSide].map((pair) => pair.map((each) => each >> 1));
  const norm = imageSide[0] * imageSide[0] + imageSide[1] * imageSide[1];
  if (!norm) return 0;
  const turnU = side[0] * imageSide[0] + side[1] * imageSide[1], turnV = side[1] * imageSide[0] - side[0] * imageSide[1];
  value[0] = x + nearest(turnU, u, -turnV, sign * v, norm);
  value[1] = y + nearest(turnU, sign * v, turnV, u, norm);
  return 2;
}

/** (a b + c d) / norm, rounded to the nearest, halves up; in two pieces, so that all numbers stay below 2^53. */
export function nearest(a, b, c, d, norm) {
  const [b1, d1] = [b, d].map((each) => Math.floor(each / PIECE_SIZE)), upper = a * b1 + c * d1, lower = a * (b - PIECE_SIZE * b1) + c * (d - PIECE_SIZE * d1);
  const quotient = Math.floor(upper / norm);
  return PIECE_SIZE * quotient + Math.floor((2 * (PIECE_SIZE * (upper - quotient * norm) + lower) + norm) / (2 * norm));
}
