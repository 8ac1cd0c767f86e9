"""USD, surfaces: polygons, texture coordinates, colours, hard edges and face sets of a mesh.

Specification: https://openusd.org/release/api/class_usd_geom_primvar.html (interpolation)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdShade

from mixseq.arrays import IntArray
from mixseq.errors import InvalidSequenceError
from mixseq.geometry.normals import hard_edges_of_normals
from mixseq.polygons import Polygons, reversed_corners
from mixseq.surface import CornerValues, FaceSet
from mixseq_io.colours import with_alpha
from mixseq_io.reader import naming
from mixseq_io.scene_meshes import SceneMesh, material_of_the_rest
from mixseq_io.usd.mesh_motion import AnimatedMesh
from mixseq_io.usd.prims import Notes
from mixseq_io.usd.stage_meshes import display_name

_UV_TYPES = (
    Sdf.ValueTypeNames.TexCoord2fArray,
    Sdf.ValueTypeNames.TexCoord2dArray,
    Sdf.ValueTypeNames.TexCoord2hArray,
    Sdf.ValueTypeNames.Float2Array,
)
_COLOUR_TYPES = (
    Sdf.ValueTypeNames.Color3fArray,
    Sdf.ValueTypeNames.Color3dArray,
    Sdf.ValueTypeNames.Color3hArray,
    Sdf.ValueTypeNames.Color4fArray,
    Sdf.ValueTypeNames.Color4dArray,
    Sdf.ValueTypeNames.Color4hArray,
)

_PURPOSES = (UsdShade.Tokens.allPurpose, UsdShade.Tokens.full, UsdShade.Tokens.preview)


def scene_mesh_of(
    animated: AnimatedMesh, first_vertex: int, codes: NDArray[np.float64], notes: Notes
) -> SceneMesh:
    """Return a mesh as in the first frame, faces counter-clockwise from outside in world space: codes ``(T,)``."""
    mesh, code = animated.mesh, Usd.TimeCode(animated.start)
    path = str(mesh.GetPath())
    with naming(path):
        polygons = _polygons(animated, codes)
    scheme = str(mesh.GetSubdivisionSchemeAttr().Get())
    if mesh.GetHoleIndicesAttr().Get(code):
        notes.add(mesh.GetPrim(), "holes cannot be kept; these faces become visible")
    scene_mesh = SceneMesh(
        name=display_name(mesh.GetPrim()),
        path=path,
        vertices=slice(first_vertex, first_vertex + animated.vertex_count),
        polygons=animated.weld.polygons(polygons),
        uvs=_chosen_values(animated, polygons, notes, "texture coordinates", _UV_TYPES, "st"),
        colours=_colours(animated, polygons, notes),
        # The normals of a surface that is subdivided follow from the subdivision.
        hard_edges=_hard_edges(animated, polygons, notes) if scheme == UsdGeom.Tokens.none else None,
        face_sets=tuple(_face_sets(mesh, len(polygons.counts), code, notes)),
        subdivision=scheme,
    )
    # A left-handed mesh lists corners clockwise; a transform that mirrors turns clockwise around.
    left_handed = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    return _turned(scene_mesh) if left_handed != animated.mirrored else scene_mesh


def _turned(scene_mesh: SceneMesh) -> SceneMesh:
    order = reversed_corners(scene_mesh.polygons.counts, keep_first=True)
    return replace(
        scene_mesh,
        polygons=Polygons(scene_mesh.polygons.counts, scene_mesh.polygons.indices[order]),
        uvs=scene_mesh.uvs and scene_mesh.uvs.taken(order),
        colours=scene_mesh.colours and scene_mesh.colours.taken(order),
        hard_edges=None if scene_mesh.hard_edges is None else scene_mesh.hard_edges[order],
    )


def _polygons(animated: AnimatedMesh, codes: NDArray[np.float64]) -> Polygons:
    counts = _constant(animated.mesh.GetFaceVertexCountsAttr(), codes)
    polygons = Polygons(counts, _constant(animated.mesh.GetFaceVertexIndicesAttr(), codes))
    outside = (polygons.indices < 0) | (polygons.indices >= animated.point_count)
    if outside.any():
        corner = int(np.argmax(outside))
        face = int(np.searchsorted(np.cumsum(polygons.counts), corner, side="right"))
        raise InvalidSequenceError(
            f"face {face} uses vertex {polygons.indices[corner]}, but vertices are 0 to {animated.point_count - 1}"
        )
    return polygons


def _constant(attribute: Usd.Attribute, codes: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the value of an attribute that must be constant; some exporters repeat it at every sample."""
    first = np.array(attribute.Get(Usd.TimeCode(codes[0])) or (), dtype=np.int32)
    for code in attribute.GetTimeSamples():
        if not np.array_equal(first, np.array(attribute.Get(Usd.TimeCode(code)) or (), dtype=np.int32)):
            raise InvalidSequenceError(
                f"{attribute.GetName()} changes at time code {code:g}; every frame needs the "
                "same faces: export without remeshing, or the part of the time line before it"
            )
    return first


