"""Surfaces of USD meshes: faces, primvars, normals and subsets of faces, as in the first frame.

Specification: https://openusd.org/release/api/class_usd_geom_primvar.html (interpolation),
https://openusd.org/release/api/class_usd_geom_subset.html (families and their types)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdShade

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.measures import hard_edges_from_normals
from mixseq.mesh.polygons import Polygons, reversed_winding
from mixseq.mesh.surface import SUBDIVISIONS, CornerValues, FaceSet
from mixseq.types import IntArray
from mixseq_io.reader import prefix_errors
from mixseq_io.scene_meshes import SceneMesh, base_face_set
from mixseq_io.surfaces import are_valid_indices, ensure_alpha
from mixseq_io.usd.motion import AnimatedMesh
from mixseq_io.usd.stage import PrimWarnings, display_name

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

_MATERIAL_PURPOSES = (UsdShade.Tokens.allPurpose, UsdShade.Tokens.full, UsdShade.Tokens.preview)


def read_scene_mesh(animated: AnimatedMesh, warnings: PrimWarnings) -> SceneMesh:
    """Read a mesh's surface in the first frame, with faces counter-clockwise in world space."""
    mesh, code = animated.mesh, Usd.TimeCode(animated.start)
    path, vertices = str(mesh.GetPath()), slice(0, animated.vertex_count)
    with prefix_errors(path):
        polygons = _read_polygons(animated)
    scheme = str(mesh.GetSubdivisionSchemeAttr().Get())
    if scheme not in SUBDIVISIONS:
        warnings.add(mesh.GetPrim(), f"the subdivision {scheme!r} is read as catmullClark")
        scheme = str(UsdGeom.Tokens.catmullClark)
    if mesh.GetHoleIndicesAttr().Get(code):
        warnings.add(mesh.GetPrim(), "holes cannot be kept; these faces become visible")
    scene_mesh = SceneMesh(
        name=display_name(mesh.GetPrim()),
        path=path,
        vertices=vertices,
        polygons=animated.weld.weld_polygons(polygons),
        uvs=_read_preferred_primvar(animated, polygons, warnings, "texture coordinates", _UV_TYPES, "st"),
        colours=_read_colours(animated, polygons, warnings),
        # Subdivision determines the normals of a subdivision surface.
        hard_edges=_read_hard_edges(animated, polygons, warnings) if scheme == UsdGeom.Tokens.none else None,
        face_sets=tuple(_read_face_sets(mesh, len(polygons.counts), code, warnings)),
        subdivision=scheme,
    )
    # A left-handed mesh lists corners clockwise; a mirroring transform reverses them once more.
    is_left_handed = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    return _reverse_corners(scene_mesh) if is_left_handed != animated.is_mirrored else scene_mesh


def _reverse_corners(scene_mesh: SceneMesh) -> SceneMesh:
    """Reverse the corners of every polygon, and all attributes of corners with them."""
    order = reversed_winding(scene_mesh.polygons.counts, keep_first=True)
    return replace(
        scene_mesh,
        polygons=Polygons(scene_mesh.polygons.counts, scene_mesh.polygons.indices[order]),
        uvs=scene_mesh.uvs and scene_mesh.uvs.select(order),
        colours=scene_mesh.colours and scene_mesh.colours.select(order),
        hard_edges=None if scene_mesh.hard_edges is None else scene_mesh.hard_edges[order],
    )


def _read_polygons(animated: AnimatedMesh) -> Polygons:
    """Return the polygons of a mesh, with point indices."""
    counts = _read_constant(animated.mesh.GetFaceVertexCountsAttr(), animated.start)
    indices = _read_constant(animated.mesh.GetFaceVertexIndicesAttr(), animated.start)
    polygons = Polygons(counts, indices)
    is_invalid = (polygons.indices < 0) | (polygons.indices >= animated.point_count)
    if is_invalid.any():
        corner = int(np.argmax(is_invalid))
        face = int(np.searchsorted(np.cumsum(polygons.counts), corner, side="right"))
        raise InvalidSequenceError(
            f"face {face} uses vertex {polygons.indices[corner]}, but vertices are 0 to {animated.point_count - 1}"
        )
    return polygons


