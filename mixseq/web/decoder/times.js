// Decode the times of frames, which need not be regular. Mirrors io/mixseq_io/coded/streams.py.
import { MixseqError } from "./errors.js";

/** The times of `count` frames in seconds, from the bytes of their deviations from regular ones; no bytes for regular times. */
export function readTimes(bytes, first, count, fps) {
  if (bytes.length !== 0 && bytes.length !== 8 * count) throw new MixseqError("the number of times is not that of the frames; it is damaged");
  const times = Float64Array.from({ length: count }, (_, frame) => first + frame / fps);
  if (bytes.length) addDifferences(times, bytes);
  if (!times.every((time, k) => Number.isFinite(time) && !(k && time <= times[k - 1]))) {
    throw new MixseqError("the times of frames do not increase; it is damaged");
  }
  return times;
}

/** Add the sums of differences to the bits of times, as 64-bit integers in two halves; the lowest bytes of all are first. */
function addDifferences(times, bytes) {
  const count = times.length, view = new DataView(new ArrayBuffer(8)), wrapped = 2 ** 32;
  const half = (k, byte) => {
    const of = (which) => bytes[(byte + which) * count + k] << (8 * which);
    return (of(0) | of(1) | of(2) | of(3)) >>> 0;
  };
  for (let k = 0, low = 0, high = 0; k < count; k++) {
    low += half(k, 0);
    high = (high + half(k, 4) + Math.floor(low / wrapped)) % wrapped;
    low %= wrapped;
    view.setFloat64(0, times[k], true);
    const sum = view.getUint32(0, true) + low;
    view.setUint32(0, sum, true); // the lowest 32 bits of it
    view.setUint32(4, view.getUint32(4, true) + high + Math.floor(sum / wrapped), true);
    times[k] = view.getFloat64(0, true);
  }
}
