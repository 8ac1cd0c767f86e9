// What is on the polygons of a sequence. A module of its own, so that pages that draw none of it can do without.
import { checkOf, refuseOthers, withoutCheck } from "./decoded_check.js";
import { guarded } from "./errors.js";
import { decodeUvs } from "./texture_coordinates.js";

/** Texture coordinates at the corners, u and v of each; null if there are none. */
export function uvsOf(sequence) {
  const { streams, vertexCount, parameters } = sequence;
  if (!streams.uvs) return null;
  return guarded("the texture coordinates", () => {
    const { counts, corners } = sequence.polygons(), { data, expected } = withoutCheck(streams.uvs);
    const numbers = decodeUvs(data, counts, corners, vertexCount);
    refuseOthers(checkOf(numbers), expected);
    return Float32Array.from(numbers, (number) => number / parameters.uvSteps);
  });
}
