r"""Check markers and meshes: raise errors for invalid markers and inverted meshes, warn of suspicious markers.

*Inside out?* Triangles of source and target must have the same orientation. A closed component encloses the volume
:math:`\frac16 \sum_t a_t \cdot (b_t \times c_t)`, negative if its triangles are clockwise seen from outside. The volume
of a component with holes depends on the origin; its sign is used if it is equal for all origins in the bounding
sphere. Other open surfaces are checked after registration, by the normals of closest points.

*Mirrored?* With centred sources X and targets Y and singular values :math:`\sigma` of :math:`X^T Y`, the relative
residual of the best similarity is :math:`1 - (\sigma_1 + \sigma_2 \pm \sigma_3)^2 / (\|X\|^2 \|Y\|^2)`. One sign holds
for rotations and the other for reflections (Umeyama 1991).

*Exchanged or wrong?* Markers are centred, scaled to a root mean square distance of 1, and turned by a rotation that
fits most of them (iteratively reweighted). Two markers are in conflict if the directions from one to the other on the
two meshes are more than 90 degrees apart, or if their distances are far too different. The marker with the most
conflicts is exchanged with the one that leaves the fewest conflicts of both, or is wrong if none does. It is corrected
or left out, and the search is repeated. Poses at rest that differ much cause conflicts, too.

Limits were chosen on markers of horse and camel (17, 42, 107 and 124 pairs), wolf and horse (25). Of nine other pairs
of bodies (cats, lions, humans, foxes, stag; 18 to 55 markers) no correct set is suspected. Of 25 sets with markers of
limbs exchanged left for right 23 are, and all 18 with one marker elsewhere or two exchanged.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.markers import Markers
from mixseq.types import Float, Index, Mask

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


def check_orientation(source: TriangleMesh, target: TriangleMesh) -> bool:
    """Raise if either of two closed meshes is inside out, and warn of inverted components of the target.

    Return whether both meshes are closed.
    """
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
    return source_sign * orientation.sign != 0


def check_facing(registered: TriangleMesh, target: TriangleMesh) -> None:
    """Raise if most of the target's area faces away from the registered source."""
    from mixseq.mesh.nearest import ClosestPointQuery

    closest = ClosestPointQuery.from_mesh(registered.points, registered.faces).query(target.centroids)
    is_opposite = np.einsum("fi,fi->f", registered.face_normals[closest.faces], target.face_normals) < 0
    share = float(target.face_areas[is_opposite].sum() / max(target.face_areas.sum(), np.finfo(float).tiny))
    if share > 0.5:
        raise SettingsError(
            f"{100 * share:.0f} % of the target's area faces away from the source that was fitted to it: one of them "
            f"is inside out; of the target, {_FLIP_ADVICE}"
        )


MIN_MARKERS = 4  # smallest number of markers: four determine an affine map
FLAT_EXTENT_RATIO = 0.01  # largest ratio of extents of markers on a line or a plane
MAX_MIRRORED_RESIDUAL_RATIO = 0.5  # largest ratio of residuals of mirrored markers, reflection to rotation
MIN_ROTATION_RESIDUAL = 0.01  # smallest residual of a rotation of mirrored markers; flat markers have smaller ones
MAX_COMPARED_MARKERS = 1000  # largest number of markers that are compared with each other
MIN_COMPARED_MARKERS = 8  # smallest number of markers that are compared with each other
MAX_REPORTED_MARKERS = 20  # largest number of reported exchanges and wrong markers
MIN_DIRECTION_DISTANCE = 0.16  # smallest distance of markers with a direction, in root mean square distances
MAX_DISTANCE_RATIO, MIN_RATIO_DISTANCE = 6.0, 0.3  # largest ratio of distances, if the larger one is above the second
MAX_REMAINING_CONFLICTS = 1 / 3  # largest share of the conflicts of two markers that an exchange leaves
MIN_PARTNER_CONFLICTS = 0.4  # smallest number of conflicts of its partner, relative to those of the worst marker
MIN_RESOLVED_CONFLICTS = 0.8  # smallest number of conflicts that an exchange resolves, relative to those of the worst
MIN_CONFLICT_SHARE = 0.1  # smallest share of all markers with which a single wrong marker is in conflict
ROTATION_STEPS = 5  # number of reweighted fits of the rotation
MAX_NAMED_MARKERS = 6  # largest number of markers named in a message


