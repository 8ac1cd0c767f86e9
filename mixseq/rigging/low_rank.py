r"""Sequences as sums of few basis vectors, part by part, which graphics cards evaluate from two small textures.

With the part :math:`p_v` of a vertex, K basis vectors with a number at every vertex, and three coordinates of each for
every part and frame,

.. math::
    x_t(v) = \sum_{k=1}^K b_k(v)\, u_{tk p_v}.

A rigid part needs four of them: three affine functions of the position, and 1. Bending parts need some more, and
vertices between parts go to the one that fits best: clustered principal components (Sattler, Sarlette and Klein 2005,
*Simple and efficient compression of animation sequences*). Parts begin as those of motion segmentation, and as these
merged to fewer, the most similar motions first. In turn, basis vectors are the principal components of the trajectories
of a part, and a vertex joins the part whose leading components leave the smallest residual of its trajectory. K is the
smallest for a bound on all vertices, and the parts are those with the smallest textures. The constants were chosen
empirically.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.rigging.bones import Centred, label_vertices, merged
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, no_progress
from mixseq.runtime.public import public
from mixseq.segmentation.methods import segment
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, check_frames
from mixseq.types import Float, Index

_FEWER = 2 / 3
"""Ratio of successive numbers of parts that are tried."""

_SHARES = (1 / 2, 3 / 4)
"""Shares of a part's components used to assign vertices to parts."""

_ROUNDS = 12
"""Rounds in which vertices join parts."""

_LEFT_OUT = 0.01
"""Largest error of the principal components of the whole mesh, as a share of the bound."""

_SAME = 0.1
"""Smallest gain for which a vertex changes its part, as a share of the bound; rounding of points is below."""


@dataclass(frozen=True, eq=False)
class LowRank:
    """A mesh whose parts are sums of basis vectors; the formula is at the head of this module."""

    header: SequenceHeader  # mesh and times
    parts: Index  # (V,) the part of every vertex, 0 to P - 1
    basis: Float  # (V, K) basis vectors, the largest number of each in each part 1 or -1; 0 where a part needs fewer
    coefficients: Float  # (T, P, K, 3) coordinates of the basis vectors in every frame, in the file's units

    def __post_init__(self) -> None:
        vertices, rank = self.basis.shape
        frames, parts = self.coefficients.shape[:2]
        fits = (
            vertices == self.header.vertex_count == len(self.parts)
            and frames == self.header.frame_count
            and self.coefficients.shape[2:] == (rank, 3)
            and (not vertices or (self.parts.min() >= 0 and self.parts.max() < parts))
        )
        if not fits:
            raise InvalidSequenceError(
                f"{len(self.parts)} parts of vertices, a basis {self.basis.shape} and coefficients "
                f"{self.coefficients.shape} do not fit {self.header.frame_count} frames of "
                f"{self.header.vertex_count} vertices"
            )

    @property
    def rank(self) -> int:
        """Number of basis vectors K."""
        return int(self.basis.shape[1])

    def blocks(self, size: int = 16) -> Iterator[Float]:
        """Iterate over the points in blocks ``(n, V, 3)`` of at most `size` frames."""
        for start in range(0, self.header.frame_count, size):
            frames = self.coefficients[start : start + size]
            yield np.stack([np.einsum("vk,vki->vi", self.basis, frame[self.parts]) for frame in frames])

    def points(self) -> Float:
        """Return all frames ``(T, V, 3)``."""
        return np.concatenate(list(self.blocks()))


