r"""Check markers and meshes: raise errors for invalid markers and inverted meshes, warn of suspicious markers.

*Inside out?* Triangles of source and target must have the same orientation. A closed component encloses the volume
:math:`\frac16 \sum_t a_t \cdot (b_t \times c_t)`, negative if its triangles are clockwise seen from outside. The volume
of a component with holes depends on the origin; its sign is used if it is equal for all origins in the bounding
sphere. Other open surfaces are checked after registration, by the normals of closest points.

*Mirrored?* With centred sources X and targets Y and singular values :math:`\sigma` of :math:`X^T Y`, the relative
residual of the best similarity is :math:`1 - (\sigma_1 + \sigma_2 \pm \sigma_3)^2 / (\|X\|^2 \|Y\|^2)`. One sign holds
for rotations and the other for reflections (Umeyama 1991).

*Exchanged?* A thin-plate spline through all other markers predicts the targets of two markers. The two count as
exchanged if their exchanged targets are far closer to the predictions. The best pair is exchanged, and the search is
repeated. Groups of markers are compared in the same way, which finds exchanged legs: a spline without the markers of
both legs predicts the centres of the legs correctly. *Wrong?* A single marker is compared with its prediction.

Sources and targets are centred and scaled to a root mean square distance of 1. The smoothest map of space from
sources :math:`x_i` to targets :math:`y_i`, with a small slack :math:`\lambda`, has the bending energy (Duchon 1977; in
three dimensions the kernel is :math:`-\|x\|`)

.. math::
    E = \operatorname{tr} Y^T B\, Y, \qquad B = Z (Z^T K Z)^{-1} Z^T, \qquad
    K_{ij} = -\|x_i - x_j\| + \lambda \delta_{ij},

where the columns of Z are orthogonal to all affine functions of the :math:`x_i`. The predicted targets of a set S of
markers minimise the energy for fixed other markers,

.. math:: \hat y_S = y_S - (B_{SS})^{-1} (B Y)_S,

without another solve (Wahba 1990, chapter 4).

Correct markers were tested on horse and camel (107, 124 and 17 pairs) and on cat and lion (55). Exchanges multiply the
distance from the predictions by at least 0.57 for two markers, and by 1.08 for two groups. All markers are within 0.35
of their predictions. Of single exchanged pairs of a left and a right leg 99 % are found, without false alarms. Of three
exchanged pairs at a time 95 % are found (fewer among 17 markers).
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
from mixseq.types import Float, FloatArray, Index

MIN_VOLUME_RATIO = 1e-9  # volume of a component, relative to its cubed diagonal; smaller volumes are rounding errors
MAX_NAMED_COMPONENTS = 4  # largest number of components named in a message

_FLIP_ADVICE = "turn its triangles over (faces[:, ::-1]; in a modelling program: flip the normals)"


@dataclass(frozen=True, eq=False)
class Orientation:
    """Orientation of the components of a mesh."""

    faces: Index  # (c,) first triangle of every component
    areas: Float  # (c,) areas of the components
    signs: Index  # (c,) 1 if triangles are counter-clockwise seen from outside, -1 if clockwise, 0 if open

    @property
    def sign(self) -> int:
        """Orientation of the larger part of the area of all closed components: 1, -1, or 0 without any."""
        return int(np.sign(self.areas @ self.signs))


def find_orientation(mesh: TriangleMesh) -> Orientation:
    """Find the orientation of the components of a mesh."""
    component_of_face = mesh.topology.component_of_face
    count = int(component_of_face.max(initial=-1)) + 1
    corners = mesh.points[mesh.faces]
    lower_bounds, upper_bounds = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(lower_bounds, component_of_face, corners.min(axis=1))
    np.maximum.at(upper_bounds, component_of_face, corners.max(axis=1))
    # The origin is the centre of each bounding box, which reduces rounding errors.
    a, b, c = np.moveaxis(corners - ((lower_bounds + upper_bounds) / 2)[component_of_face, None], 1, 0)
    volumes = np.bincount(component_of_face, np.einsum("fi,fi->f", a, np.cross(b, c)) / 6, count)
    vector_areas = [np.bincount(component_of_face, mesh.vector_areas[:, axis], count) for axis in range(3)]
    diagonals = np.linalg.norm(upper_bounds - lower_bounds, axis=1)
    uncertainty = np.linalg.norm(vector_areas, axis=0) * diagonals / 6 + MIN_VOLUME_RATIO * diagonals**3
    signs = np.where(np.abs(volumes) > uncertainty, np.sign(volumes), 0).astype(np.int64)
    first_faces = np.unique(component_of_face, return_index=True)[1]
    areas = np.bincount(component_of_face, mesh.face_areas, count).astype(np.float64)
    return Orientation(first_faces, areas, signs)


def check_orientation(source: TriangleMesh, target: TriangleMesh) -> None:
    """Raise if either of two closed meshes is inside out, and warn of inverted components of the target."""
    source_sign, orientation = find_orientation(source).sign, find_orientation(target)
    if source_sign * orientation.sign == -1:
        side = "target" if orientation.sign < 0 else "source"
        raise SettingsError(f"the {side} is inside out, its volume is negative; {_FLIP_ADVICE}")
    inverted = orientation.faces[orientation.signs * orientation.sign == -1]
    if inverted.size:
        names = ", ".join(f"that of triangle {face}" for face in inverted[:MAX_NAMED_COMPONENTS])
        more = len(inverted) - MAX_NAMED_COMPONENTS
        suffix = f" and {more} more" if more > 0 else ""
        warnings.warn(
            f"{len(inverted)} of {len(orientation.faces)} components of the target are inside out ({names}{suffix}); "
            "flip their normals, unless they are cavities",
            MixseqWarning,
            stacklevel=2,
        )


def check_facing(registered: TriangleMesh, target: TriangleMesh) -> None:
    """Raise if most of the target's area faces away from the registered source, unless both meshes are closed."""
    from mixseq.mesh.nearest import ClosestPointQuery

    if find_orientation(registered).sign * find_orientation(target).sign != 0:
        return  # `check_orientation` checks two closed meshes
    closest = ClosestPointQuery.from_mesh(registered.points, registered.faces).query(target.centroids)
    is_opposite = np.einsum("fi,fi->f", registered.face_normals[closest.faces], target.face_normals) < 0
    share = float(target.face_areas[is_opposite].sum() / max(target.face_areas.sum(), np.finfo(float).tiny))
    if share > 0.5:
        raise SettingsError(
            f"{100 * share:.0f} % of the target's area faces away from the source that was fitted to it: one of them "
            f"is inside out; of the target, {_FLIP_ADVICE}"
        )