@dataclass(frozen=True, eq=False)
class Suspicion:
    """Markers that are inconsistent with the remaining markers."""

    marker_ids: Index  # (k,) ids of the inconsistent markers
    message: str  # problem and cure


def check_markers(markers: Markers, source: TriangleMesh, target: TriangleMesh) -> None:
    """Raise for invalid markers, and warn of suspicious markers."""
    distinct_count = len(_distinct_markers(markers))
    if distinct_count < MIN_MARKERS:
        suffix = f" that differ, of {len(markers)}" if distinct_count < len(markers) else ""
        raise SettingsError(
            f"there are {distinct_count} markers{suffix}; at least {MIN_MARKERS} that are on no plane are needed"
        )
    check_marker_vertices(markers, source.topology, target.topology)
    _check_pairs(markers)
    x, y = source.points[markers.source], target.points[markers.target]
    for side, mesh, marked in (("source", source, x), ("target", target, y)):
        _check_spread(side, marked, np.delete(mesh.points, mesh.topology.unused_vertices, axis=0))
    _check_hand(normalise_points(x), normalise_points(y))
    for suspicion in find_suspicious_markers(markers, x, y):
        _warn(suspicion.message)


def check_marker_vertices(markers: Markers, source: Topology, target: Topology) -> None:
    """Raise for markers on missing vertices, or on vertices without triangles."""
    for side, vertices, topology in (("source", markers.source, source), ("target", markers.target, target)):
        count = topology.vertex_count
        outside = np.flatnonzero((vertices < 0) | (vertices >= count))
        if outside.size:
            message = (
                f"{_marker_list(markers, outside)}: the {side} has {count} vertices, 0 to {count - 1}; choose others, "
                "or check that source and target are not exchanged"
            )
            if vertices.max() == count and vertices.min() > 0:
                message += ", or subtract 1 from all: the file may count from 1"
            raise SettingsError(message)
        unused = np.flatnonzero(np.isin(vertices, topology.unused_vertices))
        if unused.size:
            raise SettingsError(
                f"{_marker_list(markers, unused)}: no triangle of the {side} uses the vertex; choose others nearby"
            )


def find_suspicious_markers(markers: Markers, source: Float, target: Float) -> list[Suspicion]:
    """Find markers that seem exchanged or wrong: source, target ``(n, 3)``."""
    ids = _distinct_markers(markers)
    if not MIN_COMPARED_MARKERS <= len(ids) <= MAX_COMPARED_MARKERS:
        return []
    x, y = source[ids], target[ids]
    wrong: list[int] = []
    exchanges: list[list[int]] = []
    for _ in range(MAX_REPORTED_MARKERS):
        x, y = normalise_points(x), normalise_points(y)
        turned = x @ fit_most_points(x, y).T
        is_conflict = find_conflicts(turned, y, np.arange(len(x)))
        counts = is_conflict.sum(axis=1)
        worst = int(counts.argmax())
        if len(x) < MIN_COMPARED_MARKERS or not counts[worst]:
            break
        partner, resolved = _best_exchange(turned, y, worst, is_conflict)
        if resolved >= MIN_RESOLVED_CONFLICTS * counts[worst]:
            exchanges.append(ids[[worst, partner]].tolist())
            y[[worst, partner]] = y[[partner, worst]]
            continue
        is_single = counts[worst] >= max(2, MIN_CONFLICT_SHARE * len(x))
        rows = [worst] if is_single else [worst, int(is_conflict[worst].argmax())]
        wrong += ids[rows].tolist()
        ids, x, y = np.delete(ids, rows), np.delete(x, rows, axis=0), np.delete(y, rows, axis=0)
    suspicions = []
    if exchanges:
        first, second = (np.array(list(dict.fromkeys(column))) for column in zip(*exchanges, strict=True))
        names = f"{_marker_list(markers, first)} and {_marker_list(markers, second)}"
        message = f"{names} seem exchanged: directions between them are reversed on the target; exchange their targets"
        suspicions.append(Suspicion(np.array(exchanges).reshape(-1), f"{message}, or give rest poses that are alike"))
    if wrong:
        message = f"{_marker_list(markers, np.array(wrong))} seem{'s' * (len(wrong) == 1)} wrong: other markers lie"
        suspicions.append(
            Suspicion(np.array(wrong), f"{message} elsewhere from there on the target; check, or leave out")
        )
    return suspicions


