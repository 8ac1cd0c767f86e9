// Decode texture coordinates and hard edges on the polygons of a mesh. Mirrors mixseq/compression/bitstream/corner_values.py and corners.py.
import { checksumOf, hashedBits, splitChecksum, verifyChecksum } from "./arithmetic.js";
import { cornersOnNodes, growingOrder } from "./connectivity.js";
import { MixseqError } from "./errors.js";
import { AROUND, BESIDE, COPIED, SEAM_KINDS, canBeImage, guessCopy, inheritImage, makeGuess, newCopies, newGuess, readSeams, setImage, updateAnchors } from "./uv_seams.js";

const GUESS_GROUPS = 4, MAX_NUMBER_BITS = 40, MAX_COORDINATE = 1 << 26, MAX_COPY_ERROR = 8, REGION_KIND = 2 * GUESS_GROUPS, IMAGE_KIND = 2 * GUESS_GROUPS + 1;

/** Kinds of bits with weights of their own, after those of seams. */
const VALUE_KINDS = 2 * GUESS_GROUPS + 2;

/** Read the values `Int32Array(2N)` of all nodes. */
function readValues(bits, corners, order, count) {
  const { starts, polygon: polygons, node, after } = corners, copies = newCopies(corners, order), guess = newGuess();
  const known = { values: new Int32Array(2 * count), isKnown: new Uint8Array(count), errors: new Float64Array(count) };
  const { values, isKnown } = known, facts = [0, 0, 0], sizes = [0, 0, 0, 0], means = [64, 64, 160, 160], losses = [0, 0];
  let last = -1;
  for (const polygon of order) {
    const first = starts[polygon], stop = starts[polygon + 1];
    let unknown = 0, corner = -1, isImageWrong = false;
    for (let each = first; each < stop; each++) {
      if (!isKnown[node[each]]) unknown++;
      else if (corner < 0 && !isKnown[node[after[each]]]) corner = each;
    }
    if (!inheritImage(corners, copies, polygon) && unknown) {
      facts.fill(unknown === stop - first ? 1 : 0);
      sizes.fill(0);
      readRegion(polygon);
    }
    const isRegionStart = copies.region[polygon] === copies.places[polygon];
    corner = Math.max(first, corner);
    for (let k = first; k < stop; k++) {
      if (!isKnown[node[corner]]) isImageWrong = readNode(corner, node[corner]) || isImageWrong;
      if (isRegionStart) updateAnchors(corners, copies, known, corner);
      corner = after[corner];
    }
    if (isImageWrong) copies.region[polygon] = -1;
    else if (copies.region[polygon] >= 0) for (let each = first; each < stop; each++) updateAnchors(corners, copies, known, each);
  }
  return values;

  /** Read the coordinates of a node; return whether the copy of an image was worse than the other guess. */
  function readNode(corner, x) {
    makeGuess(corners, known, corner, last, guess);
    const { value, drawBack } = guess, plain = [...value], anchors = guessCopy(corners, copies, known, corner, guess);
    let kind = guess.kind;
    if (anchors) kind = anchors === 2 ? COPIED : BESIDE;
    else if (kind === AROUND && losses[1] < losses[0]) drawBack.forEach((each, i) => (value[i] -= each));
    const group = kind === COPIED ? 1 : kind >= BESIDE ? kind - 1 : 0;
    setContexts(corner, kind, means[group]);
    for (let i = 0; i < 2; i++) {
      const error = readNumber(2 * group + i), coordinate = value[i] + error, length = 16 * bitLength(error);
      if (Math.abs(coordinate) > MAX_COORDINATE) throw damaged();
      values[2 * x + i] = coordinate;
      known.errors[x] += Math.abs(error);
      means[group] += (length - means[group]) >> 4;
      facts[2] = sizes[3] = length;
    }
    const errorOf = (drawn) => Math.abs(values[2 * x] - plain[0] + drawn * drawBack[0]) + Math.abs(values[2 * x + 1] - plain[1] + drawn * drawBack[1]);
    if (guess.kind === AROUND) for (let drawn = 0; drawn < 2; drawn++) losses[drawn] += sizeInBits(errorOf(drawn)) - (losses[drawn] >> 5);
    isKnown[x] = 1;
    last = x;
    return anchors === 2 && known.errors[x] > MAX_COPY_ERROR && known.errors[x] > errorOf(0);
  }

  /** Read whether a region begins with a polygon, and its image. */
  function readRegion(polygon) {
    const place = copies.places[polygon], back = readNumber(REGION_KIND);
    if (!back) return;
    if (back > place) throw damaged();
    const other = order[place - back], turn = readNumber(IMAGE_KIND), image = starts[other] + Math.floor(turn / 2);
    if (image >= starts[other + 1] || !canBeImage(corners, copies, polygon, other)) throw damaged();
    setImage(corners, copies, starts[polygon], image, turn % 2, place);
  }

  /** Set the facts of a guess, and the expected sizes of its error. */
  function setContexts(corner, kind, mean) {
    const a = node[corners.before[corner]], b = node[after[corner]], near = (known.errors[a] + known.errors[b]) * (isKnown[a] !== isKnown[b] ? 2 : 1);
    const edge = isKnown[a] && isKnown[b] ? Math.abs(values[2 * a] - values[2 * b]) + Math.abs(values[2 * a + 1] - values[2 * b + 1]) : 0;
    facts[0] = facts[1] = (kind << 2) | Math.min(guess.count, 3);
    facts[2] = kind;
    [mean, sizeInBits(near), sizeInBits(edge), sizeInBits(guess.spread)].forEach((size, i) => (sizes[i] = size));
  }

  /** Read a number, in contexts of known facts and expected sizes; those of regions have no sign. */
  function readNumber(kind) {
    const { contexts } = bits;
    let length = 0;
    while (length < MAX_NUMBER_BITS) {
      const expected = excessBits(length, sizes[0], 4);
      for (let i = 0; i < 4; i++) contexts[i] = excessBits(length, sizes[i], 3);
      contexts[4] = (facts[0] << 6) | length;
      contexts[5] = (facts[1] << 6) | expected;
      contexts[6] = (((facts[2] << 6) | excessBits(length, sizes[2], 4)) << 6) | expected;
      contexts[7] = (excessBits(length, sizes[1], 4) << 6) | expected;
      for (let i = 0; i < 8; i++) contexts[i] = (contexts[i] << 8) | kind;
      if (!bits.next(SEAM_KINDS + kind)) break;
      length++;
    }
    if (!length) return 0;
    const magnitude = 2 ** (length - 1) + bits.rawBits(length - 1);
    return kind < REGION_KIND && bits.rawBits(1) ? -magnitude : magnitude;
  }
}

const damaged = () => new MixseqError("texture coordinates are damaged");

/** The number of bits beyond the expected size, in units of 2^shift 16ths: 1 to 63, 32 for none. */
const excessBits = (length, size, shift) => Math.min(Math.max((16 * length - size + 8) >> shift, -31), 31) + 32;

/** The number of bits of a number, in 16ths, by the four bits after the highest. */
function sizeInBits(number) {
  const length = bitLength(number);
  return 16 * length + (Math.floor((32 * number) / 2 ** length) & 15);
}

/** The bit length of the magnitude of a number of up to 53 bits. */
function bitLength(number) {
  const rest = Math.abs(number), high = Math.floor(rest / 2 ** 32);
  return high ? 64 - Math.clz32(high) : 32 - Math.clz32(rest);
}

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
