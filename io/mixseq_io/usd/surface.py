"""Surfaces of USD meshes: faces, primvars and subsets are read; materials and parts are written.

Materials of a stand-alone file are copied from the original, as networks of the composed file, flattened. Connections
that leave the material are lost. Textures stay in place; asset paths are rewritten. Parts are a family of subsets that
partitions every mesh's faces.

Specification: https://openusd.org/release/api/class_usd_geom_subset.html (families and their types),
https://openusd.org/release/api/class_usd_geom_primvar.html (interpolation)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Ar, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils, Vt
from scipy.sparse import csr_array

from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.mesh.measures import hard_edges_from_normals
from mixseq.mesh.polygons import Polygons, reversed_winding
from mixseq.mesh.surface import CornerValues, FaceSet, Origin
from mixseq.sequence.header import SequenceHeader
from mixseq.types import IntArray
from mixseq_io.reader import prefix_errors, warn
from mixseq_io.scene_meshes import SceneMesh, base_face_set
from mixseq_io.surfaces import are_valid_indices, ensure_alpha
from mixseq_io.text.labels import (
    GROUPS_SOURCE,
    LABEL_SUBSET_FAMILY,
    LABELS_SOURCE,
    MATERIALS_SOURCE,
    Markings,
    Skinning,
    concatenate_skinning,
    group_face_sets,
)
from mixseq_io.usd.motion import AnimatedMesh
from mixseq_io.usd.stage import (
    TILES,
    Identifiers,
    Notes,
    define,
    display_name,
    is_prim_path,
    lineage,
    open_stage,
    reference_to,
    shortened,
    translate_usd_read_errors,
)

_UV_READERS = {
    "UsdPrimvarReader_float2": "inputs:varname",
    "ND_UsdPrimvarReader_vector2": "inputs:varname",
    "ND_geompropvalue_vector2": "inputs:geomprop",
}
"""Shader inputs that name texture coordinates."""


def define_materials(
    stage: Usd.Stage, target: Path, scope: str, names: Iterable[str], origin: Origin | None
) -> Mapping[str, UsdShade.Material]:
    """Define materials below a scope; return them by name."""
    wanted = list(dict.fromkeys(names))
    if not wanted:
        return {}
    UsdGeom.Scope.Define(stage, scope)
    source = _networks(Path(origin.path), wanted) if origin and origin.format == "USD" else None
    names_here = Identifiers()
    paths = {name: Sdf.Path(scope).AppendChild(names_here.take(name.rpartition("/")[2])) for name in wanted}
    with Sdf.ChangeBlock():
        for name, path in paths.items():
            if source and _is_material(source, name):
                _copy(source, name, stage.GetRootLayer(), path)
            define(stage.GetRootLayer(), path, "Material")
    made = {name: UsdShade.Material.Get(stage, path) for name, path in paths.items()}
    empty = [name for name in wanted if not made[name].GetPrim().GetAuthoredProperties()]
    if empty and not is_gone(origin):
        warn(
            f"{target}: materials are written by name only: {shortened(empty)}; bind them anew to networks of yours"
        )
    known = origin.path if origin else ""
    UsdUtils.ModifyAssetPaths(stage.GetRootLayer(), lambda asset: _from(target, asset, known))
    return made


def is_gone(origin: Origin | None) -> bool:
    """Whether the original USD file existed and is now missing."""
    return origin is not None and origin.format == "USD" and not Path(origin.path).is_file()


def _networks(origin: Path, materials: Iterable[str]) -> Sdf.Layer | None:
    """Return a layer with the materials only; None if the file is missing."""
    try:
        with translate_usd_read_errors(origin):
            whole = open_stage(origin)
    except FormatError:
        return None
    mask = Usd.StagePopulationMask()
    session = Sdf.Layer.CreateAnonymous()
    for path in filter(is_prim_path, materials):
        mask.Add(path)
        for prim in lineage(whole.GetPrimAtPath(path)):
            if prim.IsInstance():
                Sdf.CreatePrimInLayer(session, prim.GetPath()).SetInfo("instanceable", False)
    return Usd.Stage.OpenMasked(whole.GetRootLayer(), session, mask).Flatten()


def _is_material(layer: Sdf.Layer, name: str) -> bool:
    prim = layer.GetPrimAtPath(name) if is_prim_path(name) else None
    return prim is not None and prim.typeName == "Material"


def _copy(source: Sdf.Layer, name: str, layer: Sdf.Layer, path: Sdf.Path) -> None:
    Sdf.CopySpec(source, name, layer, path)
    strays = []
    for prim in _prims(layer.GetPrimAtPath(path)):
        _read_st(prim)
        for attribute in prim.attributes:
            if any(not each.HasPrefix(path) for each in attribute.connectionPathList.explicitItems):
                attribute.connectionPathList.ClearEdits()
                strays.append(str(attribute.path))
    if strays:
        warn(f"the material {name} uses networks outside of it, which are left out at {shortened(strays)}")


def _read_st(shader: Sdf.PrimSpec) -> None:
    """Rename the texture coordinates of a reader to ``st``."""
    kind = shader.attributes.get("info:id")
    name = _UV_READERS.get(kind.default) if kind else None
    if name:
        before = shader.attributes.get(name)
        if before:
            shader.RemoveProperty(before)
        Sdf.AttributeSpec(shader, name, Sdf.ValueTypeNames.String).default = "st"


def _prims(prim: Sdf.PrimSpec) -> Iterator[Sdf.PrimSpec]:
    yield prim
    for child in prim.nameChildren:
        yield from _prims(child)


def _from(target: Path, asset: str, origin: str) -> str:
    """Return the path of a texture, possibly inside a .usdz file, as named from the target."""
    # USD has made paths absolute, but not those in packages that stand for several files.
    if TILES in asset and origin.endswith(".usdz") and not Path(asset).is_absolute():
        asset = Ar.JoinPackageRelativePath(origin, asset)
    outer, inner = Ar.SplitPackageRelativePathOuter(asset)
    file = Path(outer)
    if not (file.is_absolute() and file.parent.is_dir()):
        return asset
    named = reference_to(file, target)
    return Ar.JoinPackageRelativePath(named, inner) if inner else named


NUMBER = "mixseq:part"
"""Key of a part's number in the custom data of its subset."""


