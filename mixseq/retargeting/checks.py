r"""Check markers: refuse invalid ones, and warn of those that seem wrong; refuse meshes that are inside out.

*Inside out?* Triangles of source and target must have the same orientation. A closed component encloses the volume
:math:`\frac16 \sum_t a_t \cdot (b_t \times c_t)`, negative if its triangles run clockwise seen from outside. With holes
it depends on the origin, by the sum of the vector areas: the sign of a component counts if it is the same for all
origins in its bounding sphere. More open surfaces are checked after registration, by the normals of closest points.

*Mirrored?* With centred sources X and targets Y and singular values :math:`\sigma` of :math:`X^T Y`, the share of Y
that the best similarity leaves is :math:`1 - (\sigma_1 + \sigma_2 \pm \sigma_3)^2 / (\|X\|^2 \|Y\|^2)`, with one sign
for rotations, the other for reflections (Umeyama 1991).

*Exchanged?* Two markers are left out, and predicted by a thin-plate spline through the others. They are exchanged if
that fits far better the other way round. The best pair is exchanged, and the search repeated. Then groups of markers
are compared alike: exchanging the left leg for the right one exchanges all its markers. No two of them then look wrong
among the others, but leaving both groups out predicts the side of either centre. *Wrong?* The same with one marker.

Sources and targets are normalised: centred, with a root mean square distance of 1. The smoothest map of space that
takes sources :math:`x_i` to targets :math:`y_i`, up to a little slack :math:`\lambda`, has the bending energy (Duchon
1977; in three dimensions the kernel is :math:`-\|x\|`)

.. math::
    E = \operatorname{tr} Y^T B\, Y, \qquad B = Z (Z^T K Z)^{-1} Z^T, \qquad
    K_{ij} = -\|x_i - x_j\| + \lambda \delta_{ij},

where the columns of Z are orthogonal to all affine functions of the :math:`x_i`. Without the markers of a set S, it
takes these to where the energy is least,

.. math:: \hat y_S = y_S - (B_{SS})^{-1} (B Y)_S,

so that leaving out needs no other solution (Wahba 1990, chapter 4).

On the markers of horse and camel (107, 124 and 17 pairs) and of cat and lion (55), which are right, no exchange of two
markers brings them closer than 0.57 times their distance, none of two groups closer than 1.08, and no marker is further
than 0.35 from its prediction. Of two markers of a left and a right leg, exchanged, 99 % are named, and nothing else; of
three such pairs at a time, 95 % (fewer among 17 markers).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.markers import Markers
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, FloatArray, Index, IntArray

NO_VOLUME = 1e-9
"""Volume relative to a component's cubed diagonal below which it is rounding."""

MAX_NAMED_COMPONENTS = 4
"""Largest number of components named in a message."""

_CURE = "turn its triangles over (faces[:, ::-1]; in a modelling program: flip the normals)"


@dataclass(frozen=True, eq=False)
class Orientation:
    """Orientation of components."""

    faces: Index  # (c,) a triangle of every component
    areas: Float  # (c,) their areas
    # (c,) 1 if the triangles are counter-clockwise seen from outside, -1 if clockwise, 0 if there is no outside.
    signs: Index

    @property
    def sign(self) -> int:
        """Orientation of most of the area that has an outside."""
        return int(np.sign(self.areas @ self.signs))


def orientation(points: FloatArray, faces: IntArray) -> Orientation:
    """Find the orientation of the components of points ``(V, 3)`` and triangles ``(F, 3)``."""
    mesh = TriangleMesh(np.asarray(points, np.float64), Topology(faces, len(points)))
    component = mesh.topology.component_of_face
    count = int(component.max(initial=-1)) + 1
    corners = mesh.points[mesh.faces]
    lowest, highest = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(lowest, component, corners.min(axis=1))
    np.maximum.at(highest, component, corners.max(axis=1))
    # About the centre of its box the volume of a component is rounded least.
    a, b, c = np.moveaxis(corners - ((lowest + highest) / 2)[component, None], 1, 0)
    volumes = np.bincount(component, np.einsum("fi,fi->f", a, np.cross(b, c)) / 6, count)
    open_area = [np.bincount(component, mesh.vectors[:, axis], count) for axis in range(3)]
    diagonals = np.linalg.norm(highest - lowest, axis=1)
    doubt = np.linalg.norm(open_area, axis=0) * diagonals / 6 + NO_VOLUME * diagonals**3
    signs = np.where(np.abs(volumes) > doubt, np.sign(volumes), 0).astype(np.int64)
    first = np.unique(component, return_index=True)[1]
    areas = np.bincount(component, mesh.face_areas, count).astype(np.float64)
    return Orientation(first, areas, signs)