SPLINE_SLACK = 0.05  # slack lambda, in root mean square distances; results hardly change from 0 to 0.2
_MIN_SUPPORT_RATIO = 1e-9  # smallest diagonal entry of B for a prediction, relative to the mean entry
MIN_COMPARED_MARKERS = 8  # smallest number of markers that are compared with each other
MAX_EXCHANGED_DISTANCE_RATIO = 0.5  # largest ratio of distances from predictions, exchanged to unchanged
MIN_EXCHANGED_DISTANCE_MEDIANS = 2.5  # smallest distance before the exchange, in medians of all markers
MIN_WRONG_MARKER_DISTANCE = 0.5  # smallest distance from the prediction, in root mean square distances
MIN_WRONG_MARKER_SURPRISE = 5.0  # smallest surprise of a wrong marker, in medians of all markers
MAX_REPORTED_MARKERS = 20  # largest number of reported exchanges, and of reported wrong markers
ROUNDING_DISTANCE = 1e-6  # largest rounding error of a distance, in root mean square distances from the centre
MAX_GROUP_MARKER_SHARE = 0.25  # largest number of markers in a group, relative to all markers
MAX_GROUP_SIZE_RATIO = 2.5  # largest ratio of the sizes of two exchanged groups


@dataclass(frozen=True, eq=False)
class BendingEnergy:
    """Bending energy of thin-plate splines through fixed source points."""

    matrix: Float  # (n, n) matrix B of the module's formulas

    @classmethod
    def from_points(cls, sources: Float, slack: float = SPLINE_SLACK) -> Self:
        """Compute the energy matrix of more than four source points ``(n, 3)``."""
        kernel = -np.linalg.norm(sources[:, None] - sources, axis=2) + slack * np.eye(len(sources))
        affine = np.column_stack([np.ones(len(sources)), sources])
        complement = np.linalg.qr(affine, mode="complete")[0][:, 4:]
        return cls(np.asarray(complement @ np.linalg.solve(complement.T @ kernel @ complement, complement.T)))

    def leave_one_out(self, targets: Float) -> tuple[Float, Float]:
        """Return distances ``(n,)`` of targets ``(n, 3)`` from leave-one-out predictions, and surprises ``(n,)``."""
        forces = np.linalg.norm(self.matrix @ targets, axis=1)
        diagonal = np.diag(self.matrix)
        is_supported = diagonal > _MIN_SUPPORT_RATIO * diagonal.mean()
        diagonal = np.where(is_supported, diagonal, 1.0)
        distances = np.where(is_supported, forces / diagonal, 0.0)
        return distances, np.where(is_supported, forces / np.sqrt(diagonal), 0.0)

    def leave_pairs_out(self, targets: Float) -> tuple[Index, Index, Float, Float]:
        """Predict the targets ``(n, 3)`` of every pair of markers from all markers outside the pair.

        Return the first and second markers ``(m,)`` of the pairs, and their root mean square distances ``(m,)`` from
        the predictions before and after an exchange.
        """
        forces, diagonal = self.matrix @ targets, np.diag(self.matrix)
        i, j = np.triu_indices(len(targets), 1)
        off_diagonal = self.matrix[i, j]
        determinant = diagonal[i] * diagonal[j] - off_diagonal**2
        is_supported = determinant > (_MIN_SUPPORT_RATIO * diagonal.mean()) ** 2
        i, j = i[is_supported], j[is_supported]
        off_diagonal, determinant = off_diagonal[is_supported, None], determinant[is_supported, None]
        error_i = (diagonal[j, None] * forces[i] - off_diagonal * forces[j]) / determinant
        error_j = (diagonal[i, None] * forces[j] - off_diagonal * forces[i]) / determinant
        exchange = targets[j] - targets[i]
        return i, j, _rms_distance(error_i, error_j), _rms_distance(error_i + exchange, error_j - exchange)


