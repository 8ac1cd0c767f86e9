// The times of frames, which need not be regular. Mirrors io/mixseq_io/coded/lossless.py.
import { MixseqError } from "./errors.js";
import { inflated } from "./inflate.js";

/** The times of so many frames, in seconds. */
export function unpackTimes(packed, first, count, fps) {
  const times = Float64Array.from({ length: count }, (_, frame) => first + frame / fps);
  if (packed.length) addDifferences(new DataView(times.buffer), inflated(packed, 8 * count), count);
  if (!times.every((time, k) => Number.isFinite(time) && !(k && time <= times[k - 1]))) {
    throw new MixseqError("the times of frames do not increase; it is damaged");
  }
  return times;
}

/** Add sums of differences of 64 bits, their lowest bytes first, to numbers, in two halves. */
function addDifferences(view, planes, count) {
  const part = (k, byte) => planes[byte * count + k] | (planes[(byte + 1) * count + k] << 8) | (planes[(byte + 2) * count + k] << 16) | (planes[(byte + 3) * count + k] << 24);
  const little = new Uint8Array(Uint32Array.of(1).buffer)[0] === 1;
  let low = 0, high = 0;
  for (let k = 0; k < count; k++) {
    low += part(k, 0) >>> 0;
    high = (high + part(k, 4) + (low > 0xffffffff ? 1 : 0)) | 0;
    low >>>= 0;
    const sum = view.getUint32(8 * k + (little ? 0 : 4), little) + low;
    const carry = sum > 0xffffffff ? 1 : 0;
    view.setUint32(8 * k + (little ? 0 : 4), sum, little);
    view.setInt32(8 * k + (little ? 4 : 0), (view.getInt32(8 * k + (little ? 4 : 0), little) + high + carry) | 0, little);
  }
}
