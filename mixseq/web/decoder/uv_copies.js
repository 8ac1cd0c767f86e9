// Regions of texture coordinates that are copies of earlier ones, as in mixseq/compression/bitstream/uv_seams.py.

const PRECISION = 1 << 17, PIECE = 1 << 14;

/** A state without regions; the names are those of the Python module. */
export function noCopies({ node }, order) {
  const places = new Int32Array(order.length);
  order.forEach((polygon, place) => (places[polygon] = place));
  return {
    places, image: new Int32Array(node.length).fill(-1), mirrored: new Uint8Array(order.length),
    region: new Int32Array(order.length).fill(-1), anchors: new Int32Array(2 * order.length).fill(-1),
  };
}

/** The image of a corner that follows from the polygon beyond the half-edge from it; -1 if there is none. */
function imageOf({ twin, polygon, after }, { region, mirrored, image }, corner) {
  const there = twin[corner];
  if (there < 0 || region[polygon[there]] < 0) return -1;
  if (!mirrored[polygon[there]]) return twin[image[there]];
  const edge = twin[image[after[there]]];
  return edge >= 0 ? after[edge] : -1;
}

/** Give a polygon the image that follows from one beside it, its corners in order; return whether there is one. */
export function follow(corners, copies, p) {
  const { starts, polygon, twin } = corners;
  for (let corner = starts[p]; corner < starts[p + 1]; corner++) {
    const image = imageOf(corners, copies, corner);
    if (image >= 0 && fits(corners, copies, p, polygon[image])) {
      const beside = polygon[twin[corner]];
      giveImage(corners, copies, corner, image, copies.mirrored[beside], copies.region[beside]);
      return true;
    }
  }
  return false;
}

/** Whether a polygon can be the image of another one. */
export function fits({ starts }, { places }, p, image) {
  return starts[image + 1] - starts[image] === starts[p + 1] - starts[p] && places[image] < places[p];
}

/** Give a corner its image, and with it all corners of its polygon. */
export function giveImage({ polygon, starts, after, before }, copies, corner, image, mirrored, region) {
  const p = polygon[corner];
  copies.mirrored[p] = mirrored;
  copies.region[p] = region;
  for (let k = starts[p]; k < starts[p + 1]; k++) {
    copies.image[corner] = image;
    corner = after[corner];
    image = mirrored ? before[image] : after[image];
  }
}

/** Take a corner as an anchor of its region, if it is the first one, or its image farther from the first one's. */
export function dropAnchor({ node, polygon }, { image, region, anchors }, { values, there }, corner) {
  const place = 2 * region[polygon[corner]];
  if (!(there[node[corner]] && there[node[image[corner]]])) return;
  if (anchors[place] < 0) {
    anchors[place] = corner;
    return;
  }
  const first = node[image[anchors[place]]];
  const far = (at) => Math.abs(values[2 * at] - values[2 * first]) + Math.abs(values[2 * at + 1] - values[2 * first + 1]);
  if (far(node[image[corner]]) > (anchors[place + 1] < 0 ? 0 : far(node[image[anchors[place + 1]]]))) anchors[place + 1] = corner;
}

/** Make the guess at a corner a copy of its image; return from how many anchors, 0 if there is no copy. */
export function copy({ node, polygon, before, after }, { image, region, anchors, mirrored }, { values, there }, corner, { at }) {
  const p = polygon[corner], place = 2 * region[p], first = anchors[place], second = anchors[place + 1];
  if (place < 0 || !there[node[image[corner]]] || first < 0) return 0;
  const sound = (each) => there[node[each]] && there[node[image[each]]], from = [before[corner], after[corner]].find(sound) ?? first;
  const apart = (one, other, i) => values[2 * node[one] + i] - values[2 * node[other] + i], sign = mirrored[p] ? -1 : 1;
  const u = apart(image[corner], image[from], 0), v = apart(image[corner], image[from], 1), [x, y] = [0, 1].map((i) => values[2 * node[from] + i]);
  if (second < 0) {
    at[0] = x + sign * u;
    at[1] = y + v;
    return 1;
  }
  let here = [apart(second, first, 0), apart(second, first, 1)], far = [apart(image[second], image[first], 0), sign * apart(image[second], image[first], 1)];
  let size = [...here, ...far].reduce((sum, each) => sum + Math.abs(each), 0);
  for (; size >= PRECISION; size = Math.floor(size / 2)) [here, far] = [here, far].map((pair) => pair.map((each) => each >> 1));
  const whole = far[0] * far[0] + far[1] * far[1];
  if (!whole) return 0;
  const turnU = here[0] * far[0] + here[1] * far[1], turnV = here[1] * far[0] - here[0] * far[1];
  at[0] = x + nearest(turnU, u, -turnV, sign * v, whole);
  at[1] = y + nearest(turnU, sign * v, turnV, u, whole);
  return 2;
}

/** (a b + c d) / whole, rounded to the nearest, halves up; in two pieces, so that all numbers stay below 2^53. */
export function nearest(a, b, c, d, whole) {
  const [b1, d1] = [b, d].map((each) => Math.floor(each / PIECE)), upper = a * b1 + c * d1, lower = a * (b - PIECE * b1) + c * (d - PIECE * d1);
  const quotient = Math.floor(upper / whole);
  return PIECE * quotient + Math.floor((2 * (PIECE * (upper - quotient * whole) + lower) + whole) / (2 * whole));
}