@public
def fit_low_rank(
    sequence: Frames, max_error: float = 1e-3, parts: int | None = None, progress: Progress = no_progress
) -> LowRank:
    """Fit the fewest basis vectors of parts to a sequence within `max_error`, in diagonals, from at most `parts` parts.

    By default parts start from motion segmentation. All of the sequence is held in memory as float64. Raises
    InvalidSequenceError if it is no sequence, SettingsError if `max_error` is not positive.
    """
    check_frames(sequence)
    if not max_error > 0:
        raise SettingsError(f"max_error is {max_error:g}; a positive number of diagonals is expected")
    centred = Centred.of(sequence)
    header, points, diagonal = centred.header, centred.points, centred.diagonal
    faces = header.faces.astype(np.int64)
    with one_blas_thread():
        labels = segment(points, Topology(faces, header.vertex_count), parts=parts)
        start = label_vertices(faces, labels, header.vertex_count)
        trajectories = points.swapaxes(0, 1).reshape(header.vertex_count, -1) / diagonal
        found = _clustered(trajectories, start, max_error, progress)
    basis = np.zeros((header.vertex_count, found.rank))
    coefficients = np.zeros((header.frame_count, found.count, found.rank, 3))
    for number in range(found.count):
        own = found.parts == number
        vectors = found.vectors(number)
        numbers = trajectories[own] @ vectors.T
        scale = np.abs(numbers).max(axis=0, initial=0)
        scale[scale == 0] = 1
        rank = len(vectors)
        basis[own, :rank] = numbers / scale
        shapes = (vectors * scale[:, None] * diagonal).reshape(rank, header.frame_count, 3)
        coefficients[:, number, :rank] = shapes.swapaxes(0, 1)
    return LowRank(header, found.parts, basis, coefficients)


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Parts of trajectories, and the orthonormal vectors of each that the bound requires."""

    parts: Index
    whole: Float  # (R, 3 T) principal directions of all trajectories
    own: list[Float]  # (K_p, R) each

    @property
    def count(self) -> int:
        return len(self.own)

    @property
    def rank(self) -> int:
        return max(map(len, self.own))

    @property
    def size(self) -> int:
        """Size in textures, for comparison: basis vectors in fours, and coefficients."""
        return -(-self.rank // 4) * (len(self.parts) + int(self.whole.shape[1]) * self.count)

    def vectors(self, number: int) -> Float:
        return np.asarray(self.own[number] @ self.whole)


def _clustered(trajectories: Float, start: Index, bound: float, progress: Progress) -> _Clusters:
    """Return the parts of trajectories ``(V, 3 T)`` with the smallest size among those tried."""
    whole = _directions(trajectories, _LEFT_OUT * bound)
    tracks = trajectories @ whole.T

    def clusters(parts: Index) -> _Clusters:
        own = [
            _needed(trajectories[parts == part], tracks[parts == part], whole, bound)
            for part in range(int(parts.max(initial=0)) + 1)
        ]
        return _Clusters(parts, whole, own)

    best = clusters(np.zeros_like(start))  # a single part
    parts, all_parts = start, len(np.unique(start))
    count = all_parts
    while count > 1:
        progress(all_parts - count, all_parts, "finding parts of low rank")
        parts = merged(trajectories, parts, count)
        found = clusters(parts)
        joined = [
            clusters(_joined(tracks, parts, max(4, int(found.rank * share)), bound)) for share in _SHARES
        ]
        best = min(best, found, *joined, key=lambda each: each.size)
        count = int(count * _FEWER)
    progress(all_parts, all_parts, "finding parts of low rank")
    return best


def _directions(rows: Float, least: float) -> Float:
    """Return principal directions ``(R, n)`` of rows ``(m, n)``, without those that no row needs."""
    shorter = len(rows) < rows.shape[1]
    gram = rows @ rows.T if shorter else rows.T @ rows
    values, vectors = linalg.eigh(gram)
    order = np.argsort(values)[::-1]
    values, vectors = values[order], vectors[:, order]
    kept = values > max(values[0], 1e-300) * 1e-20 if len(values) else values > 0
    kept &= np.cumsum(values[::-1])[::-1] > least**2  # no row has a larger rest than all together
    kept[:1] = True
    directions = vectors[:, kept].T
    if shorter:
        directions = directions @ rows
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    return np.asarray(directions)


def _joined(tracks: Float, parts: Index, rank: int, bound: float) -> Index:
    """Assign every vertex to the part with the smallest residual at a rank, in turn."""
    squares = np.square(tracks).sum(axis=1)
    for _ in range(_ROUNDS):
        left = np.stack(
            [
                squares
                - np.square(tracks @ _directions(tracks[parts == part], _SAME * bound)[:rank].T).sum(axis=1)
                for part in range(int(parts.max(initial=0)) + 1)
            ]
        )
        nearer = left.argmin(axis=0)
        vertices = np.arange(len(parts))
        stays = left[parts, vertices] <= left[nearer, vertices] + (_SAME * bound) ** 2
        joined = np.where(stays, parts, nearer)
        if np.array_equal(joined, parts):
            break
        parts = np.unique(joined, return_inverse=True)[1].reshape(-1)
    return np.asarray(parts)


def _needed(rows: Float, tracks: Float, whole: Float, bound: float) -> Float:
    """Return the fewest principal directions ``(K, R)`` of a part's tracks that keep a bound."""
    directions = _directions(tracks, 0.0)

    def left(count: int) -> float:
        shown = (tracks @ directions[:count].T) @ (directions[:count] @ whole)
        apart = np.square(rows - shown).reshape(len(rows), -1, 3).sum(axis=2)
        return float(np.sqrt(apart.max(initial=0)))

    low, high = 1, len(directions)
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if left(middle) <= bound else (middle + 1, high)
    return directions[:low]
