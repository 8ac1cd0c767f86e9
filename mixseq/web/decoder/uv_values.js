// The values of texture coordinates: how far they are from what is guessed, as mixseq/compression/bitstream/uv_values.py decodes them.
import { MixseqError } from "./errors.js";
import { copy, dropAnchor, fits, follow, giveImage, noCopies } from "./uv_copies.js";
import { AROUND, BESIDE, COPIED, makeGuess, noGuess } from "./uv_guesses.js";
import { SEAM_KINDS } from "./uv_seams.js";

const GROUPS = 4, LONGEST = 40, LARGEST = 1 << 26, TOLERATED = 8, BACK = 2 * GROUPS, PLACE = 2 * GROUPS + 1;

/** Kinds of bits with weights of their own, after those of seams. */
export const VALUE_KINDS = 2 * GROUPS + 2;

/** The values `Int32Array(2N)` of all nodes. */
export function walkValues(bits, corners, order, count) {
  const { starts, polygon: polygons, node, after } = corners, copies = noCopies(corners, order), guess = noGuess();
  const known = { values: new Int32Array(2 * count), there: new Uint8Array(count), sizes: new Float64Array(count) };
  const { values, there } = known, about = [0, 0, 0], sizes = [0, 0, 0, 0], means = [64, 64, 160, 160], lost = [0, 0];
  let last = -1;
  for (const polygon of order) {
    const first = starts[polygon], stop = starts[polygon + 1];
    let unknown = 0, corner = -1, astray = false;
    for (let each = first; each < stop; each++) {
      if (!there[node[each]]) unknown++;
      else if (corner < 0 && !there[node[after[each]]]) corner = each;
    }
    if (!follow(corners, copies, polygon) && unknown) {
      about.fill(unknown === stop - first ? 1 : 0);
      sizes.fill(0);
      begin(polygon);
    }
    const begun = copies.region[polygon] === copies.places[polygon];
    corner = Math.max(first, corner);
    for (let k = first; k < stop; k++) {
      if (!there[node[corner]]) astray = readNode(corner, node[corner]) || astray;
      if (begun) dropAnchor(corners, copies, known, corner);
      corner = after[corner];
    }
    if (astray) copies.region[polygon] = -1;
    else if (copies.region[polygon] >= 0) for (let each = first; each < stop; each++) dropAnchor(corners, copies, known, each);
  }
  return values;

  /** Read the coordinates of a node; return whether a copy was off by more than the other guess. */
  function readNode(corner, x) {
    makeGuess(corners, known, corner, last, guess);
    const { at, back } = guess, seen = [...at], anchors = copy(corners, copies, known, corner, guess);
    let kind = guess.kind;
    if (anchors) kind = anchors === 2 ? COPIED : BESIDE;
    else if (kind === AROUND && lost[1] < lost[0]) back.forEach((each, i) => (at[i] -= each));
    const group = kind === COPIED ? 1 : kind >= BESIDE ? kind - 1 : 0;
    expect(corner, kind, means[group]);
    for (let i = 0; i < 2; i++) {
      const missed = readNumber(2 * group + i), value = at[i] + missed, length = 16 * bitLength(missed);
      if (Math.abs(value) > LARGEST) throw damaged();
      values[2 * x + i] = value;
      known.sizes[x] += Math.abs(missed);
      means[group] += (length - means[group]) >> 4;
      about[2] = sizes[3] = length;
    }
    const apart = (drawn) => Math.abs(values[2 * x] - seen[0] + drawn * back[0]) + Math.abs(values[2 * x + 1] - seen[1] + drawn * back[1]);
    if (guess.kind === AROUND) for (let drawn = 0; drawn < 2; drawn++) lost[drawn] += sizeOf(apart(drawn)) - (lost[drawn] >> 5);
    there[x] = 1;
    last = x;
    return anchors === 2 && known.sizes[x] > TOLERATED && known.sizes[x] > apart(0);
  }

  /** Read whether a region begins with a polygon, and its image. */
  function begin(polygon) {
    const place = copies.places[polygon], back = readNumber(BACK);
    if (!back) return;
    if (back > place) throw damaged();
    const other = order[place - back], turn = readNumber(PLACE), image = starts[other] + Math.floor(turn / 2);
    if (image >= starts[other + 1] || !fits(corners, copies, polygon, other)) throw damaged();
    giveImage(corners, copies, starts[polygon], image, turn % 2, place);
  }

  /** Note what a guess is made of, and which sizes of misses can be expected. */
  function expect(corner, kind, mean) {
    const a = node[corners.before[corner]], b = node[after[corner]], near = (known.sizes[a] + known.sizes[b]) * (there[a] !== there[b] ? 2 : 1);
    const edge = there[a] && there[b] ? Math.abs(values[2 * a] - values[2 * b]) + Math.abs(values[2 * a + 1] - values[2 * b + 1]) : 0;
    about[0] = about[1] = (kind << 2) | Math.min(guess.count, 3);
    about[2] = kind;
    [mean, sizeOf(near), sizeOf(edge), sizeOf(guess.spread)].forEach((size, i) => (sizes[i] = size));
  }

  /** Read a number, in contexts of known facts and expected sizes; those of regions have no sign. */
  function readNumber(what) {
    const { contexts } = bits;
    let length = 0;
    while (length < LONGEST) {
      const expected = beyond(length, sizes[0], 4);
      for (let i = 0; i < 4; i++) contexts[i] = beyond(length, sizes[i], 3);
      contexts[4] = (about[0] << 6) | length;
      contexts[5] = (about[1] << 6) | expected;
      contexts[6] = (((about[2] << 6) | beyond(length, sizes[2], 4)) << 6) | expected;
      contexts[7] = (beyond(length, sizes[1], 4) << 6) | expected;
      for (let i = 0; i < 8; i++) contexts[i] = (contexts[i] << 8) | what;
      if (!bits.next(SEAM_KINDS + what)) break;
      length++;
    }
    if (!length) return 0;
    const value = 2 ** (length - 1) + bits.plain(length - 1);
    return what < BACK && bits.plain(1) ? -value : value;
  }
}

const damaged = () => new MixseqError("texture coordinates are damaged");

/** How many bits there are beyond the expected size, in units of 2^shift 16ths: 1 to 63, 32 for none. */
const beyond = (length, size, shift) => Math.min(Math.max((16 * length - size + 8) >> shift, -31), 31) + 32;

/** The number of bits of a number, in 16ths: the four bits after the highest count, too. */
function sizeOf(number) {
  const length = bitLength(number);
  return 16 * length + (Math.floor((32 * number) / 2 ** length) & 15);
}

/** How many bits the magnitude of a number has, of one that may have more than 32. */
function bitLength(number) {
  const rest = Math.abs(number), high = Math.floor(rest / 2 ** 32);
  return high ? 64 - Math.clz32(high) : 32 - Math.clz32(rest);
}