def _read_constant(attribute: Usd.Attribute, start: float) -> NDArray[np.int32]:
    """Return the value of an attribute that must be constant; some exporters repeat the value in every sample."""
    first = np.array(attribute.Get(Usd.TimeCode(start)) or (), dtype=np.int32)
    for code in attribute.GetTimeSamples():
        if not np.array_equal(first, np.array(attribute.Get(Usd.TimeCode(code)) or (), dtype=np.int32)):
            raise InvalidSequenceError(
                f"{attribute.GetName()} changes at time code {code:g}; every frame needs the "
                "same faces: export without remeshing, or the part of the time line before it"
            )
    return first


def _read_colours(animated: AnimatedMesh, polygons: Polygons, warnings: PrimWarnings) -> CornerValues | None:
    """Return the values of ``displayColor``, else of the first colour primvar, with ``displayOpacity`` if authored."""
    colours = _read_preferred_primvar(animated, polygons, warnings, "colours", _COLOUR_TYPES, "displayColor")
    opacity = UsdGeom.PrimvarsAPI(animated.mesh).FindPrimvarWithInheritance("displayOpacity")
    if colours is None:
        return None
    has_opacity = opacity.HasAuthoredValue()
    alpha = _read_primvar(animated, polygons, warnings, "opacities", opacity) if has_opacity else None
    if alpha is None:
        return CornerValues(ensure_alpha(colours.values), colours.indices)
    return CornerValues.from_corners(np.hstack([colours.at_corners[:, :3], alpha.at_corners]))


def _read_preferred_primvar(
    animated: AnimatedMesh,
    polygons: Polygons,
    warnings: PrimWarnings,
    label: str,
    types: Sequence[Sdf.ValueTypeName],
    preferred_name: str,
) -> CornerValues | None:
    """Read the primvar with the preferred name among primvars of given types, else a primvar of the first type."""
    prim = animated.mesh.GetPrim()
    primvars = UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance()
    candidates = [each for each in primvars if each.GetTypeName() in types and each.HasAuthoredValue()]
    if not candidates:
        return None
    best = min(
        candidates,
        key=lambda each: (each.GetPrimvarName() != preferred_name, types.index(each.GetTypeName())),
    )
    if len(candidates) > 1:
        warnings.add(prim, f"of several sets of {label} only {best.GetPrimvarName()!r} is kept")
    return _read_primvar(animated, polygons, warnings, label, best)


def _read_primvar(
    animated: AnimatedMesh, polygons: Polygons, warnings: PrimWarnings, label: str, primvar: UsdGeom.Primvar
) -> CornerValues | None:
    """Return a primvar's values at corners in the first frame, or None if the primvar does not fit the faces."""
    prim, code = animated.mesh.GetPrim(), Usd.TimeCode(animated.start)
    if primvar.ValueMightBeTimeVarying():
        warnings.add(prim, f"{label} that change over time stay as they are in the first frame")
    values = np.array(primvar.Get(code) or (), dtype=np.float32)
    value_ids = value_ids_of_corners(primvar.GetInterpolation(), polygons)
    if primvar.IsIndexed():
        indices = np.array(primvar.GetIndices(code) or (), dtype=np.int32)
        value_ids = indices[value_ids] if are_valid_indices(value_ids, len(indices)) else np.array([-1])
    if not are_valid_indices(value_ids, len(values)):
        warnings.add(prim, f"{label} {primvar.GetPrimvarName()!r} do not fit the faces and are left out")
        return None
    if not len(values):  # of a mesh without faces
        return None
    width = 1 if values.ndim == 1 else values.shape[1]
    return CornerValues(values.reshape(-1, width), value_ids)


