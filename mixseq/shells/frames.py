r"""Frames of faces from lengths and angles: every triangle, or rigid part, finds out how it is turned.

Lengths tell the shape of every triangle, an angle how two of them stand to each other: their frames differ by a known
rotation, :math:`F_j = F_i T_{ij}` (`mixseq.shells.triangles`). Of lengths and angles between poses no frames satisfy
all of these. Those that do best are found by *averaging rotations* (after Govindu 2004): misfits
:math:`F_i T_{ij} F_j^{-1}`, rotations by angles :math:`\varphi` about axes a, are divided among the frames by

.. math:: \min_\omega \sum_{ij} w_{ij}\, |\omega_j - \omega_i - a_{ij} \sin \varphi_{ij}|^2 ,

a system with a constant matrix, and frames are turned on by :math:`\exp \omega`. Two or three rounds do. The sine is
ours, and makes it smooth: half a turn has no side, and a rotation vector would jump from one to the other.

It starts from frames that are expected, or from frames that are chained, from one face on, layer by layer: each is the
mean of what all its neighbours in the layer before say of it. Where there is a mesh with these lengths and angles, that
is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, Index, Mask
from mixseq.pickling import PickledWithoutCaches
from mixseq.shells import rotation_kernels as kernels
from mixseq.shells.solvers import Factor, factored_laplacian


class _Layers(NamedTuple):
    """In which order frames are chained, see `rotation_kernels.chained`."""

    order: Index
    starts: Index
    links: Index


@dataclass(frozen=True, eq=False)
class FrameGraph(PickledWithoutCaches):
    """Frames, and which of them know how they are turned against each other.

    Attributes
    ----------
    count : int
        Number n of frames.
    pairs : (h, 2) int64
        Pairs of different frames.
    weights : (h,) float64
        How much the pairs count; positive.
    known : (n,) bool
        Frames that chains start from: one, at least, of all that are connected.
    hold : float
        How much known frames stay what they are while rotations are averaged.
    """

    count: int
    pairs: Index
    weights: Float
    known: Mask
    hold: float

    @cached_property
    def factor(self) -> Factor:
        """Factor of the matrix of all averages."""
        return factored_laplacian(self.pairs, self.weights, np.where(self.known, self.hold, 0.0))

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.factor, self._layers

    def averaged(self, frames: Float, turns: Float, rounds: int) -> Float:
        """Return frames that fit each other better.

        Parameters
        ----------
        frames : (n, 4) float64
            Unit quaternions to start from.
        turns : (h, 4) float64
            Rotations from the first frame of a pair to the second, as seen from the first.
        rounds : int
            How often what does not fit is divided.
        """
        frames, right = frames.copy(), np.empty((self.count, 3))
        for _ in range(rounds):
            kernels.misfits(frames, self.pairs, turns, self.weights, right)
            kernels.turned_on(frames, self.factor.solve(right))
        return frames

    def chained(self, turns: Float, known: Float) -> Float:
        """Return frames ``(n, 4)`` that go on from those that are known, quaternions ``(r, 4)``."""
        frames = np.zeros((self.count, 4))
        frames[:, 0] = 1.0
        frames[self.known] = known
        kernels.chained(self.pairs, turns, self.weights, *self._layers, frames)
        return frames

    @cached_property
    def _layers(self) -> _Layers:
        """Breadth first from the known frames; links lead to the layer before."""
        depth = np.where(self.known, 0, -1)
        source, target = np.concatenate([self.pairs, self.pairs[:, ::-1]]).T
        number = np.arange(len(self.pairs))
        link = np.concatenate([number, -1 - number])
        for layer in range(self.count):
            reached = target[(depth[source] == layer) & (depth[target] < 0)]
            if not reached.size:
                break
            depth[reached] = layer + 1
        used = np.flatnonzero(depth[source] == depth[target] - 1)
        used = used[np.lexsort((number[used % len(number)], target[used], depth[target[used]]))]
        order = np.flatnonzero(depth > 0)
        order = order[np.argsort(depth[order], kind="stable")]
        counts = np.bincount(target[used], minlength=self.count)[order]
        return _Layers(order, np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), link[used])


def connected(count: int, pairs: Index) -> Index:
    """Return with which others each of ``count`` is connected by pairs ``(h, 2)``: numbers ``(count,)``."""
    places = pairs[:, 0], pairs[:, 1]
    graph = sparse.coo_array((np.ones(len(pairs)), places), shape=(count, count))
    return csgraph.connected_components(graph, directed=False)[1].astype(np.int64)


def bridging(count: int, pairs: Index, sound: Mask) -> Mask:
    """Mark the sound pairs ``(h, 2)`` of ``count``, and of the others those that connect what the sound ones do not."""
    component = connected(count, pairs[sound])
    return np.asarray(sound | (component[pairs[:, 0]] != component[pairs[:, 1]]))
