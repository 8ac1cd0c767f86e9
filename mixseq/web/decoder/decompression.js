// Decompression by the browser. It is asynchronous, so it is done once, when a sequence is opened.
import { MixseqError } from "./errors.js";

/** Decompress up to `most` bytes of zlib data; empty data stays empty. `what` names it in messages. */
export async function decompressed(data, most, what) {
  if (!data.length) return data;
  const reader = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate")).getReader(), parts = [];
  const next = () => reader.read().catch((error) => {
    throw new MixseqError(`${what} are damaged (${error.message})`);
  });
  let size = 0;
  for (let part = await next(); !part.done; part = await next()) {
    size += part.value.length;
    if (size > most) {
      reader.cancel();
      throw new MixseqError(`${what} take more than the allowed ${most} bytes`);
    }
    parts.push(part.value);
  }
  return new Uint8Array(await new Blob(parts).arrayBuffer());
}
