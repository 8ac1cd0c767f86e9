// The error of the decoder, for damaged or unsupported data. Mirrors mixseq/errors.py.

export class MixseqError extends Error {
  constructor(message) {
    super(message);
    this.name = "MixseqError";
  }
}

/** Return the result of some work; raise all its errors as `MixseqError`, with `what` was decoded. */
export function guarded(what, work) {
  try {
    return work();
  } catch (error) {
    const reason = error instanceof MixseqError ? error.message : `${error.message}; it is damaged, or takes too much memory`;
    throw new MixseqError(`${what}: ${reason}`);
  }
}
