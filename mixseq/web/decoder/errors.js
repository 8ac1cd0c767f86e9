// The one error of the decoder: what was given is damaged, or of another kind. Mirrors mixseq/errors.py.

export class MixseqError extends Error {
  constructor(message) {
    super(message);
    this.name = "MixseqError";
  }
}

/** What work returns; whatever is wrong there ends in one error that tells where. */
export function guarded(what, work) {
  try {
    return work();
  } catch (error) {
    const reason = error instanceof MixseqError ? error.message : `${error.message}; it is damaged, or takes too much memory`;
    throw new MixseqError(`${what}: ${reason}`);
  }
}
