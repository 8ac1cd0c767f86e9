r"""Sequences as sums of few basis vectors per part, which graphics cards evaluate from two small textures.

Vertex v is in the part :math:`p_v`. Each of K basis vectors has a number :math:`b_k(v)` at every vertex, and three
coefficients :math:`u_{tkp}` for every frame and part:

.. math::
    x_t(v) = \sum_{k=1}^K b_k(v)\, u_{tk p_v}.

A rigid part needs four basis vectors: three affine functions of the position, and the constant 1. Bending parts need
more. The method is clustered principal component analysis (Sattler, Sarlette and Klein 2005, *Simple and efficient
compression of animation sequences*). Initial parts are from motion segmentation; parts of similar motion are merged.
Two steps alternate: the trajectories of a part determine its principal components, and each vertex joins the part whose
leading components fit its trajectory best. K is the smallest number for an error bound on all vertices. The number of
parts minimises the size of the textures. The constants were chosen empirically.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from mixseq.mesh.polygons import label_vertices
from mixseq.mesh.topology import Topology
from mixseq.rigging.bones import Centred, merge_bones
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, log_progress
from mixseq.segmentation.methods import segment
from mixseq.sequence.sequence import Frames
from mixseq.types import Float, Index

_PART_COUNT_RATIO = 2 / 3  # ratio of successive numbers of parts in the search
_RANK_SHARES = (1 / 2, 3 / 4)  # tried shares of the leading components that assign vertices to parts
_MAX_ASSIGNMENT_ROUNDS = 12  # largest number of rounds in which vertices are assigned to parts
_PRINCIPAL_ERROR_SHARE = 0.01  # largest error of the principal components, relative to the bound
_MIN_GAIN_SHARE = 0.1  # smallest gain of a reassignment, relative to the bound; excludes rounding errors


@dataclass(frozen=True, eq=False)
class LowRank:
    """Frames of a mesh whose parts are sums of basis vectors."""

    parts: Index  # (V,) part of every vertex, 0 to P - 1
    basis: Float  # (V, K) basis vectors, scaled to a maximum magnitude of 1 in each part; unused vectors are 0
    coefficients: Float  # (T, P, K, 3) coefficients of the basis vectors in every frame, in the file's units

    @property
    def rank(self) -> int:
        """Number of basis vectors K."""
        return int(self.basis.shape[1])


def fit_low_rank(sequence: Frames, max_error: float, progress: Progress = log_progress) -> LowRank:
    """Fit a sequence within `max_error`, in diagonals, by few basis vectors per part."""
    centred = Centred.from_sequence(sequence)
    header, points, diagonal = centred.header, centred.points, centred.diagonal
    faces = header.faces.astype(np.int64)
    with one_blas_thread():
        labels = segment(points, Topology(faces, header.vertex_count))
        start = label_vertices(faces, labels, header.vertex_count)
        trajectories = points.swapaxes(0, 1).reshape(header.vertex_count, -1) / diagonal
        clusters = _fit_clusters(trajectories, start, max_error, progress)
    basis = np.zeros((header.vertex_count, clusters.rank))
    coefficients = np.zeros((header.frame_count, clusters.count, clusters.rank, 3))
    for part in range(clusters.count):
        is_own = clusters.parts == part
        directions = clusters.vectors(part)
        coordinates, rank = trajectories[is_own] @ directions.T, len(directions)
        scale = np.abs(coordinates).max(axis=0, initial=0)
        scale[scale == 0] = 1
        basis[is_own, :rank] = coordinates / scale
        shapes = (directions * scale[:, None] * diagonal).reshape(rank, header.frame_count, 3)
        coefficients[:, part, :rank] = shapes.swapaxes(0, 1)
    return LowRank(clusters.parts, basis, coefficients)


@dataclass(frozen=True, eq=False)
class _Clusters:
    """Parts of trajectories, with orthonormal basis vectors."""

    parts: Index  # (V,) part of every vertex
    directions: Float  # (R, 3 T) principal directions of all trajectories
    part_directions: list[Float]  # (K_p, R) basis vectors of each part in these directions

    @property
    def count(self) -> int:
        return len(self.part_directions)

    @property
    def rank(self) -> int:
        return max(map(len, self.part_directions))

    @property
    def size(self) -> int:
        """Total size of both textures; the number of basis vectors is rounded up to a multiple of four."""
        return -(-self.rank // 4) * (len(self.parts) + int(self.directions.shape[1]) * self.count)

    def vectors(self, part: int) -> Float:
        return np.asarray(self.part_directions[part] @ self.directions)


def _fit_clusters(trajectories: Float, start: Index, bound: float, progress: Progress) -> _Clusters:
    """Return the parts of trajectories ``(V, 3 T)`` with the smallest textures."""
    directions = _principal_directions(trajectories, _PRINCIPAL_ERROR_SHARE * bound)
    tracks = trajectories @ directions.T

    def clusters_of(parts: Index) -> _Clusters:
        part_directions = [
            _fewest_directions(trajectories[parts == part], tracks[parts == part], directions, bound)
            for part in range(int(parts.max(initial=0)) + 1)
        ]
        return _Clusters(parts, directions, part_directions)

    best = clusters_of(np.zeros_like(start))  # start with a single part
    parts, initial_count = start, len(np.unique(start))
    part_count = initial_count
    while part_count > 1:
        progress(initial_count - part_count, initial_count, "finding parts of low rank")
        parts = merge_bones(trajectories, parts, part_count)
        candidate = clusters_of(parts)
        ranks = [max(4, int(candidate.rank * share)) for share in _RANK_SHARES]
        reassigned = [clusters_of(_reassign_vertices(tracks, parts, rank, bound)) for rank in ranks]
        best = min(best, candidate, *reassigned, key=lambda candidate: candidate.size)
        part_count = int(part_count * _PART_COUNT_RATIO)
    progress(initial_count, initial_count, "finding parts of low rank")
    return best


def _principal_directions(rows: Float, max_residual: float) -> Float:
    """Return the fewest principal directions ``(R, n)`` of rows ``(m, n)`` for residuals up to `max_residual`."""
    is_wide = len(rows) < rows.shape[1]
    gram = rows @ rows.T if is_wide else rows.T @ rows
    variances, axes = linalg.eigh(gram)
    order = np.argsort(variances)[::-1]
    variances, axes = variances[order], axes[:, order]
    is_kept = variances > max(variances[0], 1e-300) * 1e-20 if len(variances) else variances > 0
    total_residuals = np.cumsum(variances[::-1])[::-1]  # upper bounds of the squared residual of a row
    is_kept &= total_residuals > max_residual**2
    is_kept[:1] = True
    directions = axes[:, is_kept].T
    if is_wide:
        directions = directions @ rows
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    return np.asarray(directions)


def _reassign_vertices(tracks: Float, parts: Index, rank: int, bound: float) -> Index:
    """Alternately assign vertices to the part of smallest residual at a given rank, and update the parts."""
    squared_norms, min_gain = np.square(tracks).sum(axis=1), _MIN_GAIN_SHARE * bound
    for _ in range(_MAX_ASSIGNMENT_ROUNDS):
        residuals = np.empty((int(parts.max(initial=0)) + 1, len(parts)))
        for part in range(len(residuals)):
            directions = _principal_directions(tracks[parts == part], min_gain)[:rank]
            residuals[part] = squared_norms - np.square(tracks @ directions.T).sum(axis=1)
        best_parts, vertices = residuals.argmin(axis=0), np.arange(len(parts))
        is_kept = residuals[parts, vertices] <= residuals[best_parts, vertices] + min_gain**2
        assigned = np.where(is_kept, parts, best_parts)
        if np.array_equal(assigned, parts):
            break
        parts = np.unique(assigned, return_inverse=True)[1].reshape(-1)
    return np.asarray(parts)


def _fewest_directions(trajectories: Float, tracks: Float, directions: Float, bound: float) -> Float:
    """Return the fewest principal directions ``(K, R)`` that fit a part's tracks within a bound."""
    own_directions = _principal_directions(tracks, 0.0)

    def max_distance(count: int) -> float:
        projected = (tracks @ own_directions[:count].T) @ (own_directions[:count] @ directions)
        squared_distances = np.square(trajectories - projected).reshape(len(trajectories), -1, 3).sum(axis=2)
        return float(np.sqrt(squared_distances.max(initial=0)))

    low, high = 1, len(own_directions)
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if max_distance(middle) <= bound else (middle + 1, high)
    return own_directions[:low]
