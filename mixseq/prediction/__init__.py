"""Interpolation in time: weights of frames, and poses of parts that agree with their neighbours."""