def find_conflicts(source: Float, target: Float, rows: Index) -> Mask:
    """Return whether markers ``(k,)`` are in conflict ``(k, n)`` with others: turned source, target ``(n, 3)``."""
    a, b = source[rows, None] - source, target[rows, None] - target
    lengths = np.stack([np.linalg.norm(a, axis=2), np.linalg.norm(b, axis=2)])
    shorter, longer = lengths.min(axis=0), lengths.max(axis=0)
    is_reversed = (shorter > MIN_DIRECTION_DISTANCE) & ((a * b).sum(axis=2) < 0)
    return np.asarray(is_reversed | ((longer > MIN_RATIO_DISTANCE) & (longer > MAX_DISTANCE_RATIO * shorter)))


def fit_most_points(source: Float, target: Float) -> Float:
    """Return a rotation ``(3, 3)`` of source points ``(n, 3)`` to target points, robust against outliers."""
    rotation, weights = np.eye(3), np.ones(len(source))
    for _ in range(ROTATION_STEPS):
        weights = weights / weights.sum()
        x, y = source - weights @ source, target - weights @ target
        rotation, _ = kabsch(x, y, weights)
        distances = np.linalg.norm(x @ rotation.T - y, axis=1)
        weights = 1 / (distances + np.median(distances) + 1e-9)
    return rotation


def _best_exchange(source: Float, target: Float, worst: int, is_conflict: Mask) -> tuple[int, int]:
    """Return the partner of a marker whose exchange resolves the most conflicts of both, and how many; 0 if few."""
    best, counts = (worst, 0), is_conflict.sum(axis=1)
    for partner in np.flatnonzero(is_conflict[worst]).tolist():
        rows = np.array([worst, partner])
        exchanged = target.copy()
        exchanged[rows] = target[rows[::-1]]
        before, after = int(counts[rows].sum()), int(find_conflicts(source, exchanged, rows).sum())
        is_alike = counts[partner] >= MIN_PARTNER_CONFLICTS * counts[worst]
        if is_alike and after <= MAX_REMAINING_CONFLICTS * before and before - after > best[1]:
            best = partner, before - after
    return best


def _distinct_markers(markers: Markers) -> Index:
    """Return the ids ``(m,)`` of the markers without repetitions of the same pair."""
    pairs = np.stack([markers.source, markers.target])
    return np.sort(np.unique(pairs, axis=1, return_index=True)[1])


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


def normalise_points(points: Float) -> Float:
    """Centre points ``(n, 3)``, and scale them to a root mean square distance of 1."""
    centred = points - points.mean(axis=0)
    return np.asarray(centred / max(float(np.sqrt((centred**2).sum(axis=1).mean())), np.finfo(float).tiny))


def _marker_list(markers: Markers, marker_ids: Index) -> str:
    names = [markers.name(int(marker)) for marker in marker_ids[:MAX_NAMED_MARKERS]]
    suffix = f" and {len(marker_ids) - MAX_NAMED_MARKERS} more" if len(marker_ids) > MAX_NAMED_MARKERS else ""
    listed = " and ".join(names) if len(names) == 2 and not suffix else ", ".join(names)
    return f"marker{'s' if len(marker_ids) > 1 else ''} {listed}{suffix}"


def _warn(message: str) -> None:
    warnings.warn(message, MixseqWarning, stacklevel=5)
