r"""The pose signal: from a point of pose space to the affine weights of key shapes.

.. math:: \varphi(c) = \varphi_0 + c\,\Phi, \qquad \sum_j \varphi_j(c) = 1 \text{ for every } c

Every point of pose space is a shape, :math:`\sum_j \varphi_j(c)\,P_j`. Pose space has the coordinates of a principal
component analysis of the sequence: distances in it are distances between shapes, its first two coordinates draw the
sequence in the plane. There are two equivalent forms:

modes
    the first key shape is the mean, every other one is the mean plus one standard deviation along a mode;
keys
    key shapes are frames of the sequence, so an artist can look at them and exchange them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.polygons import frozen


@dataclass(frozen=True, eq=False)
class PoseMap:
    """An affine map from pose space to weights of key shapes.

    Attributes
    ----------
    offset : (K,) float64
        Weights at the origin; they add up to one.
    matrix : (k, K) float64
        Change of the weights along every coordinate; rows add up to zero.

    Raises
    ------
    SettingsError
        If sums or shapes are wrong.
    """

    offset: Float
    matrix: Float

    def __post_init__(self) -> None:
        offset = np.asarray(self.offset, dtype=np.float64)
        matrix = np.asarray(self.matrix, dtype=np.float64, order="C")  # products round by the order
        if offset.ndim != 1 or matrix.ndim != 2 or matrix.shape[1] != len(offset) or not len(offset):
            raise SettingsError(f"a pose map of {offset.shape} weights has a matrix of shape {matrix.shape}")
        slack = 1e-9 * np.maximum(1.0, np.abs(matrix).max(axis=1, initial=0.0))
        if abs(offset.sum() - 1) > 1e-9 or (np.abs(matrix.sum(axis=1)) > slack).any():
            raise SettingsError("the weights of key shapes do not add up to one everywhere in pose space")
        object.__setattr__(self, "offset", frozen(offset))
        object.__setattr__(self, "matrix", frozen(matrix))

    @cached_property
    def identity(self) -> str:
        """Identifier of the pose space: key shapes of models with the same one can be exchanged."""
        digest = blake2b(digest_size=16)
        for array in (self.offset, self.matrix):
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    @property
    def dim(self) -> int:
        """Dimension k of pose space."""
        return int(self.matrix.shape[0])

    def weights(self, coordinates: Float) -> Float:
        """Return the weights ``(N, K)`` of the key shapes at points ``(N, k)``."""
        return self.offset + self.rates(coordinates)

    def rates(self, velocities: Float) -> Float:
        """Return the rates ``(N, K)`` of the weights at velocities ``(N, k)`` of points."""
        # Row by row: products of many rows are summed in another order than those of one.
        rates = np.empty((len(velocities), len(self.offset)))
        for row, velocity in zip(rates, velocities, strict=True):
            row[:] = velocity @ self.matrix
        return rates

    @classmethod
    def of_weights(cls, count: int) -> PoseMap:
        """Make the map whose coordinates are the weights of all key shapes but the first."""
        return cls(np.eye(count)[0], np.eye(count)[1:] - np.eye(count)[0])


def straight_modes(scores: Float, mean: Float, directions: Float) -> tuple[PoseMap, Float]:
    """Make the pose signal and key shapes ``(1 + r, D)`` of ``mean + scores @ directions``: scores ``(T, r)``."""
    sizes = np.sqrt(np.square(scores).mean(axis=0))
    sizes = np.where(sizes > 0, sizes, 1.0)
    steps = np.diag(1 / sizes)
    pose = PoseMap(np.eye(len(sizes) + 1)[0], np.hstack([-steps.sum(axis=1, keepdims=True), steps]))
    return pose, np.concatenate([mean[None], mean + sizes[:, None] * directions])