def _colours(animated: AnimatedMesh, polygons: Polygons, notes: Notes) -> CornerValues | None:
    """Return the colours of ``displayColor``, or the first colour primvar, with its opacity if any."""
    colours = _chosen_values(animated, polygons, notes, "colours", _COLOUR_TYPES, "displayColor")
    opacity = UsdGeom.PrimvarsAPI(animated.mesh).FindPrimvarWithInheritance("displayOpacity")
    if colours is None:
        return None
    alpha = _values(animated, polygons, notes, "opacities", opacity) if opacity.HasAuthoredValue() else None
    if alpha is None:
        return CornerValues(with_alpha(colours.values), colours.indices)
    return CornerValues.of_corners(np.hstack([colours.at_corners[:, :3], alpha.at_corners]))


def _chosen_values(
    animated: AnimatedMesh,
    polygons: Polygons,
    notes: Notes,
    what: str,
    types: Sequence[Sdf.ValueTypeName],
    usual: str,
) -> CornerValues | None:
    """Return the values of the usually named primvar of some types, or of the first one."""
    prim = animated.mesh.GetPrim()
    every = UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance()
    sets = [each for each in every if each.GetTypeName() in types and each.HasAuthoredValue()]
    if not sets:
        return None
    chosen = min(sets, key=lambda each: (each.GetPrimvarName() != usual, types.index(each.GetTypeName())))
    if len(sets) > 1:
        notes.add(prim, f"of several sets of {what} only {chosen.GetPrimvarName()!r} is kept")
    return _values(animated, polygons, notes, what, chosen)


def _values(
    animated: AnimatedMesh, polygons: Polygons, notes: Notes, what: str, primvar: UsdGeom.Primvar
) -> CornerValues | None:
    """Return a primvar's values at corners in the first frame, None if it does not fit the faces."""
    prim, code = animated.mesh.GetPrim(), Usd.TimeCode(animated.start)
    if primvar.ValueMightBeTimeVarying():
        notes.add(prim, f"{what} that change over time stay as they are in the first frame")
    values = np.array(primvar.Get(code) or (), dtype=np.float32)
    rows = rows_of_corners(primvar.GetInterpolation(), polygons)
    if primvar.IsIndexed():
        indices = np.array(primvar.GetIndices(code) or (), dtype=np.int32)
        rows = indices[rows] if within(rows, len(indices)) else np.array([-1])
    if not within(rows, len(values)):
        notes.add(prim, f"{what} {primvar.GetPrimvarName()!r} do not fit the faces and are left out")
        return None
    if not len(values):  # of a mesh without faces
        return None
    width = 1 if values.ndim == 1 else values.shape[1]
    return CornerValues(values.reshape(-1, width), rows)