def markings_of(header: SequenceHeader, meshes: Sequence[AnimatedMesh]) -> Markings:
    """Return the families of subsets and the joints of a stage's meshes."""
    polygons = [_polygons_in_file(animated) for animated in meshes]
    skinned = any(animated.mover.skin and animated.mover.skin.has_joints for animated in meshes)
    materials = {
        source: sets for source, sets in group_face_sets(header).items() if source == MATERIALS_SOURCE
    }
    return Markings(
        sets=_families(meshes, polygons) | materials,
        skinning=concatenate_skinning([_skinning(animated) for animated in meshes]) if skinned else None,
    )


def _polygons_in_file(animated: AnimatedMesh) -> Polygons:
    """Return the faces by points, as in the file."""
    code = Usd.TimeCode(animated.start)
    counts = animated.mesh.GetFaceVertexCountsAttr().Get(code)
    indices = animated.mesh.GetFaceVertexIndicesAttr().Get(code)
    return Polygons(np.array(counts or (), dtype=np.int32), np.array(indices or (), dtype=np.int32))


def _families(meshes: Sequence[AnimatedMesh], polygons: Sequence[Polygons]) -> dict[str, tuple[FaceSet, ...]]:
    """Return subsets of faces by family; those written by mixseq in the order of their numbers."""
    found: dict[str, list[tuple[int, FaceSet]]] = {}
    first = 0
    for animated, own in zip(meshes, polygons, strict=True):
        code = Usd.TimeCode(animated.start)
        for subset in _subsets(animated.mesh):
            faces = np.array(subset.GetIndicesAttr().Get(code) or (), dtype=np.int32)
            faces = faces[(faces >= 0) & (faces < len(own.counts))]
            number = subset.GetPrim().GetCustomDataByKey(NUMBER)
            face_set = FaceSet(display_name(subset.GetPrim()), faces + first)
            family = str(subset.GetFamilyNameAttr().Get() or GROUPS_SOURCE)
            source = LABELS_SOURCE if family == LABEL_SUBSET_FAMILY else family
            found.setdefault(source, []).append((number if isinstance(number, int) else 0, face_set))
        first += len(own.counts)
    return {
        source: tuple(each for _, each in sorted(sets, key=lambda pair: pair[0]))
        for source, sets in found.items()
    }


def _subsets(mesh: UsdGeom.Mesh) -> Iterator[UsdGeom.Subset]:
    """Yield the subsets of a mesh's faces that bind no materials."""
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        of_faces = subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face
        if of_faces and subset.GetFamilyNameAttr().Get() != UsdShade.Tokens.materialBind:
            yield subset


def _skinning(animated: AnimatedMesh) -> Skinning:
    skin = animated.mover.skin
    if skin is None or not skin.has_joints:
        return Skinning.rigid(str(animated.mesh.GetPath()), animated.vertex_count)
    names = [str(each) for each in skin.query.GetJointOrder() or skin.skeleton.query.GetJointOrder()]
    indices, weights = skin.query.ComputeVaryingJointInfluences(
        animated.point_count, Usd.TimeCode(animated.start)
    )
    joint = np.array(indices or (), dtype=np.int64).reshape(animated.point_count, -1)
    weight = np.array(weights or (), dtype=np.float64).reshape(animated.point_count, -1)
    if not joint.size or joint.min() < 0 or joint.max() >= len(names):
        raise InvalidSequenceError(
            f"the joint indices and weights of {animated.mesh.GetPath()} do not fit its {animated.point_count} "
            f"points and {len(names)} joints; export the character again"
        )
    rows = np.repeat(np.arange(animated.vertex_count), joint.shape[1])
    vertices = animated.weld.representatives
    matrix = csr_array(
        (weight[vertices].reshape(-1), (rows, joint[vertices].reshape(-1))),
        shape=(animated.vertex_count, len(names)),
    )
    root = str(skin.skeleton.prim.GetPath())
    return Skinning(
        matrix,
        tuple(f"{root}/{name}" for name in names),
        tuple(_above(root, name, skin.skeleton.query) for name in names),
    )


