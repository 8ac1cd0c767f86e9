// Regions of texture coordinates that are copies of earlier ones. Mirrors mixseq/compression/bitstream/uv_seams.py.

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
