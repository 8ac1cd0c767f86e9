// Streams end with the CRC-32 of the numbers that they decode to. Mirrors mixseq/compression/bitstream/arithmetic.py.
import { crc32OfNumbers } from "./crc32.js";
import { MixseqError } from "./errors.js";

const CHECKSUM_SIZE = 4; // bytes

/** The CRC-32 of integers, 8 bytes each, continued from the CRC-32 `before`. */
export const checksumOf = crc32OfNumbers;

/** Split a stream into its data and the CRC-32 of the decoded numbers. */
export function splitChecksum(bytes) {
  const end = Math.max(bytes.length - CHECKSUM_SIZE, 0);
  let expected = 0;
  for (let k = bytes.length - 1; k >= end; k--) expected = ((expected << 8) | bytes[k]) >>> 0;
  return { data: bytes.subarray(0, end), expected };
}

/** Verify that the decoded numbers are those that were coded. */
export function verifyChecksum(found, expected) {
  if (found !== expected) throw new MixseqError("the decoded numbers differ from the coded ones; it is damaged");
}
