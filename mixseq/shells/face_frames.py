r"""Find the rotations of faces from edge lengths and dihedral angles.

Lengths give the shape of every triangle. Its *frame* is a rotation whose columns are the direction of its side 01, the
in-plane normal of that side and the normal. A hinge's edge is at an angle :math:`\alpha` in it, which follows from
lengths, so that the frames of both faces of a hinge differ by a known rotation (Wang, Liu and Tong 2012)

.. math:: F_j = F_i T_{ij}, \qquad T_{ij} = R_z(\alpha_i)\, R_x(\theta)\, R_z(-\alpha_j) .

Blended lengths and angles are those of no mesh, and no frames satisfy all of these. The best are found by *rotation
averaging* (after Govindu 2004): misfits :math:`F_i T_{ij} F_j^{-1}`, rotations by angles :math:`\varphi` about axes a,
are distributed over the frames by

.. math:: \min_\omega \sum_{ij} w_{ij}\, |\omega_j - \omega_i - a_{ij} \sin \varphi_{ij}|^2 ,

a system with a constant matrix, and frames are rotated by :math:`\exp \omega`, in two or three rounds. The sine keeps
it smooth at half a turn, where a rotation vector would jump.

Averaging starts from expected frames, or from chained ones: from one face on, layer by layer, each frame is the mean of
the predictions of its neighbours in the layer before. That is exact where a mesh has these lengths and angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, Index, IntArray, Mask
from mixseq.pickling import PickledWithoutCaches
from mixseq.shells import face_frame_kernels as kernels
from mixseq.shells.solvers import Factor, factored_laplacian

SHORTEST = 1e-12
"""Least length of sides, in diagonals: side 01 defines the frame of a triangle."""


def flat_triangles(lengths: Float) -> Float:
    """Lay triangles with sides ``(m, 3)`` = 01, 12, 20 into the plane, as corners ``(m, 3, 2)``.

    Triangles of interpolated lengths that break the triangle inequality are laid flat on a line.
    """
    l01, l12, l20 = np.maximum(lengths, SHORTEST).T
    x = np.clip((l01**2 + l20**2 - l12**2) / (2.0 * l01), -l20, l20)
    y = np.sqrt(l20**2 - x**2)
    zero = np.zeros_like(x)
    return np.stack([zero, zero, l01, zero, x, y], axis=1).reshape(-1, 3, 2)


def frames_of(x: Float, faces: IntArray) -> Float:
    """Return the frames ``(m, 4)``, as quaternions, of triangles ``(m, 3)`` with vertices ``(n, 3)``.

    The normal of a triangle without area is any that is perpendicular to its first side.
    """
    return np.asarray(kernels.frames_of(x, faces.astype(np.int64)))


@dataclass(frozen=True, eq=False)
class Hinges:
    """Hinges in the frames of their faces."""

    faces: IntArray  # (m, 3) triangles
    hinges: Index  # (h, 4) hinges a, b, c, d: edge ab, opposite vertices c and d
    hinge_faces: Index  # (h, 2) their faces

    @cached_property
    def _ends(self) -> tuple[Index, Index]:
        """Corners ``(h, 2)`` of both faces where a hinge's edge starts and ends."""
        faces = self.faces[self.hinge_faces]  # (h, 2, 3)
        return tuple((faces == self.hinges[:, None, end : end + 1]).argmax(axis=2) for end in (0, 1))

    @cached_property
    def backward(self) -> Mask:
        """Whether the sides ``(h, 2)`` of both faces run against the hinge's edge."""
        start, end = self._ends
        return np.asarray((start + 1) % 3 != end)

    @cached_property
    def sides(self) -> Index:
        """Side ``(h, 2)`` of the hinge's edge in both faces."""
        return np.where(self.backward, self._ends[1], self._ends[0])

    @cached_property
    def reversed_normals(self) -> Float:
        """Half a turn ``(h,)`` where both faces run along the edge alike: their normals are on opposite sides."""
        return np.where(self.backward[:, 1], 0.0, np.pi)

    def turns(self, flat: Float, angles: Float) -> Float:
        """Return the rotations T ``(h, 4)`` across all hinges: flat ``(m, 3, 2)``; angles ``(h,)``."""
        side = np.roll(flat, -1, axis=1) - flat
        directions = np.arctan2(side[..., 1], side[..., 0])
        seen = directions[self.hinge_faces, self.sides] + np.where(self.backward, np.pi, 0.0)
        return np.asarray(kernels.transitions(seen[:, 0], seen[:, 1], angles + self.reversed_normals))


class _Layers(NamedTuple):
    """Order in which frames are chained, see `face_frame_kernels.chained`."""

    order: Index
    starts: Index
    links: Index


@dataclass(frozen=True, eq=False)
class FrameGraph(PickledWithoutCaches):
    """Frames, and pairs of them with known relative rotations."""

    count: int  # number n of frames
    pairs: Index  # (h, 2) pairs of different frames
    weights: Float  # (h,) positive weights of the pairs
    known: Mask  # (n,) frames from which chains start: at least one per component
    known_weight: float  # weight of known frames in rotation averaging

    @cached_property
    def factor(self) -> Factor:
        """Factor of the matrix of averaging."""
        return factored_laplacian(self.pairs, self.weights, np.where(self.known, self.known_weight, 0.0))

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.factor, self._layers

    def averaged(self, frames: Float, turns: Float, rounds: int) -> Float:
        """Return averaged frames ``(n, 4)`` with smaller misfits to rotations ``(h, 4)``."""
        frames, right = frames.copy(), np.empty((self.count, 3))
        for _ in range(rounds):
            kernels.misfits(frames, self.pairs, turns, self.weights, right)
            kernels.turned_on(frames, self.factor.solve(right))
        return frames

    def chained(self, turns: Float, known: Float) -> Float:
        """Return frames ``(n, 4)`` chained from known quaternions ``(r, 4)``."""
        frames = np.zeros((self.count, 4))
        frames[:, 0] = 1.0
        frames[self.known] = known
        kernels.chained(self.pairs, turns, self.weights, *self._layers, frames)
        return frames

    @cached_property
    def _layers(self) -> _Layers:
        """Breadth-first layers from the known frames; links lead to the layer before."""
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
    """Return the connected component ``(count,)`` of each of ``count`` nodes, by pairs ``(h, 2)``."""
    places = pairs[:, 0], pairs[:, 1]
    graph = sparse.coo_array((np.ones(len(pairs)), places), shape=(count, count))
    return csgraph.connected_components(graph, directed=False)[1].astype(np.int64)


def bridging(count: int, pairs: Index, sound: Mask) -> Mask:
    """Mark the sound pairs ``(h, 2)`` of ``count`` nodes, and a forest of others that connects what those do not."""
    ends = np.sort(connected(count, pairs[sound])[pairs], axis=1)
    apart = np.flatnonzero(ends[:, 0] != ends[:, 1])
    several, first = np.unique(ends[apart], axis=0, return_index=True)
    graph = sparse.coo_array((1.0 + apart[first], tuple(several.T)), shape=(count, count)).tocsr()
    marks = sound.copy()
    marks[csgraph.minimum_spanning_tree(graph).data.astype(np.int64) - 1] = True
    return marks
