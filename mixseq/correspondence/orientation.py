r"""Refuse meshes that are inside out: triangles of source and target must have the same orientation.

A closed component encloses the volume :math:`\frac16 \sum_t a_t \cdot (b_t \times c_t)`, negative if its triangles run
clockwise seen from outside. With holes it depends on the origin, by the sum of the vector areas: the sign of a
component counts if it is the same for all origins in its bounding sphere. More open surfaces are checked after
registration, by the normals of closest points.
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
"""Volume relative to a component's cubed diagonal below which it is rounding."""

NAMED = 4
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
    from mixseq.geometry.nearest import Nearest

    fitted = TriangleMesh(np.asarray(registered, np.float64), Topology(source_faces, len(registered)))
    target = TriangleMesh(np.asarray(target_points, np.float64), Topology(target_faces, len(target_points)))
    found = Nearest.of(fitted.points, fitted.faces).query(target.centroids)
    opposite = np.einsum("fi,fi->f", fitted.face_normals[found.faces], target.face_normals) < 0
    return float(target.face_areas[opposite].sum() / max(target.face_areas.sum(), np.finfo(float).tiny))
