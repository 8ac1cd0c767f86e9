// Streams end with the CRC-32 of the numbers that they decode to. Mirrors coding/bitstream/decoded_check.py.
import { crc32OfNumbers } from "./crc32.js";
import { MixseqError } from "./errors.js";

const SIZE = 4; // bytes

/** The CRC-32 of whole numbers, 8 bytes each, after others with the CRC-32 `before`. */
export const checkOf = crc32OfNumbers;

/** A stream, and what it has to decode to. */
export function withoutCheck(bytes) {
  const end = Math.max(bytes.length - SIZE, 0);
  let expected = 0;
  for (let k = bytes.length - 1; k >= end; k--) expected = ((expected << 8) | bytes[k]) >>> 0;
  return { data: bytes.subarray(0, end), expected };
}

/** Make sure that numbers are those that were coded. */
export function refuseOthers(found, expected) {
  if (found !== expected) throw new MixseqError("coded numbers come out otherwise than they went in; it is damaged");
}