def check_orientation(
    source_points: FloatArray,
    source_faces: IntArray,
    target_points: FloatArray,
    target_faces: IntArray,
) -> None:
    """Raise if one of two meshes is inside out, where both have an outside: points ``(V, 3)``; faces ``(F, 3)``."""
    source, target = orientation(source_points, source_faces), orientation(target_points, target_faces)
    if source.sign * target.sign == -1:
        which = "target" if target.sign < 0 else "source"
        raise SettingsError(f"the {which} is inside out, its volume is negative; {_CURE}")
    turned = np.flatnonzero(target.signs * target.sign == -1)
    if turned.size:
        named = ", ".join(
            f"that of triangle {target.faces[number]}" for number in turned[:MAX_NAMED_COMPONENTS]
        )
        more = f" and {len(turned) - MAX_NAMED_COMPONENTS} more" if len(turned) > MAX_NAMED_COMPONENTS else ""
        warnings.warn(
            f"{len(turned)} of {len(target.faces)} components of the target are inside out ({named}{more}); "
            "turn their triangles over if they are no cavities",
            MixseqWarning,
            stacklevel=2,
        )


def check_facing(
    registered: FloatArray, source_faces: IntArray, target_points: FloatArray, target_faces: IntArray
) -> None:
    """Raise if a target ``(V', 3)`` faces away from the source ``(V, 3)`` fitted to it, where one has no outside."""
    if orientation(registered, source_faces).sign * orientation(target_points, target_faces).sign != 0:
        return  # `check_orientation` decides
    share = _against(registered, source_faces, target_points, target_faces)
    if share > 0.5:
        raise SettingsError(
            f"{100 * share:.0f} % of the target's area faces away from the source that was fitted to it: one of them "
            f"is inside out; of the target, {_CURE}"
        )


def _against(
    registered: FloatArray, source_faces: IntArray, target_points: FloatArray, target_faces: IntArray
) -> float:
    """Return the share of a target's area with normals opposite to those of the closest source triangles."""
    from mixseq.mesh.nearest import Nearest

    fitted = TriangleMesh(np.asarray(registered, np.float64), Topology(source_faces, len(registered)))
    target = TriangleMesh(np.asarray(target_points, np.float64), Topology(target_faces, len(target_points)))
    found = Nearest.of(fitted.points, fitted.faces).query(target.centroids)
    opposite = np.einsum("fi,fi->f", fitted.face_normals[found.faces], target.face_normals) < 0
    return float(target.face_areas[opposite].sum() / max(target.face_areas.sum(), np.finfo(float).tiny))


SLACK = 0.05
"""Slack of the splines, in root mean square distances from the centre; it hardly matters from 0 to 0.2."""

_NO_SUPPORT = 1e-9
"""Entries of B, relative to its mean diagonal, below which the other markers do not support a prediction."""

FEWEST_COMPARED = 8
"""Least number of markers for a comparison."""

EXCHANGED = 0.5
"""Ratio of distances, exchanged to unchanged, below which two markers are exchanged."""

STRIKING = 2.5
"""Least distance of exchanged markers, in median distances of markers left out."""

FAR, SURPRISING = 0.5, 5.0
"""Distance of a wrong marker in root mean square distances from the centre, and surprise in medians of all."""

MOST_FOUND = 20
"""Largest number of exchanges, and of wrong markers."""

NOTHING = 1e-6
"""Distance below which it is rounding."""

LARGEST_SHARE = 0.25
"""Largest share of all markers in a group."""

ALIKE = 2.5
"""Largest ratio of the sizes of two exchanged groups."""


