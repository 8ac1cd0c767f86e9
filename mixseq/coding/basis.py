r"""Fields and tracks of a compressed sequence, as a decoder has them, and what they are together.

With fields :math:`\hat b_k` and tracks :math:`\hat u_k` a frame is

.. math:: x_t(v) = \sum_k \hat u_k(t)\, \hat b_k(v)

with :math:`\hat b_0 = 1/\sqrt V` of trajectories, for every part, and :math:`\hat u_0 = 1/\sqrt T` of shapes, which
are known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from mixseq.arrays import Float, Index
from mixseq.coding.coded import FactorName
from mixseq.frame_store import FrameStore, block_size, blocks_of


@dataclass(frozen=True, eq=False)
class Basis:
    """Decoded fields.

    Attributes
    ----------
    name : {"trajectories", "shapes"}
        Which factors.
    fields : (K, c, V) float64
        Fields in the units of the sequence: c = 1 of trajectories, the first of which are constant, one for every
        part; c = 3 of shapes.
    frame_count : int
        Number T of frames.
    parts : (K,) int64
        Part of the mesh that a field belongs to; it is zero elsewhere.
    """

    name: FactorName
    fields: Float
    frame_count: int
    parts: Index

    @property
    def norms(self) -> Float:
        """Norms ``(K,)`` of the fields."""
        norms: Float = np.sqrt(np.square(self.fields).sum(axis=(1, 2)))
        return norms

    @property
    def free(self) -> slice:
        """Fields whose tracks are coded: all but the mean shape."""
        return slice(0 if self.name == "trajectories" else 1, None)

    def fit(self, sequence: FrameStore) -> Float:
        """Return the tracks ``(T, K, 3 / c)`` of the free fields that are nearest to a sequence, least squares."""
        scales = self.norms[self.free]
        scaled = self.fields[self.free] / scales[:, None, None]
        count = len(scaled)
        if not count:  # a mean shape, and nothing that moves
            return np.zeros((len(sequence.points), 0, 1))
        flat = scaled.reshape(count, -1)
        # Fields are nearly orthogonal; a trace of damping is for those that are the same, after rounding.
        gram = flat @ flat.T
        factor = linalg.cho_factor(gram + 1e-9 * np.eye(count))
        tracks = []
        for block in blocks_of(sequence.points):
            points = block.astype(np.float64)
            if self.name == "trajectories":
                right = np.einsum("kv,tvi->kti", flat, points, optimize=True)
            else:
                points = points - self._mean
                right = np.einsum("kiv,tvi->kt", scaled, points, optimize=True)[..., None]
            right = right.reshape(count, -1)
            solved = linalg.cho_solve(factor, right)
            solved += linalg.cho_solve(factor, right - gram @ solved)  # takes back what the damping took
            tracks.append(solved.reshape(count, len(points), -1).transpose(1, 0, 2))
        return np.concatenate(tracks) / scales[:, None]

    def frames(self, tracks: Float) -> Float:
        """Return the frames ``(T, V, 3)`` of tracks ``(T, K, 3 / c)`` of the free fields."""
        if self.name == "trajectories":
            return np.asarray(np.einsum("kv,tki->tvi", self.fields[:, 0], tracks, optimize=True))
        return np.asarray(
            self._mean + np.einsum("kiv,tk->tvi", self.fields[1:], tracks[..., 0], optimize=True)
        )

    def blocks(self, tracks: Float) -> Iterator[Float]:
        """Yield the frames of tracks in blocks of those of `mixseq.frame_store.blocks_of`."""
        size = block_size(self.fields.shape[2])
        for start in range(0, len(tracks), size):
            yield self.frames(tracks[start : start + size])

    @property
    def _mean(self) -> Float:
        mean: Float = self.fields[0].T / np.sqrt(self.frame_count)
        return mean
