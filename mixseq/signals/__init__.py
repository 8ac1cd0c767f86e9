"""A sequence as time, pose and shape signals in a shape space: fit, model, sample."""
