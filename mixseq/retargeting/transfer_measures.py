r"""Measure frames of a transfer: stretches and normals against those expected from the source, and accelerations.

With the gradients J of the source's triangles and the rotation G between the two meshes a side s of a target triangle
should become :math:`s' = G J G^T s`, as in `mixseq.retargeting.gradient_transfer`. So its length should be
:math:`|s'| / |s|` times that at rest, and the triangle should face along :math:`s'_1 \times s'_2`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index, Mask
from mixseq.geometry.lengths_angles import edge_lengths, flat_faces
from mixseq.retargeting.gradient_transfer import GradientTransfer, gradient_transfer
from mixseq.retargeting.transfer import Transfer
from mixseq.topology import Topology

FLAT = 1e-3
"""Ratio of height to longest side below which a triangle is flat."""


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected stretches and normals of the target's triangles."""

    gradients: GradientTransfer  # the two meshes at rest, and their correspondence
    rest: Float  # (V', 3) target at rest, in its own units
    source_rest: Float  # (V, 3) source at rest, in its own units

    @classmethod
    def of(cls, transfer: Transfer) -> Expected:
        """Make it for the two meshes of a transfer by any method."""
        topology = Topology(transfer.header.faces, transfer.header.vertex_count)
        source = transfer.source
        made = gradient_transfer(
            source.topology, source.rest, topology, transfer.target, transfer.correspondence
        )
        return cls(made, transfer.target, source.rest)

    @property
    def topology(self) -> Topology:
        """Connectivity of the target."""
        return self.gradients.target.topology

    @property
    def source(self) -> Topology:
        """Connectivity of the source."""
        return self.gradients.source.topology

    @cached_property
    def matched(self) -> Index:
        """Target triangles ``(n,)`` with a source triangle."""
        return np.flatnonzero(self.gradients.correspondence.faces >= 0)

    @cached_property
    def flat(self) -> Mask:
        """Target triangles ``(F',)`` that are flat at rest."""
        return flat_faces(self.rest, self.topology.faces, FLAT)

    @cached_property
    def _sides(self) -> Float:
        """Sides 01, 12, 20 ``(n, 3, 3)`` of the matched triangles at rest, in rows."""
        return _sides_of(self.rest, self.topology.faces[self.matched])

    @cached_property
    def _lengths(self) -> Float:
        """Lengths ``(E',)`` of the target's edges at rest, NaN for none."""
        return _or_nan(edge_lengths(self.rest, self.topology.edges))

    @cached_property
    def _source_lengths(self) -> Float:
        return _or_nan(edge_lengths(self.source_rest, self.source.edges))

    def sides(self, x: Float) -> Float:
        """Return the expected sides ``(n, 3, 3)`` of matched triangles in a frame ``(V, 3)``."""
        faces = self.gradients.correspondence.faces[self.matched]
        moving = self.gradients.alignment.turned(self.gradients.gradients(x)[faces])
        return np.asarray(self._sides @ np.swapaxes(moving, 1, 2))

    def stretches(self, sides: Float) -> Float:
        """Return the expected stretches ``(E',)`` of the target's edges; 1 without a counterpart."""
        with np.errstate(divide="ignore", invalid="ignore"):
            stretches = np.linalg.norm(sides, axis=2) / np.linalg.norm(self._sides, axis=2)
        of_side = np.ones((len(self.topology.faces), 3))
        of_side[self.matched] = stretches
        edges = self.topology.face_edges.reshape(-1)
        count = len(self.topology.edges)
        return np.asarray(
            np.bincount(edges, of_side.reshape(-1), count) / np.bincount(edges, minlength=count)
        )

    def own_stretches(self, y: Float) -> Float:
        """Return the stretches ``(E',)`` of the target's edges in a frame ``(V', 3)``; NaN without a rest length."""
        return np.asarray(edge_lengths(y, self.topology.edges) / self._lengths)

    def source_stretches(self, x: Float) -> Float:
        """Return the stretches ``(E,)`` of the source's edges in a frame ``(V, 3)``."""
        return np.asarray(edge_lengths(x, self.source.edges) / self._source_lengths)

    def turned_over(self, y: Float, sides: Float) -> Mask:
        """Mark matched triangles ``(n,)`` whose normals oppose the expected ones in a frame ``(V', 3)``."""
        own = _sides_of(y, self.topology.faces[self.matched])
        normals, expected = (np.cross(each[:, 0], each[:, 1]) for each in (own, sides))
        return np.asarray((normals * expected).sum(axis=1) < 0)

    def newly_flat(self, y: Float) -> Mask:
        """Mark triangles ``(F',)`` that are flat in a frame ``(V', 3)``, but not at rest."""
        return np.asarray(flat_faces(y, self.topology.faces, FLAT) & ~self.flat)


def _sides_of(points: Float, faces: NDArray[Any]) -> Float:
    """Return sides 01, 12, 20 ``(n, 3, 3)`` of triangles ``(n, 3)``, in rows."""
    corners = points[faces]
    return np.asarray(np.roll(corners, -1, axis=1) - corners)


def _or_nan(lengths: Float) -> Float:
    return np.where(lengths > 0, lengths, np.nan)


class Acceleration:
    """Second differences of frames in blocks."""

    def __init__(self) -> None:
        self._before: Float | None = None
        self._squares, self._seen, self._largest, self._done = 0.0, 0, 0.0, 0
        self.worst_frame = 0

    def add(self, block: Float) -> None:
        """Add the next frames ``(B, V, 3)``."""
        whole = block if self._before is None else np.concatenate([self._before, block])
        for number in range(1, len(whole) - 1):
            before, here, after = whole[number - 1 : number + 2]
            squares = np.square(after - 2.0 * here + before).sum(axis=1)
            self._squares += float(squares.sum())
            self._seen += len(squares)
            self._done += 1  # the first difference is about frame 1
            if squares.max() > self._largest:
                self._largest, self.worst_frame = float(squares.max()), self._done
        self._before = whole[-2:]

    @property
    def rms(self) -> float:
        """Root mean square over all vertices and frames."""
        return float(np.sqrt(self._squares / max(self._seen, 1)))

    @property
    def max(self) -> float:
        """Largest acceleration of a vertex."""
        return float(np.sqrt(self._largest))


@dataclass(frozen=True)
class Smoothness:
    """Accelerations in diagonals of the target per squared frame: root mean square, and the largest of a vertex."""

    rms: float  # root mean square of the target
    max: float  # largest of a vertex of the target
    source_rms: float  # root mean square of the source, scaled to the target
    source_max: float  # largest of the source, scaled to the target
    worst_frame: int  # frame of the target's largest

    @classmethod
    def of(
        cls, target: Acceleration, diagonal: float, source: Acceleration, source_diagonal: float
    ) -> Smoothness:
        """Divide the accelerations of target and source by their diagonals."""
        return cls(
            target.rms / diagonal,
            target.max / diagonal,
            source.rms / source_diagonal,
            source.max / source_diagonal,
            target.worst_frame,
        )

    @property
    def ratio(self) -> float | None:
        """Root mean square of the target relative to the source's; None if the source does not accelerate."""
        return self.rms / self.source_rms if self.source_rms > 0 else None
