// A compressed sequence: what it is, and its frames at any time.
import { MixseqError as Failure } from "./errors.js";

export class MixseqError extends Failure {}

/** Open a sequence: `text` is the attribute `coding` of a compressed model, `streams` are the bytes of its dataset. */
export function open(text, streams) {
  throw new MixseqError(`not yet: ${text.length} characters, ${streams.length} bytes`);
}
