r"""Check markers: refuse invalid ones, and warn of those that seem wrong.

*Mirrored?* With centred sources X and targets Y and singular values :math:`\sigma` of :math:`X^T Y`, the share of Y
that the best similarity leaves is :math:`1 - (\sigma_1 + \sigma_2 \pm \sigma_3)^2 / (\|X\|^2 \|Y\|^2)`, with one sign
for rotations, the other for reflections (Umeyama 1991).

*Exchanged?* Two markers are left out, and predicted by a thin-plate spline through the others
(`mixseq.correspondence.outliers`). They are exchanged if that fits far better the other way round. The best pair is
exchanged, and the search repeated. Then groups of markers are compared alike.

*Wrong?* The same with one marker at a time.

On the markers of horse and camel (107, 124 and 17 pairs) and of cat and lion (55), which are right, no exchange of two
markers brings them closer than 0.57 times their distance, none of two groups closer than 1.08, and no marker is further
than 0.35 from its prediction. Of two markers of a left and a right leg, exchanged, 99 % are named, and nothing else; of
three such pairs at a time, 95 % (fewer among 17 markers).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.correspondence.markers import Markers
from mixseq.correspondence.outliers import (
    FEWEST_COMPARED,
    NOTHING,
    STRIKING,
    Bending,
    exchanged_groups,
    exchanged_pairs,
    wrong_markers,
)
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.topology import Topology

FEWEST = 4
"""Number of markers that determine an affine map."""

THIN = 0.01
"""Ratio of extents below which markers lie on a line or a plane."""

MIRRORED = 0.5
"""Ratio of residuals of the best reflection to the best rotation below which markers are mirrored."""

SIMILAR = 0.01
"""Residual of a rotation below which markers are too flat to detect a reflection."""

MOST_COMPARED = 1000
"""Largest number of markers that are compared with each other."""

GROUPS_EXCHANGED, MOST_GROUPED = 0.7, 200
"""Ratio of distances, exchanged to unchanged, of two exchanged groups; largest number of markers that are grouped."""

NAMED = 6
"""Largest number of markers named in a message."""


@dataclass(frozen=True, eq=False)
class Suspicion:
    """Markers that do not fit the others."""

    numbers: Index  # (k,) which
    why: str  # the problem, and its cure


def check_markers(
    markers: Markers,
    source_points: FloatArray,
    target_points: FloatArray,
    source_topology: Topology | None = None,
    target_topology: Topology | None = None,
) -> None:
    """Raise `SettingsError` for invalid markers, and warn of suspicious ones: points ``(V, 3)`` and ``(V', 3)``."""
    once = np.sort(np.unique(np.stack([markers.source, markers.target]), axis=1, return_index=True)[1])
    if len(once) < FEWEST:
        repeated = f" that differ, of {len(markers)}" if len(once) < len(markers) else ""
        raise SettingsError(
            f"there are {len(once)} markers{repeated}; at least {FEWEST} that are on no plane are needed"
        )
    for side, vertices, points, topology in (
        ("source", markers.source, source_points, source_topology),
        ("target", markers.target, target_points, target_topology),
    ):
        _check_vertices(markers, side, vertices, len(points))
        if topology is not None:
            _check_used(markers, side, vertices, topology)
    _check_pairs(markers)
    own, other = _used(source_points, source_topology), _used(target_points, target_topology)
    source = np.asarray(source_points[markers.source], np.float64)
    target = np.asarray(target_points[markers.target], np.float64)
    for side, chosen, points in (("source", source, own), ("target", target, other)):
        _check_spread(side, chosen, points)
    _check_hand(_normalised(source), _normalised(target))
    for each in suspicions(markers, source, target, float(np.linalg.norm(np.ptp(other, axis=0)))):
        _warn(each.why)


def check_numbers(markers: Markers, source: Topology, target: Topology) -> None:
    """Raise `SettingsError` for markers on missing vertices, or on vertices without triangles."""
    for side, vertices, topology in (("source", markers.source, source), ("target", markers.target, target)):
        _check_vertices(markers, side, vertices, topology.vertex_count)
        _check_used(markers, side, vertices, topology)


def suspicions(markers: Markers, source: Float, target: Float, diagonal: float) -> list[Suspicion]:
    """Find pairs, groups and single markers that seem exchanged or wrong: source, target ``(n, 3)``."""
    once = np.sort(np.unique(np.stack([markers.source, markers.target]), axis=1, return_index=True)[1])
    if not FEWEST_COMPARED <= len(once) <= MOST_COMPARED:
        return []
    unit = _size(target[once]) / diagonal
    return list(_compared(markers, once, _normalised(source[once]), _normalised(target[once]), unit))


def _check_vertices(markers: Markers, side: str, vertices: Index, count: int) -> None:
    outside = np.flatnonzero((vertices < 0) | (vertices >= count))
    if not outside.size:
        return
    message = (
        f"{_listed(markers, outside)}: the {side} has {count} vertices, 0 to {count - 1}; choose others, "
        "or see that source and target are not exchanged"
    )
    if vertices.max() == count and vertices.min() > 0:
        message += ", or subtract 1 from all: the file may count from 1"
    raise SettingsError(message)


def _check_used(markers: Markers, side: str, vertices: Index, topology: Topology) -> None:
    unused = np.flatnonzero(np.isin(vertices, topology.unused_vertices))
    if unused.size:
        raise SettingsError(
            f"{_listed(markers, unused)}: no triangle of the {side} uses the vertex; choose others nearby"
        )


def _check_pairs(markers: Markers) -> None:
    """Raise if a vertex has two partners; repeated pairs are allowed."""
    for side, other, one, two in (
        ("source", "targets", markers.source, markers.target),
        ("target", "sources", markers.target, markers.source),
    ):
        order = np.lexsort((two, one))
        clash = np.flatnonzero((np.diff(one[order]) == 0) & (np.diff(two[order]) != 0))
        if clash.size:
            pair = np.sort(order[clash[0] : clash[0] + 2])
            raise SettingsError(
                f"{_listed(markers, pair)} give vertex {one[pair[0]]} of the {side} two {other}; leave one out"
            )


def _check_spread(side: str, chosen: Float, points: Float) -> None:
    """Raise if markers do not extend in three directions, as the mesh does."""
    centre = chosen.mean(axis=0)
    _, extents, axes = np.linalg.svd(chosen - centre, full_matrices=False)
    if extents[1] <= THIN * extents[0]:
        raise SettingsError(
            f"all markers of the {side} are on one line, which leaves the turn about it open; add some beside it"
        )
    across = np.abs((points - centre) @ axes[2]).max()
    if extents[2] <= THIN * extents[0] and across > THIN * np.ptp(points, axis=0).max():
        _warn(
            f"all markers of the {side} are on one plane, so that nothing tells its two sides apart; add some beside it"
        )


def _check_hand(source: Float, target: Float) -> None:
    s = np.linalg.svd(source.T @ target, compute_uv=False) / len(source)
    sign = np.sign(np.linalg.det(source.T @ target))
    rotated, reflected = (1 - (s[0] + s[1] + hand * s[2]) ** 2 for hand in (sign, -sign))
    if rotated > SIMILAR and reflected < MIRRORED * rotated:
        raise SettingsError(
            f"left and right are exchanged in all markers, or one mesh is mirrored: the best rotation leaves "
            f"{100 * rotated:.0f} % of what the markers tell, the best reflection {100 * reflected:.0f} %; "
            "exchange left and right, or mirror one mesh (and turn its triangles over)"
        )


def _compared(
    markers: Markers, rows: Index, source: Float, target: Float, unit: float
) -> Iterator[Suspicion]:
    """Yield suspicions; `unit` is the size of normalised targets in diagonals."""
    bending = Bending.of(source)
    for i, j, straight, exchanged in exchanged_pairs(bending, target):
        target[[i, j]] = target[[j, i]]
        yield Suspicion(
            rows[[i, j]],
            f"{_listed(markers, rows[[i, j]])} seem exchanged: the others say that their targets should be "
            f"{100 * unit * straight:.1f} % of the diagonal away, exchanged {100 * unit * exchanged:.1f} %; if they "
            "are, exchange the two targets",
        )
    if len(source) <= MOST_GROUPED:
        first, second, straight, exchanged = exchanged_groups(bending, source, target)
        typical = float(np.median(bending.left_out(target)[0]))
        if exchanged < GROUPS_EXCHANGED * straight and straight > max(STRIKING * typical, NOTHING):
            yield Suspicion(
                rows[np.concatenate([first, second])],
                f"{_listed(markers, rows[first])} seem exchanged with {_listed(markers, rows[second])}, left for "
                f"right: the others say that the centres of their targets should be {100 * unit * straight:.0f} % of "
                f"the diagonal away, exchanged {100 * unit * exchanged:.0f} %; look at all markers there",
            )
            return
    for i, distance, surprise in wrong_markers(source, target):
        yield Suspicion(
            rows[[i]],
            f"{_listed(markers, rows[[i]])} seems wrong: the others say that its target should be "
            f"{100 * unit * distance:.0f} % of the diagonal away ({surprise:.0f} times as striking as their median); "
            "look at it, or leave it out",
        )


def _used(points: FloatArray, topology: Topology | None) -> Float:
    """Return the points of triangles, or all if these are unknown."""
    used = points if topology is None else np.delete(points, topology.unused_vertices, axis=0)
    return np.asarray(used, np.float64)


def _normalised(points: Float) -> Float:
    return np.asarray((points - points.mean(axis=0)) / _size(points))


def _size(points: Float) -> float:
    """Return the root mean square distance from the centre."""
    centred = points - points.mean(axis=0)
    return max(float(np.sqrt((centred**2).sum(axis=1).mean())), np.finfo(float).tiny)


def _listed(markers: Markers, numbers: Index) -> str:
    names = [markers.name(int(number)) for number in numbers[:NAMED]]
    more = f" and {len(numbers) - NAMED} more" if len(numbers) > NAMED else ""
    joined = " and ".join(names) if len(names) == 2 and not more else ", ".join(names)
    return f"marker{'s' if len(numbers) > 1 else ''} {joined}{more}"


def _warn(message: str) -> None:
    warnings.warn(message, MixseqWarning, stacklevel=5)
