"""USD, seams: weld points that are split where texture coordinates or normals differ.

Meshes of skeletons are welded where position, joints, weights and blend shapes are bit-identical; game-engine
characters would otherwise be cut open along all seams. Other meshes are not, since points with time samples would all
have to be read. A layer with new points stores the vertex of every point in the attribute `VERTICES`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, UsdGeom, UsdSkel

from mixseq.arrays import IntArray
from mixseq.polygons import Polygons

VERTICES = "mixseq:vertices"


@dataclass(frozen=True, eq=False)
class Weld:
    """Map of a mesh's points to its vertices."""

    of_point: IntArray
    representatives: IntArray

    @property
    def is_identity(self) -> bool:
        """Whether every point is a separate vertex."""
        return len(self.of_point) == len(self.representatives)

    @property
    def vertex_count(self) -> int:
        """Number W of vertices."""
        return len(self.representatives)

    def polygons(self, polygons: Polygons) -> Polygons:
        """Return polygons of points as polygons of vertices."""
        return Polygons(polygons.counts, self.of_point[polygons.indices])


def unwelded(count: int) -> Weld:
    """Return the identity map of `count` points."""
    return Weld(np.arange(count), np.arange(count))


def weld(mesh: UsdGeom.Mesh, points: NDArray[np.float32]) -> Weld:
    """Return the weld of a mesh's points ``(P, 3)`` in some frame."""
    labels = _told(mesh, len(points))
    if labels is None:
        labels = _found(mesh, points)
    _, first, of_point = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return Weld(rank[of_point.reshape(-1)], first[order])


def _told(mesh: UsdGeom.Mesh, count: int) -> IntArray | None:
    """Return the vertices ``(P,)`` stored by a layer of mixseq, None if absent or of another size."""
    attribute = mesh.GetPrim().GetAttribute(VERTICES)
    if not attribute or attribute.GetTypeName() != Sdf.ValueTypeNames.IntArray:
        return None
    labels = np.array(attribute.Get() or (), dtype=np.int32)
    return labels if len(labels) == count else None


def _found(mesh: UsdGeom.Mesh, points: NDArray[np.float32]) -> IntArray:
    attribute = mesh.GetPointsAttr()
    influences = list(_influences(mesh, len(points)))
    known = [each for each in influences if each is not None]
    if attribute.ValueMightBeTimeVarying() or not known or len(known) < len(influences):
        return np.arange(len(points))
    rows = np.hstack([points, *known])
    return np.unique(np.ascontiguousarray(rows), axis=0, return_inverse=True)[1].reshape(-1)


def _influences(mesh: UsdGeom.Mesh, count: int) -> Iterator[NDArray[np.float32] | None]:
    """Yield arrays ``(P, n)`` of each influence on the points; None for one that is time-sampled or does not fit."""
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    for primvar in (binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar()):
        if not primvar or primvar.GetInterpolation() != UsdGeom.Tokens.vertex:
            continue  # one for all points
        values = np.array(primvar.ComputeFlattened() or (), dtype=np.float32)
        fits = len(values) == count * primvar.GetElementSize() and not primvar.ValueMightBeTimeVarying()
        yield values.reshape(count, -1) if fits else None
    if not binding.GetBlendShapesAttr().HasAuthoredValue():
        return
    query = UsdSkel.BlendShapeQuery(binding)
    indices = [np.array(each, dtype=np.int64) for each in query.ComputeBlendShapePointIndices()]
    for subshape, value in enumerate(query.ComputeSubShapePointOffsets()):
        offsets = np.array(value or (), dtype=np.float32).reshape(-1, 3)
        if not len(offsets):
            continue  # the shape at weight 0
        rows = indices[query.GetBlendShapeIndex(subshape)]
        rows = rows if rows.size else np.arange(count)
        if len(rows) != len(offsets) or (rows.size and (rows.min() < 0 or rows.max() >= count)):
            yield None
            continue
        dense = np.zeros((count, 3), dtype=np.float32)
        dense[rows] = offsets
        yield dense
