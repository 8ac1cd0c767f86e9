r"""Refuse meshes that are inside out: the triangles of source and target must run around the outside the same way.

A closed component encloses the volume :math:`\frac16 \sum_t a_t \cdot (b_t \times c_t)`, negative if its triangles run
clockwise seen from outside. Holes make it depend on the origin, by the sum of the vector areas: the sign of a component
counts if it is the same for all origins in its bounding sphere. Surfaces that are more open have no outside of their
own; of these a registration tells, by the normals of what is closest.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.topology import Topology

NO_VOLUME = 1e-9
"""Volumes below this share of a component's cubed diagonal are rounding; ours."""

NAMED = 4
"""Most components that a message names."""

_CURE = "turn its triangles over (faces[:, ::-1]; in a modelling program: flip the normals)"


@dataclass(frozen=True, eq=False)
class Orientation:
    """Which way components face."""

    faces: Index  # (c,) a triangle of every component
    areas: Float  # (c,) their areas
    # (c,) 1 if the triangles are counter-clockwise seen from outside, -1 if clockwise, 0 if there is no outside.
    signs: Index

    @property
    def sign(self) -> int:
        """The way that most of the area faces, of that which has an outside."""
        return int(np.sign(self.areas @ self.signs))


def orientation(points: FloatArray, faces: IntArray) -> Orientation:
    """Find which way the components of a mesh of points ``(V, 3)`` and triangles ``(F, 3)`` face."""
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
    """Refuse meshes of which one is inside out, as far as they have an outside.

    Shapes: source_points, target_points ``(V, 3)``; source_faces, target_faces ``(F, 3)``.
    """
    source, target = orientation(source_points, source_faces), orientation(target_points, target_faces)
    if source.sign * target.sign == -1:
        which = "target" if target.sign < 0 else "source"
        raise SettingsError(f"the {which} is inside out, its volume is negative; {_CURE}")
    turned = np.flatnonzero(target.signs * target.sign == -1)
    if turned.size:
        named = ", ".join(f"that of triangle {target.faces[number]}" for number in turned[:NAMED])
        more = f" and {len(turned) - NAMED} more" if len(turned) > NAMED else ""
        warnings.warn(
            f"{len(turned)} of {len(target.faces)} components of the target are inside out ({named}{more}); "
            "turn their triangles over if they are no cavities",
            MixseqWarning,
            stacklevel=2,
        )


def check_facing(
    registered: FloatArray, source_faces: IntArray, target_points: FloatArray, target_faces: IntArray
) -> None:
    """Refuse a target that faces away from the source that was fitted to it, where one of them has no outside.

    Shapes: registered ``(V, 3)``; source_faces ``(F, 3)``; target_points, target_faces ``(V', 3)``.
    """
    if orientation(registered, source_faces).sign * orientation(target_points, target_faces).sign != 0:
        return  # `check_orientation` knows better
    share = _against(registered, source_faces, target_points, target_faces)
    if share > 0.5:
        raise SettingsError(
            f"{100 * share:.0f} % of the target's area faces away from the source that was fitted to it: one of them "
            f"is inside out; of the target, {_CURE}"
        )


def _against(
    registered: FloatArray, source_faces: IntArray, target_points: FloatArray, target_faces: IntArray
) -> float:
    """Share of a target's area whose normals are opposite to those of the closest triangles of a source."""
    from mixseq.geometry.nearest import Nearest

    fitted = TriangleMesh(np.asarray(registered, np.float64), Topology(source_faces, len(registered)))
    target = TriangleMesh(np.asarray(target_points, np.float64), Topology(target_faces, len(target_points)))
    found = Nearest.of(fitted.points, fitted.faces).query(target.centroids)
    opposite = np.einsum("fi,fi->f", fitted.face_normals[found.faces], target.face_normals) < 0
    return float(target.face_areas[opposite].sum() / max(target.face_areas.sum(), np.finfo(float).tiny))