@dataclass(frozen=True, eq=False)
class Bending:
    """The bending energy of thin-plate splines through fixed sources."""

    matrix: Float  # (n, n) the matrix B above

    @classmethod
    def of(cls, sources: Float, slack: float = SLACK) -> Self:
        """Prepare the energy of maps of more than four sources ``(n, 3)``."""
        kernel = -np.linalg.norm(sources[:, None] - sources, axis=2) + slack * np.eye(len(sources))
        affine = np.column_stack([np.ones(len(sources)), sources])
        free = np.linalg.qr(affine, mode="complete")[0][:, 4:]
        return cls(np.asarray(free @ np.linalg.solve(free.T @ kernel @ free, free.T)))

    def left_out(self, targets: Float) -> tuple[Float, Float]:
        """Leave out every marker in turn, with targets ``(n, 3)``; return distances ``(n,)`` and surprises ``(n,)``."""
        force = np.linalg.norm(self.matrix @ targets, axis=1)
        own = np.diag(self.matrix)
        known = own > _NO_SUPPORT * own.mean()
        own = np.where(known, own, 1.0)
        return np.where(known, force / own, 0.0), np.where(known, force / np.sqrt(own), 0.0)

    def exchanges(self, targets: Float) -> tuple[Index, Index, Float, Float]:
        """Leave out all pairs of markers in turn, and exchange their targets ``(n, 3)``.

        Return both markers of every pair ``(m,)``, and their root mean square distances ``(m,)`` from the predictions
        by the others, unchanged and with their targets exchanged.
        """
        force, own = self.matrix @ targets, np.diag(self.matrix)
        i, j = np.triu_indices(len(targets), 1)
        both = self.matrix[i, j]
        determinant = own[i] * own[j] - both**2
        known = determinant > (_NO_SUPPORT * own.mean()) ** 2
        i, j, both, determinant = i[known], j[known], both[known, None], determinant[known, None]
        at_i = (own[j, None] * force[i] - both * force[j]) / determinant
        at_j = (own[i, None] * force[j] - both * force[i]) / determinant
        apart = targets[j] - targets[i]
        return i, j, _mean_size(at_i, at_j), _mean_size(at_i + apart, at_j - apart)


def _mean_size(a: Float, b: Float) -> Float:
    return np.asarray(np.sqrt(((a**2).sum(axis=1) + (b**2).sum(axis=1)) / 2))


