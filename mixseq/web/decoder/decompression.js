// Decompression by the browser, which is asynchronous: it is done once, when a sequence is opened.
import { MixseqError } from "./errors.js";

/** Undo zlib, up to `most` bytes; no bytes stay none. `what` names them in messages. */
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
      throw new MixseqError(`${what} take more than the ${most} bytes that they may`);
    }
    parts.push(part.value);
  }
  return new Uint8Array(await new Blob(parts).arrayBuffer());
}