def _read_hard_edges(animated: AnimatedMesh, polygons: Polygons, warnings: PrimWarnings) -> IntArray | None:
    """Return the index of the normal at every corner; ``primvars:normals`` takes precedence over ``normals``."""
    mesh, code = animated.mesh, Usd.TimeCode(animated.start)
    primvar = UsdGeom.PrimvarsAPI(mesh.GetPrim()).GetPrimvar("normals")
    if primvar and primvar.HasAuthoredValue():
        interpolation, values = primvar.GetInterpolation(), primvar.ComputeFlattened(code)
    else:
        interpolation, values = mesh.GetNormalsInterpolation(), mesh.GetNormalsAttr().Get(code)
    is_per_point = interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)
    if values is None or (is_per_point and animated.weld.is_identity):
        return None
    normals = np.array(values, dtype=np.float32)
    value_ids = value_ids_of_corners(interpolation, polygons)
    if normals.shape[1:] != (3,) or not are_valid_indices(value_ids, len(normals)) or not np.isfinite(normals).all():
        warnings.add(mesh.GetPrim(), "normals do not fit the faces and are left out")
        return None
    return hard_edges_from_normals(animated.weld.weld_polygons(polygons), normals[value_ids])


def value_ids_of_corners(interpolation: str, polygons: Polygons) -> NDArray[np.int32]:
    """Return the index of a primvar's value for every corner ``(C,)``."""
    if interpolation == UsdGeom.Tokens.faceVarying:
        return np.arange(polygons.indices.size, dtype=np.int32)
    if interpolation == UsdGeom.Tokens.uniform:
        return np.repeat(np.arange(len(polygons.counts), dtype=np.int32), polygons.counts)
    if interpolation == UsdGeom.Tokens.constant:
        return np.zeros(polygons.indices.size, dtype=np.int32)
    return np.asarray(polygons.indices, dtype=np.int32)


def _read_face_sets(mesh: UsdGeom.Mesh, face_count: int, code: Usd.TimeCode, warnings: PrimWarnings) -> list[FaceSet]:
    """Return the subsets of a mesh's faces, preceded by a face set for the mesh's material on the remaining faces."""
    sets, material_sets = [], []
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        prim = subset.GetPrim()
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            warnings.add(prim, "subsets of other elements than faces are left out")
            continue
        if subset.GetIndicesAttr().ValueMightBeTimeVarying():
            warnings.add(prim, "subsets that change over time stay as they are in the first frame")
        faces = np.array(subset.GetIndicesAttr().Get(code) or (), dtype=np.int32)
        is_valid = (faces >= 0) & (faces < face_count)
        if not is_valid.all():
            warnings.add(prim, "faces of subsets that the mesh does not have are left out")
        # A subset without a material binding inherits the mesh's material; its face set stores no material.
        bindings = UsdShade.MaterialBindingAPI(prim)
        is_bound = any(bindings.GetDirectBinding(purpose).GetMaterialPath() for purpose in _MATERIAL_PURPOSES)
        material = _bound_material(prim) if is_bound else None
        material_path = str(material.GetPath()) if material else ""
        sets.append(FaceSet(display_name(prim), faces[is_valid], material_path))
        # Renderers use only the bindings of this family.
        if material and subset.GetFamilyNameAttr().Get() == UsdShade.Tokens.materialBind:
            material_sets.append(sets[-1])
    material = _bound_material(mesh.GetPrim())
    rest = base_face_set(str(material.GetPath()), face_count, material_sets) if material else ()
    return [*rest, *sets]


def _bound_material(prim: Usd.Prim) -> UsdShade.Material | None:
    """Return the first material that is bound for all purposes, for final renders, or for previews, in this order."""
    bindings = UsdShade.MaterialBindingAPI(prim)
    materials = (bindings.ComputeBoundMaterial(purpose)[0] for purpose in _MATERIAL_PURPOSES)
    return next(filter(None, materials), None)
