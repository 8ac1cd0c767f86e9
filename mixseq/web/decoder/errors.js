// The one error of the decoder: what was given is damaged, or of another kind. Mirrors mixseq/errors.py.

export class MixseqError extends Error {
  constructor(message) {
    super(message);
    this.name = "MixseqError";
  }
}