def _hard_edges(animated: AnimatedMesh, polygons: Polygons, notes: Notes) -> NDArray[np.int32] | None:
    """Return the normal's index at every corner; ``primvars:normals`` takes precedence over ``normals``."""
    mesh, code = animated.mesh, Usd.TimeCode(animated.start)
    primvar = UsdGeom.PrimvarsAPI(mesh.GetPrim()).GetPrimvar("normals")
    if primvar and primvar.HasAuthoredValue():
        interpolation, values = primvar.GetInterpolation(), primvar.ComputeFlattened(code)
    else:
        interpolation, values = mesh.GetNormalsInterpolation(), mesh.GetNormalsAttr().Get(code)
    of_points = interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)
    if values is None or (of_points and animated.weld.is_identity):
        return None
    normals = np.array(values, dtype=np.float32).reshape(-1, 3)
    rows = rows_of_corners(interpolation, polygons)
    if not within(rows, len(normals)) or not np.isfinite(normals).all():
        notes.add(mesh.GetPrim(), "normals do not fit the faces and are left out")
        return None
    return hard_edges_of_normals(animated.weld.polygons(polygons), normals[rows])


def rows_of_corners(interpolation: str, polygons: Polygons) -> NDArray[np.int32]:
    """Return the row of a primvar's value for every corner ``(corners,)``."""
    if interpolation == UsdGeom.Tokens.faceVarying:
        return np.arange(polygons.indices.size, dtype=np.int32)
    if interpolation == UsdGeom.Tokens.uniform:
        return np.repeat(np.arange(len(polygons.counts), dtype=np.int32), polygons.counts)
    if interpolation == UsdGeom.Tokens.constant:
        return np.zeros(polygons.indices.size, dtype=np.int32)
    return np.asarray(polygons.indices, dtype=np.int32)


def within(rows: IntArray, count: int) -> bool:
    """Whether all rows are in range."""
    return not rows.size or bool(rows.min() >= 0 and rows.max() < count)


def _face_sets(mesh: UsdGeom.Mesh, polygon_count: int, code: Usd.TimeCode, notes: Notes) -> list[FaceSet]:
    """Return the mesh's material on faces without a subset's material, and the subsets of its faces."""
    sets, bound = [], []
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            notes.add(subset.GetPrim(), "subsets of other elements than faces are left out")
            continue
        if subset.GetIndicesAttr().ValueMightBeTimeVarying():
            notes.add(subset.GetPrim(), "subsets that change over time stay as they are in the first frame")
        polygons = np.array(subset.GetIndicesAttr().Get(code) or (), dtype=np.int32)
        inside = (polygons >= 0) & (polygons < polygon_count)
        if not inside.all():
            notes.add(subset.GetPrim(), "faces of subsets that the mesh does not have are left out")
        # Without a binding of its own a subset has the mesh's material, which is not to be bound to it.
        bindings = UsdShade.MaterialBindingAPI(subset.GetPrim())
        own = any(bindings.GetDirectBinding(purpose).GetMaterialPath() for purpose in _PURPOSES)
        material = _material(subset.GetPrim()) if own else None
        sets.append(
            FaceSet(
                display_name(subset.GetPrim()), polygons[inside], str(material.GetPath()) if material else ""
            )
        )
        # Renderers bind to subsets of this family only.
        if material and subset.GetFamilyNameAttr().Get() == UsdShade.Tokens.materialBind:
            bound.append(sets[-1])
    whole = _material(mesh.GetPrim())
    rest = material_of_the_rest(str(whole.GetPath()), polygon_count, bound) if whole else ()
    return [*rest, *sets]


def _material(prim: Usd.Prim) -> UsdShade.Material | None:
    """Return the first material among those for all purposes, final renders, and previews."""
    bindings = UsdShade.MaterialBindingAPI(prim)
    found = (bindings.ComputeBoundMaterial(purpose)[0] for purpose in _PURPOSES)
    return next(filter(None, found), None)
