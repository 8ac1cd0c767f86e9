// Attributes of the polygons of a sequence. Pages that draw none of them can leave this module out.
import { decodeHardEdges, decodeUvs } from "./corner_values.js";
import { MixseqError, guarded } from "./errors.js";

const TYPES = { "<i4": Int32Array, "<f4": Float32Array, "|u1": Uint8Array };

/** Texture coordinates at the corners, u and v of each; null if there are none. */
export function uvsOf(sequence) {
  const { streams, vertexCount, parameters, cornerCount } = sequence;
  return guarded("the texture coordinates", () => {
    if (!streams.uvs) {
      const { uv_values: values, uv_indices: rows } = surfaceOf(sequence);
      return values ? selectRows(values, checkCornerNumbers(rows, cornerCount, values.length / 2), 2) : null;
    }
    const { counts, corners } = sequence.polygons(), numbers = decodeUvs(streams.uvs, counts, corners, vertexCount);
    return Float32Array.from(numbers, (number) => number / parameters.uvSteps);
  });
}

/** Colours at the corners, red, green, blue and alpha of each, from 0 to 1; null if there are none. */
export function coloursOf(sequence) {
  return guarded("the colours", () => {
    const { colour_values: values, colour_indices: rows = sequence.polygons().corners } = surfaceOf(sequence);
    if (!values) return null;
    const colours = selectRows(values, checkCornerNumbers(rows, sequence.cornerCount, values.length / 4), 4);
    return values instanceof Uint8Array ? colours.map((byte) => byte / 255) : colours;
  });
}

/** Numbers of normals at the corners; null if all corners of a vertex share one. */
export function hardEdgesOf(sequence) {
  return guarded("the hard edges", () => {
    const { hard_edges: coded, creases } = surfaceOf(sequence);
    if (!coded) return creases ? checkCornerNumbers(creases, sequence.cornerCount, Infinity) : null;
    const { counts, corners } = sequence.polygons();
    return decodeHardEdges(coded, counts, corners, sequence.vertexCount);
  });
}

/** The arrays of a surface by name, of numbers and of texts, as io/mixseq_io/coded/streams.py packs them. */
export function surfaceOf({ surface }) {
  if (!surface.length) return {};
  return guarded("the surface", () => {
    const end = surface.indexOf(0), arrays = {};
    let start = end + 1;
    for (const [name, ...description] of JSON.parse(new TextDecoder().decode(surface.subarray(0, end)))) {
      if (description.length === 1) arrays[name] = description[0];
      else {
        const [type, shape] = description, count = shape.reduce((size, each) => size * each, 1);
        arrays[name] = unshuffleBytes(surface, start, TYPES[type], count);
        start += arrays[name].byteLength;
      }
    }
    return arrays;
  });
}

/** The values at corners: rows of some width, selected by number. */
function selectRows(values, rows, width) {
  return Float32Array.from({ length: width * rows.length }, (_, k) => values[width * rows[Math.floor(k / width)] + (k % width)]);
}

/** Verify that there is a number for every corner, from 0 to below a size. */
function checkCornerNumbers(numbers, cornerCount, size) {
  if (numbers.length !== cornerCount || numbers.some((number) => number < 0 || number >= size)) throw new MixseqError("there are numbers out of range; it is damaged");
  return numbers;
}

/** Numbers whose first bytes are stored first, then their second bytes, and so on; integers as first differences. */
function unshuffleBytes(whole, start, Type, count) {
  const size = Type.BYTES_PER_ELEMENT;
  if (!(start + size * count <= whole.length)) throw new MixseqError("it ends early; it is damaged");
  const bytes = new Uint8Array(size * count), numbers = new Type(bytes.buffer);
  for (let k = 0; k < bytes.length; k++) bytes[(k % count) * size + Math.floor(k / count)] = whole[start + k];
  if (Type === Int32Array) for (let k = 1; k < count; k++) numbers[k] += numbers[k - 1];
  return numbers;
}
