// The CRC-32 of zlib, of bytes and of whole numbers of 64 bits.

/** Eight tables: a byte, and a byte with 1 to 7 zeros behind it. */
const TABLES = tables();

function tables() {
  const found = Array.from({ length: 8 }, () => new Uint32Array(256));
  for (let byte = 0; byte < 256; byte++) {
    let code = byte;
    for (let bit = 0; bit < 8; bit++) code = code & 1 ? (code >>> 1) ^ 0xedb88320 : code >>> 1;
    found[0][byte] = code;
  }
  for (let zeros = 1; zeros < 8; zeros++) {
    for (let byte = 0; byte < 256; byte++) {
      const before = found[zeros - 1][byte];
      found[zeros][byte] = found[0][before & 255] ^ (before >>> 8);
    }
  }
  return found;
}

/** The CRC-32 of bytes, continued from the CRC-32 `before`. */
export function crc32(bytes, before = 0) {
  const table = TABLES[0];
  let code = ~before;
  for (let k = 0; k < bytes.length; k++) code = table[(code ^ bytes[k]) & 255] ^ (code >>> 8);
  return ~code >>> 0;
}

/** The same of whole numbers below 2^53, each as an int64 with its lowest byte first. */
export function crc32OfNumbers(numbers, before = 0) {
  const [a, b, c, d, e, f, g, h] = TABLES;
  let code = ~before;
  for (let k = 0; k < numbers.length; k++) {
    const number = numbers[k], low = code ^ number, high = Math.floor(number / 4294967296) | 0;
    code = h[low & 255] ^ g[(low >>> 8) & 255] ^ f[(low >>> 16) & 255] ^ e[low >>> 24] ^
      d[high & 255] ^ c[(high >>> 8) & 255] ^ b[(high >>> 16) & 255] ^ a[high >>> 24];
  }
  return ~code >>> 0;
}