def exchanged_pairs(bending: Bending, target: Float) -> list[tuple[int, int, float, float]]:
    """Find markers whose targets ``(n, 3)`` seem exchanged, the most striking first."""
    target, found = target.copy(), []
    for _ in range(min(len(target) // 4, MOST_FOUND)):
        first, second, straight, exchanged = bending.exchanges(target)
        typical = np.median(bending.left_out(target)[0])
        better = (exchanged < EXCHANGED * straight) & (straight > max(STRIKING * typical, NOTHING))
        if not better.any():
            break
        ratio = exchanged / np.where(better, straight, np.inf)
        best = int(np.argmin(np.where(better, ratio, np.inf)))
        i, j = int(first[best]), int(second[best])
        found.append((i, j, float(straight[best]), float(exchanged[best])))
        target[[i, j]] = target[[j, i]]
    return found


def wrong_markers(source: Float, target: Float) -> list[tuple[int, float, float]]:
    """Find markers far from their predictions, the most striking first: source, target ``(n, 3)``."""
    kept, found = np.arange(len(source)), []
    for _ in range(min(len(source) // 4, MOST_FOUND)):
        if len(kept) < FEWEST_COMPARED:
            break
        distances, surprises = Bending.of(source[kept]).left_out(target[kept])
        surprises = surprises / max(float(np.median(surprises)), np.finfo(float).tiny)
        wrong = (distances > FAR) & (surprises > SURPRISING)
        if not wrong.any():
            break
        worst = int(np.argmax(np.where(wrong, surprises, 0)))
        found.append((int(kept[worst]), float(distances[worst]), float(surprises[worst])))
        kept = np.delete(kept, worst)
    return found


def groups(points: Float) -> list[Index]:
    """Return the clusters of two or more points ``(n, 3)``, of all sizes, nested (Ward 1963)."""
    from scipy.cluster.hierarchy import linkage

    found = [np.array([point]) for point in range(len(points))]
    for first, second in linkage(points, "ward")[:, :2].astype(int):
        found.append(np.union1d(found[first], found[second]))
    return [group for group in found if 2 <= len(group) <= LARGEST_SHARE * len(points)]


def exchanged_groups(bending: Bending, source: Float, target: Float) -> tuple[Index, Index, float, float]:
    """Find the two groups whose exchange brings them closest to their predictions: source, target ``(n, 3)``."""
    matrix, force = bending.matrix, bending.matrix @ target
    best = np.zeros(0, np.int64), np.zeros(0, np.int64), 1.0, 1.0
    clusters = groups(source)
    inside = np.zeros((len(clusters), len(source)))
    for number, group in enumerate(clusters):
        inside[number, group] = 1
    apart_from = inside @ inside.T == 0
    for number, second in enumerate(clusters):
        for first in (clusters[other] for other in np.flatnonzero(apart_from[number, :number])):
            if max(len(first), len(second)) > ALIKE * min(len(first), len(second)):
                continue
            both = np.concatenate([first, second])
            try:
                off = np.linalg.solve(matrix[np.ix_(both, both)], force[both])
            except np.linalg.LinAlgError:  # the others are in a plane, and predict nothing
                continue
            one, two = off[: len(first)].mean(axis=0), off[len(first) :].mean(axis=0)
            apart = target[second].mean(axis=0) - target[first].mean(axis=0)
            straight = float(np.sqrt((one @ one + two @ two) / 2))
            one, two = one + apart, two - apart
            exchanged = float(np.sqrt((one @ one + two @ two) / 2))
            if exchanged * best[2] < best[3] * straight:
                best = first, second, straight, exchanged
    return best


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

MAX_NAMED_MARKERS = 6
"""Largest number of markers named in a message."""


@dataclass(frozen=True, eq=False)
class Suspicion:
    """Markers that do not fit the others."""

    marker_ids: Index  # (k,) the markers
    message: str  # the problem, and its cure


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
        _check_vertices(markers, side, vertices, len(points), topology)
    _check_pairs(markers)
    own, other = _used(source_points, source_topology), _used(target_points, target_topology)
    source = np.asarray(source_points[markers.source], np.float64)
    target = np.asarray(target_points[markers.target], np.float64)
    for side, chosen, points in (("source", source, own), ("target", target, other)):
        _check_spread(side, chosen, points)
    _check_hand(_normalised(source), _normalised(target))
    for each in suspicions(markers, source, target, float(np.linalg.norm(np.ptp(other, axis=0)))):
        _warn(each.message)


def check_rest(source: MeshSequence, rest: int) -> None:
    """Raise `SettingsError` if a source does not have the frame of the rest pose."""
    if not -source.frame_count <= rest < source.frame_count:
        raise SettingsError(
            f"the source has no frame {rest}; the rest pose is one of 0 ... {source.frame_count - 1}"
        )


def check_marker_vertices(markers: Markers, source: Topology, target: Topology) -> None:
    """Raise `SettingsError` for markers on missing vertices, or on vertices without triangles."""
    for side, vertices, topology in (("source", markers.source, source), ("target", markers.target, target)):
        _check_vertices(markers, side, vertices, topology.vertex_count, topology)


def suspicions(markers: Markers, source: Float, target: Float, diagonal: float) -> list[Suspicion]:
    """Find pairs, groups and single markers that seem exchanged or wrong: source, target ``(n, 3)``."""
    once = np.sort(np.unique(np.stack([markers.source, markers.target]), axis=1, return_index=True)[1])
    if not FEWEST_COMPARED <= len(once) <= MOST_COMPARED:
        return []
    unit = _size(target[once]) / diagonal
    return list(_compared(markers, once, _normalised(source[once]), _normalised(target[once]), unit))


def _check_vertices(
    markers: Markers, side: str, vertices: Index, count: int, topology: Topology | None
) -> None:
    """Raise for vertices that do not exist, or that no triangle uses."""
    outside = np.flatnonzero((vertices < 0) | (vertices >= count))
    if outside.size:
        message = (
            f"{_listed(markers, outside)}: the {side} has {count} vertices, 0 to {count - 1}; choose others, "
            "or see that source and target are not exchanged"
        )
        if vertices.max() == count and vertices.min() > 0:
            message += ", or subtract 1 from all: the file may count from 1"
        raise SettingsError(message)
    unused = np.flatnonzero(np.isin(vertices, () if topology is None else topology.unused_vertices))
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
    names = [markers.name(int(number)) for number in numbers[:MAX_NAMED_MARKERS]]
    more = f" and {len(numbers) - MAX_NAMED_MARKERS} more" if len(numbers) > MAX_NAMED_MARKERS else ""
    joined = " and ".join(names) if len(names) == 2 and not more else ", ".join(names)
    return f"marker{'s' if len(numbers) > 1 else ''} {joined}{more}"


def _warn(message: str) -> None:
    warnings.warn(message, MixseqWarning, stacklevel=5)
