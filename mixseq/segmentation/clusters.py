"""Clustering by rigid motion: Lloyd's iteration with incremental updates.

A cluster's motion follows from sums over its vertices ("tallies"), which moving elements take along. Costs of unchanged
clusters are reused.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index, Mask, Single
from mixseq.geometry.rigid import nearest_rotations
from mixseq.segmentation.elements import Elements, Trajectories
from mixseq.segmentation.rigid_error import Moments

_LANES = 8  # columns of costs computed at a time
_WORK = 1 << 24  # numbers in an array of costs, unless `_LANES` columns have more
_TINY = np.finfo(np.float64).tiny


class Clusters:
    """Elements in at most `capacity` clusters."""

    def __init__(self, elements: Elements, labels: Index, capacity: int) -> None:
        self.labels = labels
        self._elements = elements
        self._tallies = tally(elements, labels, capacity)
        self._sizes = np.bincount(labels, minlength=capacity)
        self._stale = self._sizes > 0
        self._rounds = -1
        longest = 1 + max(len(elements), elements.trajectories.moved.shape[1])
        self._at_once = max(_LANES, min(capacity + _LANES - 1, _WORK // longest) // _LANES * _LANES)
        self._work = np.empty((3, longest * self._at_once), dtype=np.float32)
        self._costs = np.full((len(elements), capacity), np.inf, dtype=np.float32)

    def assign(self, rounds: int) -> Single:
        """Assign every element to the cluster of lowest cost ``(E,)``, averaged `rounds` times over neighbours."""
        from mixseq.segmentation.segmentation_kernels import cheapest

        stale = np.flatnonzero(self._sizes > 0 if rounds != self._rounds else self._stale)
        self._rounds = rounds
        self._stale[:] = False
        labels, lowest = np.empty_like(self.labels), np.empty(len(self.labels), dtype=np.float32)
        for start in range(0, max(len(stale), 1), self._at_once):
            some = stale[start : start + self._at_once]
            cheapest(self._diffused(some, rounds), some, self._costs, labels, lowest)
        self._move(labels)
        return lowest

    def seed(self, members: Index, cluster: int) -> None:
        """Move elements to a cluster."""
        labels = self.labels.copy()
        labels[members] = cluster
        self._move(labels)

    def _move(self, labels: Index) -> None:
        from mixseq.segmentation.segmentation_kernels import transfer

        moved = np.flatnonzero(labels != self.labels)
        e = self._elements
        before = self._tallies[:, 3, -1].copy()
        transfer(moved, self.labels, labels, e.corners, e.weights, e.trajectories.rows, self._tallies)
        self._stale[self.labels[moved]] = self._stale[labels[moved]] = True
        self.labels = labels
        self._sizes = np.bincount(labels, minlength=len(self._sizes))
        # What is left of almost all is rounding: look again.
        for cluster in np.flatnonzero(self._stale & (self._tallies[:, 3, -1] < 1e-3 * before)):
            self._tallies[cluster] = tally(e, labels, len(self._sizes), labels == cluster)[cluster]
        for empty in np.flatnonzero((self._sizes == 0) & self._stale):
            self._stale[empty] = False
            self._costs[:, empty] = np.inf

    def _diffused(self, clusters: Index, rounds: int) -> Single:
        """Costs ``(E, n)`` of clusters, averaged over neighbours."""
        from mixseq.segmentation.segmentation_kernels import averages, squared_distances

        e = self._elements
        moved = e.trajectories.moved
        width = -(-len(clusters) // _LANES) * _LANES
        motions = motions_of(self._tallies[clusters], e.trajectories).astype(np.float32)
        costs, spare = (self._work[i, : (len(e) + 1) * width].reshape(len(e) + 1, width) for i in range(2))
        per_vertex = self._work[2, : (moved.shape[1] + 1) * width].reshape(moved.shape[1] + 1, width)
        costs[-1] = spare[-1] = per_vertex[-1] = 0.0  # of elements and vertices that are none
        per_vertex[:, len(clusters) :] = 0.0
        squared_distances(moved, moved[:3], motions, per_vertex[:-1])
        averages(per_vertex, e.corners, e.corner_factors, costs)
        for _ in range(rounds):
            averages(costs, e.around, e.factors, spare)
            costs, spare = spare, costs
        return costs


def tally(elements: Elements, labels: Index, count: int, counted: Mask | None = None) -> Float:
    """Sum ``w h y^T`` ``(count, 4, 4T + 4)`` over the vertices of the (counted) elements with each label."""
    from mixseq.segmentation.segmentation_kernels import transfer

    rows = elements.trajectories.rows
    tallies = np.zeros((count, 4, rows.shape[1]))
    chosen = np.arange(len(elements)) if counted is None else np.flatnonzero(counted)
    transfer(chosen, np.full(len(elements), -1), labels, elements.corners, elements.weights, rows, tallies)
    return tallies


def motions_of(tallies: Float, trajectories: Trajectories) -> Float:
    """Return the best rigid motions ``(K, 3T, 4)``, rotations and translations, of clusters."""
    count, frames = len(tallies), trajectories.frame_count
    sums = tallies[:, :, : 3 * frames].reshape(count, 4, frames, 3)
    cross, moved = sums[:, :3].transpose(0, 2, 3, 1), sums[:, 3]
    rest = tallies[:, 3, -4:-1]
    weight = np.maximum(tallies[:, 3, -1], _TINY)[:, None, None]
    rotations = nearest_rotations(cross - moved[..., None] * (rest / weight[:, 0])[:, None, None])
    translations = (moved - np.einsum("ktij,kj->kti", rotations, rest)) / weight
    return np.concatenate([rotations, translations[..., None]], axis=3).reshape(count, 3 * frames, 4)


def moments_of(tallies: Float, trajectories: Trajectories) -> list[Moments]:
    """Return the moments of clusters."""
    frames = trajectories.frame_count
    return [
        Moments(
            weight=float(sums[3, -1]),
            rest=sums[3, -4:-1],
            moved=sums[3, : 3 * frames].reshape(frames, 3),
            rest_square=float(np.trace(sums[:3, -4:-1])),
            moved_square=sums[3, 3 * frames : 4 * frames],
            cross=sums[:3, : 3 * frames].reshape(3, frames, 3).transpose(1, 2, 0),
        )
        for sums in tallies
    ]
