"""Frames of a sequence as key shapes: their choice, and their weights in pose space."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from mixseq.arrays import Float, Index
from mixseq.signals.pose import PoseMap


def choose_keys(scores: Float) -> Index:
    """Choose frames ``(r + 1,)`` as key shapes for points of pose space ``(T, r)``."""
    size = np.abs(scores).max(initial=0.0) or 1.0
    corners = np.concatenate([np.full((1, len(scores)), size), scores.T])
    pivots = linalg.qr(corners, mode="r", pivoting=True)[1]
    return np.sort(pivots[: scores.shape[1] + 1]).astype(np.int64)


def key_map(keys: Float) -> PoseMap:
    """Make the pose map of key shapes at points of pose space ``(K, r)``."""
    corners = np.concatenate(
        [np.ones((1, len(keys))), keys.T]
    )  # weights w of a point c: corners @ w = (1, c)
    inverse = np.linalg.pinv(corners)
    offset, matrix = inverse[:, 0], inverse[:, 1:].T
    # Rounding, and points that the keys do not span, must not make the sums drift.
    return PoseMap(offset + (1 - offset.sum()) / len(keys), matrix - matrix.mean(axis=1, keepdims=True))