def _above(root: str, joint: str, skeleton: UsdSkel.SkeletonQuery) -> str:
    """Return the path of a joint's parent joint, "" if it has none."""
    every = [str(each) for each in skeleton.GetJointOrder()]
    parent = skeleton.GetTopology().GetParent(every.index(joint)) if joint in every else -1
    return f"{root}/{every[parent]}" if parent >= 0 else ""


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of a sequence's polygons."""

    of_polygon: tuple[IntArray, ...]
    names: Sequence[str]


def write_parts(layer: Sdf.Layer, meshes: Sequence[str], parts: Parts) -> None:
    """Author a subset for every part of every mesh, in place of earlier ones."""
    stage = Usd.Stage.Open(layer)
    for path, of_polygon in zip(meshes, parts.of_polygon, strict=True):
        _define(UsdGeom.Mesh(stage.GetPrimAtPath(path)), of_polygon, parts.names)


def _define(mesh: UsdGeom.Mesh, of_polygon: IntArray, names: Sequence[str]) -> None:
    old = {each.GetPrim().GetName() for each in UsdGeom.Subset.GetGeomSubsets(mesh, "", LABEL_SUBSET_FAMILY)}
    others = mesh.GetPrim().GetFilteredChildren(Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
    kept = {name for each in others if (name := each.GetName()) not in old}
    free = Identifiers(*kept)
    for part in np.unique(of_polygon).tolist():
        name = free.take(names[part])
        kept.add(name)
        faces = np.flatnonzero(of_polygon == part).astype(np.int32)
        subset = UsdGeom.Subset.CreateGeomSubset(
            mesh, name, UsdGeom.Tokens.face, Vt.IntArrayFromBuffer(faces), LABEL_SUBSET_FAMILY
        )
        prim = subset.GetPrim()
        prim.SetCustomDataByKey(NUMBER, part)
        if names[part] != name or prim.GetDisplayName():
            prim.SetDisplayName(names[part])
    for name in old.difference(kept):
        mesh.GetPrim().GetChild(name).SetActive(False)
    UsdGeom.Subset.SetFamilyType(mesh, LABEL_SUBSET_FAMILY, UsdGeom.Tokens.partition)


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
    with prefix_errors(path):
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
    order = reversed_winding(scene_mesh.polygons.counts, keep_first=True)
    return replace(
        scene_mesh,
        polygons=Polygons(scene_mesh.polygons.counts, scene_mesh.polygons.indices[order]),
        uvs=scene_mesh.uvs and scene_mesh.uvs.select(order),
        colours=scene_mesh.colours and scene_mesh.colours.select(order),
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
        return CornerValues(ensure_alpha(colours.values), colours.indices)
    return CornerValues.from_corners(np.hstack([colours.at_corners[:, :3], alpha.at_corners]))


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
        rows = indices[rows] if are_valid_indices(rows, len(indices)) else np.array([-1])
    if not are_valid_indices(rows, len(values)):
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
    if not are_valid_indices(rows, len(normals)) or not np.isfinite(normals).all():
        notes.add(mesh.GetPrim(), "normals do not fit the faces and are left out")
        return None
    return hard_edges_from_normals(animated.weld.polygons(polygons), normals[rows])


def rows_of_corners(interpolation: str, polygons: Polygons) -> NDArray[np.int32]:
    """Return the row of a primvar's value for every corner ``(corners,)``."""
    if interpolation == UsdGeom.Tokens.faceVarying:
        return np.arange(polygons.indices.size, dtype=np.int32)
    if interpolation == UsdGeom.Tokens.uniform:
        return np.repeat(np.arange(len(polygons.counts), dtype=np.int32), polygons.counts)
    if interpolation == UsdGeom.Tokens.constant:
        return np.zeros(polygons.indices.size, dtype=np.int32)
    return np.asarray(polygons.indices, dtype=np.int32)


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
    rest = base_face_set(str(whole.GetPath()), polygon_count, bound) if whole else ()
    return [*rest, *sets]


def _material(prim: Usd.Prim) -> UsdShade.Material | None:
    """Return the first material among those for all purposes, final renders, and previews."""
    bindings = UsdShade.MaterialBindingAPI(prim)
    found = (bindings.ComputeBoundMaterial(purpose)[0] for purpose in _PURPOSES)
    return next(filter(None, found), None)