def _rms_distance(a: Float, b: Float) -> Float:
    return np.asarray(np.sqrt(((a**2).sum(axis=1) + (b**2).sum(axis=1)) / 2))


def _min_exchanged_distance(bending: BendingEnergy, target: Float) -> float:
    """Return the smallest distance from its prediction at which a marker may count as exchanged."""
    median_distance = float(np.median(bending.leave_one_out(target)[0]))
    return max(MIN_EXCHANGED_DISTANCE_MEDIANS * median_distance, ROUNDING_DISTANCE)


def find_exchanged_pairs(bending: BendingEnergy, target: Float) -> list[tuple[int, int, float, float]]:
    """Find pairs of exchanged targets ``(n, 3)``, the clearest first, with distances before and after the exchange."""
    target, pairs = target.copy(), []
    for _ in range(min(len(target) // 4, MAX_REPORTED_MARKERS)):
        first, second, unchanged, exchanged = bending.leave_pairs_out(target)
        is_exchanged = exchanged < MAX_EXCHANGED_DISTANCE_RATIO * unchanged
        is_exchanged &= unchanged > _min_exchanged_distance(bending, target)
        if not is_exchanged.any():
            break
        ratios = exchanged / np.where(is_exchanged, unchanged, np.inf)
        best = int(np.argmin(np.where(is_exchanged, ratios, np.inf)))
        i, j = int(first[best]), int(second[best])
        pairs.append((i, j, float(unchanged[best]), float(exchanged[best])))
        target[[i, j]] = target[[j, i]]
    return pairs


def find_wrong_markers(source: Float, target: Float) -> list[tuple[int, float, float]]:
    """Find markers far from their predictions, the most surprising first: source, target ``(n, 3)``."""
    remaining, wrong_markers = np.arange(len(source)), []
    for _ in range(min(len(source) // 4, MAX_REPORTED_MARKERS)):
        if len(remaining) < MIN_COMPARED_MARKERS:
            break
        distances, surprises = BendingEnergy.from_points(source[remaining]).leave_one_out(target[remaining])
        surprises = surprises / max(float(np.median(surprises)), np.finfo(float).tiny)
        is_wrong = (distances > MIN_WRONG_MARKER_DISTANCE) & (surprises > MIN_WRONG_MARKER_SURPRISE)
        if not is_wrong.any():
            break
        worst = int(np.argmax(np.where(is_wrong, surprises, 0)))
        wrong_markers.append((int(remaining[worst]), float(distances[worst]), float(surprises[worst])))
        remaining = np.delete(remaining, worst)
    return sorted(wrong_markers, key=lambda marker: -marker[2])


def cluster_markers(points: Float) -> list[Index]:
    """Return nested clusters (Ward 1963) of points ``(n, 3)``, from two points to the largest group size."""
    from scipy.cluster.hierarchy import linkage

    clusters = [np.array([point]) for point in range(len(points))]
    for first, second in linkage(points, "ward")[:, :2].astype(int):
        clusters.append(np.union1d(clusters[first], clusters[second]))
    return [group for group in clusters if 2 <= len(group) <= MAX_GROUP_MARKER_SHARE * len(points)]


def find_exchanged_groups(bending: BendingEnergy, source: Float, target: Float) -> tuple[Index, Index, float, float]:
    """Find the two groups with the smallest distance ratio after to before an exchange: source, target ``(n, 3)``."""
    matrix, forces = bending.matrix, bending.matrix @ target
    best = np.zeros(0, np.int64), np.zeros(0, np.int64), 1.0, 1.0
    clusters = cluster_markers(source)
    membership = np.zeros((len(clusters), len(source)))
    for index, group in enumerate(clusters):
        membership[index, group] = 1
    is_disjoint = membership @ membership.T == 0
    for index, second in enumerate(clusters):
        for first in (clusters[other] for other in np.flatnonzero(is_disjoint[index, :index])):
            if max(len(first), len(second)) > MAX_GROUP_SIZE_RATIO * min(len(first), len(second)):
                continue
            marker_ids = np.concatenate([first, second])
            try:
                errors = np.linalg.solve(matrix[np.ix_(marker_ids, marker_ids)], forces[marker_ids])
            except np.linalg.LinAlgError:  # all markers outside both groups are in a plane
                continue
            first_error, second_error = errors[: len(first)].mean(axis=0), errors[len(first) :].mean(axis=0)
            exchange = target[second].mean(axis=0) - target[first].mean(axis=0)
            unchanged = float(np.sqrt((first_error @ first_error + second_error @ second_error) / 2))
            first_error, second_error = first_error + exchange, second_error - exchange
            exchanged = float(np.sqrt((first_error @ first_error + second_error @ second_error) / 2))
            if exchanged * best[2] < best[3] * unchanged:
                best = first, second, unchanged, exchanged
    return best


MIN_MARKERS = 4  # smallest number of markers: four determine an affine map
FLAT_EXTENT_RATIO = 0.01  # largest ratio of extents of markers on a line or a plane
MAX_MIRRORED_RESIDUAL_RATIO = 0.5  # largest ratio of residuals of mirrored markers, reflection to rotation
MIN_ROTATION_RESIDUAL = 0.01  # smallest residual of a rotation of mirrored markers; flat markers have smaller ones
MAX_COMPARED_MARKERS = 1000  # largest number of markers that are compared with each other
MAX_EXCHANGED_GROUP_DISTANCE_RATIO = 0.7  # largest ratio of distances from predictions, exchanged to unchanged
MAX_GROUPED_MARKERS = 200  # largest number of markers that are grouped
MAX_NAMED_MARKERS = 6  # largest number of markers named in a message


@dataclass(frozen=True, eq=False)
class Suspicion:
    """Markers that are inconsistent with the remaining markers."""

    marker_ids: Index  # (k,) ids of the inconsistent markers
    message: str  # problem and cure


def check_markers(
    markers: Markers,
    source_points: FloatArray,
    target_points: FloatArray,
    source_topology: Topology | None = None,
    target_topology: Topology | None = None,
) -> None:
    """Raise for invalid markers, and warn of suspicious markers: points ``(V, 3)`` and ``(V', 3)``."""
    distinct_count = len(_distinct_markers(markers))
    if distinct_count < MIN_MARKERS:
        suffix = f" that differ, of {len(markers)}" if distinct_count < len(markers) else ""
        raise SettingsError(
            f"there are {distinct_count} markers{suffix}; at least {MIN_MARKERS} that are on no plane are needed"
        )
    for side, vertices, points, topology in (
        ("source", markers.source, source_points, source_topology),
        ("target", markers.target, target_points, target_topology),
    ):
        _check_vertices(markers, side, vertices, len(points), topology)
    _check_pairs(markers)
    source = np.asarray(source_points[markers.source], np.float64)
    target = np.asarray(target_points[markers.target], np.float64)
    used_target_points = _used_points(target_points, target_topology)
    _check_spread("source", source, _used_points(source_points, source_topology))
    _check_spread("target", target, used_target_points)
    _check_hand(_normalise_points(source), _normalise_points(target))
    diagonal = float(np.linalg.norm(np.ptp(used_target_points, axis=0)))
    for suspicion in find_suspicious_markers(markers, source, target, diagonal):
        _warn(suspicion.message)


def check_rest_frame(source: MeshSequence, rest: int) -> None:
    """Raise if the source has no frame with the index `rest`."""
    if not -source.frame_count <= rest < source.frame_count:
        raise SettingsError(f"the source has no frame {rest}; the rest pose is one of 0 ... {source.frame_count - 1}")


def check_marker_vertices(markers: Markers, source: Topology, target: Topology) -> None:
    """Raise for markers on missing vertices, or on vertices without triangles."""
    for side, vertices, topology in (("source", markers.source, source), ("target", markers.target, target)):
        _check_vertices(markers, side, vertices, topology.vertex_count, topology)


def find_suspicious_markers(markers: Markers, source: Float, target: Float, diagonal: float) -> list[Suspicion]:
    """Find pairs, groups and single markers that seem exchanged or wrong: source, target ``(n, 3)``."""
    distinct = _distinct_markers(markers)
    if not MIN_COMPARED_MARKERS <= len(distinct) <= MAX_COMPARED_MARKERS:
        return []
    unit = _rms_radius(target[distinct]) / diagonal
    source, target = _normalise_points(source[distinct]), _normalise_points(target[distinct])
    return list(_compare_markers(markers, distinct, source, target, unit))


def _distinct_markers(markers: Markers) -> Index:
    """Return the ids ``(m,)`` of the markers without repetitions of the same pair."""
    pairs = np.stack([markers.source, markers.target])
    return np.sort(np.unique(pairs, axis=1, return_index=True)[1])


def _check_vertices(markers: Markers, side: str, vertices: Index, count: int, topology: Topology | None) -> None:
    """Raise for missing vertices, and for vertices without triangles."""
    outside = np.flatnonzero((vertices < 0) | (vertices >= count))
    if outside.size:
        message = (
            f"{_marker_list(markers, outside)}: the {side} has {count} vertices, 0 to {count - 1}; choose others, "
            "or check that source and target are not exchanged"
        )
        if vertices.max() == count and vertices.min() > 0:
            message += ", or subtract 1 from all: the file may count from 1"
        raise SettingsError(message)
    unused = np.flatnonzero(np.isin(vertices, () if topology is None else topology.unused_vertices))
    if unused.size:
        raise SettingsError(
            f"{_marker_list(markers, unused)}: no triangle of the {side} uses the vertex; choose others nearby"
        )


def _check_pairs(markers: Markers) -> None:
    """Raise if a vertex is paired with two different vertices; repetitions of a pair are allowed."""
    for side, other_side, vertices, partners in (
        ("source", "targets", markers.source, markers.target),
        ("target", "sources", markers.target, markers.source),
    ):
        order = np.lexsort((partners, vertices))
        conflicts = np.flatnonzero((np.diff(vertices[order]) == 0) & (np.diff(partners[order]) != 0))
        if conflicts.size:
            rows = np.sort(order[conflicts[0] : conflicts[0] + 2])
            raise SettingsError(
                f"{_marker_list(markers, rows)} give vertex {vertices[rows[0]]} of the {side} two {other_side}; "
                "leave one out"
            )


def _check_spread(side: str, marked: Float, points: Float) -> None:
    """Raise if all markers are on a line, and warn if they are on a plane but the mesh is not."""
    centre = marked.mean(axis=0)
    _, extents, axes = np.linalg.svd(marked - centre, full_matrices=False)
    if extents[1] <= FLAT_EXTENT_RATIO * extents[0]:
        raise SettingsError(
            f"all markers of the {side} are on one line, which leaves the turn about it open; add some beside it"
        )
    depth = np.abs((points - centre) @ axes[2]).max()
    if extents[2] <= FLAT_EXTENT_RATIO * extents[0] and depth > FLAT_EXTENT_RATIO * np.ptp(points, axis=0).max():
        _warn(f"all markers of the {side} are on one plane, which leaves its two sides open; add some beside it")


def _check_hand(source: Float, target: Float) -> None:
    """Raise if normalised markers ``(n, 3)`` fit a reflection far better than a rotation."""
    s = np.linalg.svd(source.T @ target, compute_uv=False) / len(source)
    rotation_sign = np.sign(np.linalg.det(source.T @ target))
    rotated, reflected = (1 - (s[0] + s[1] + sign * s[2]) ** 2 for sign in (rotation_sign, -rotation_sign))
    if rotated > MIN_ROTATION_RESIDUAL and reflected < MAX_MIRRORED_RESIDUAL_RATIO * rotated:
        raise SettingsError(
            f"left and right are exchanged in all markers, or one mesh is mirrored: the best rotation leaves "
            f"{100 * rotated:.0f} % of the squared distances, the best reflection {100 * reflected:.0f} %; "
            "exchange left and right, or mirror one mesh (and flip its normals)"
        )


def _compare_markers(
    markers: Markers, marker_ids: Index, source: Float, target: Float, unit: float
) -> Iterator[Suspicion]:
    """Yield suspicions about markers; `unit` converts normalised distances to diagonals of the target."""
    bending = BendingEnergy.from_points(source)
    for i, j, unchanged, exchanged in find_exchanged_pairs(bending, target):
        target[[i, j]] = target[[j, i]]
        yield Suspicion(
            marker_ids[[i, j]],
            f"{_marker_list(markers, marker_ids[[i, j]])} seem exchanged: their targets are "
            f"{100 * unit * unchanged:.1f} % of the diagonal away from where the other markers predict them, and "
            f"{100 * unit * exchanged:.1f} % if they are exchanged; exchange the two targets if they are wrong",
        )
    if len(source) <= MAX_GROUPED_MARKERS:
        first, second, unchanged, exchanged = find_exchanged_groups(bending, source, target)
        is_exchanged = exchanged < MAX_EXCHANGED_GROUP_DISTANCE_RATIO * unchanged
        if is_exchanged and unchanged > _min_exchanged_distance(bending, target):
            yield Suspicion(
                marker_ids[np.concatenate([first, second])],
                f"{_marker_list(markers, marker_ids[first])} seem exchanged with "
                f"{_marker_list(markers, marker_ids[second])}, left for right: the centres of their targets are "
                f"{100 * unit * unchanged:.0f} % of the diagonal away from where the other markers predict them, and "
                f"{100 * unit * exchanged:.0f} % if they are exchanged; check all markers there",
            )
            return
    for i, distance, surprise in find_wrong_markers(source, target):
        yield Suspicion(
            marker_ids[[i]],
            f"{_marker_list(markers, marker_ids[[i]])} seems wrong: its target is {100 * unit * distance:.0f} % of the "
            f"diagonal away from where the other markers predict it ({surprise:.0f} times the median surprise); "
            "check it, or leave it out",
        )


def _used_points(points: FloatArray, topology: Topology | None) -> Float:
    """Return the points that are used by triangles, or all points if no topology is given."""
    used_points = points if topology is None else np.delete(points, topology.unused_vertices, axis=0)
    return np.asarray(used_points, np.float64)


def _normalise_points(points: Float) -> Float:
    return np.asarray((points - points.mean(axis=0)) / _rms_radius(points))


def _rms_radius(points: Float) -> float:
    """Return the root mean square distance of points from their centroid."""
    centred = points - points.mean(axis=0)
    return max(float(np.sqrt((centred**2).sum(axis=1).mean())), np.finfo(float).tiny)


def _marker_list(markers: Markers, marker_ids: Index) -> str:
    names = [markers.name(int(marker)) for marker in marker_ids[:MAX_NAMED_MARKERS]]
    suffix = f" and {len(marker_ids) - MAX_NAMED_MARKERS} more" if len(marker_ids) > MAX_NAMED_MARKERS else ""
    listed = " and ".join(names) if len(names) == 2 and not suffix else ", ".join(names)
    return f"marker{'s' if len(marker_ids) > 1 else ''} {listed}{suffix}"


def _warn(message: str) -> None:
    warnings.warn(message, MixseqWarning, stacklevel=5)
