"""USD layers with new points over an existing file, whose other contents are kept.

The file becomes a sublayer. The layer overrides points, extents, velocities, and authored normals that renderers use.
If the file has another ``timeCodesPerSecond``, USD scales its time codes, so that times in seconds stay. Meshes are
unbound from skeletons and blend shapes. Stale velocities and accelerations are blocked
(https://openusd.org/release/api/class_sdf_value_block.html), and instances become ordinary prims.

The layer's points contain the whole motion of a mesh, so transforms above the mesh are frozen. The carrier is the
outermost prim whose transform affects only this mesh. Operations up to the carrier keep their value at the first frame.
Inverse operations on the carrier, with equal samples, cancel animation above it. ``!resetXformStack!`` is unsuitable:
Blender 5 ignores it, Hydra 2 if alone (https://github.com/PixarAnimationStudios/OpenUSD/issues/3781), and it would
detach the mesh from referencing prims. Other motion (cameras, hair, lights, materials) keeps its times, or is retimed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import FormatError, OutputError
from mixseq.mesh.polygons import PolygonMatch, Polygons, reversed_winding
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import (
    SceneMesh,
    describe_difference_up_to_winding,
    format_names,
    is_retimed,
    match_meshes,
)
from mixseq_io.surfaces import are_valid_indices
from mixseq_io.usd.layers import (
    WORLD_SPACE,
    LocalSpace,
    LocalSpaceAt,
    SampledExtent,
    SampledMesh,
    SampledNormals,
    SampledPrims,
    SampleWriter,
    attribute_spec,
    override_spec,
)
from mixseq_io.usd.motion import (
    VERTICES_ATTRIBUTE,
    MeshMotion,
    Skin,
    TimeMap,
    Weld,
    find_skins,
)
from mixseq_io.usd.stage import (
    PrimWarnings,
    TransformOps,
    WorldTransform,
    compose_ops,
    is_animated,
    is_spline,
    open_stage,
    relative_asset_path,
    self_and_ancestors,
    transform_ops,
    translate_usd_read_errors,
    traverse_prims,
)

_INVERSE_PREFIX = "!invert!"


@dataclass(frozen=True, eq=False)
class Freeze:
    """Operations above a mesh by treatment: frozen up to the carrier, inverted above, and constant outermost ones."""

    carrier: Usd.Prim
    own_ops: TransformOps
    inverted_ops: TransformOps
    constant_ops: TransformOps

    def author(self, layer: Sdf.Layer, time_map: TimeMap) -> None:
        """Author the values of own operations at the layer's first frame, and inverse operations on the carrier."""
        for attribute in dict.fromkeys(op.GetAttr() for op in self.own_ops):
            if is_animated(attribute):
                spec = attribute_spec(layer, str(attribute.GetPath()), attribute.GetTypeName())
                spec.default = attribute.Get(Usd.TimeCode(time_map.original_code(time_map.start_time)))
        ops = self.inverted_ops
        if not ops:
            return
        attributes = dict.fromkeys(op.GetAttr() for op in ops)
        names = {attribute: self._copy(layer, attribute, time_map) for attribute in attributes}
        # The order attribute starts with the outermost operation, which is the inverse of the innermost operation.
        inverses = [("" if op.IsInverseOp() else _INVERSE_PREFIX) + names[op.GetAttr()] for op in ops]
        order = UsdGeom.Xformable(self.carrier).GetXformOpOrderAttr()
        override_spec(layer, order).default = Vt.TokenArray([*inverses, *(order.Get() or ())])

    def _copy(self, layer: Sdf.Layer, attribute: Usd.Attribute, time_map: TimeMap) -> str:
        """Copy an attribute of an ancestor to the carrier; return its new name."""
        name = f"{attribute.GetName()}:undo{attribute.GetPath().pathElementCount - 1}"
        while self.carrier.HasAttribute(name):
            name += "_"
        path = f"{self.carrier.GetPath()}.{name}"
        spec = attribute_spec(layer, path, attribute.GetTypeName())
        if not is_animated(attribute):
            spec.default = attribute.Get(Usd.TimeCode.EarliestTime())
        elif is_spline(attribute) and time_map.source_times is None:
            raise OutputError(
                f"{attribute.GetPath()} is a spline; bake it into time samples, or write a stand-alone file with "
                "flatten=True (--flatten)"
            )
        else:
            for code, value in time_map.samples(attribute):
                layer.SetTimeSample(path, code, value)
        return name


def find_freeze(mesh: Usd.Prim) -> Freeze | None:
    """Return the freeze of a mesh; None if no transform moves the mesh, or if it has no carrier."""
    carrier = _find_carrier(mesh)
    if carrier is None or not WorldTransform(mesh).is_animated:
        return None
    ops = tuple(transform_ops(mesh))
    own_end = sum(op.GetAttr().GetPath().HasPrefix(carrier.GetPath()) for op in ops)
    animated_end = max(end for end, op in enumerate(ops, 1) if is_animated(op.GetAttr()))
    return Freeze(carrier, ops[:own_end], ops[own_end:animated_end], ops[max(own_end, animated_end) :])


def _find_carrier(mesh: Usd.Prim) -> Usd.Prim | None:
    """Return the outermost transformable prim whose transform affects only this mesh, if any."""
    carrier = None
    for prim in self_and_ancestors(mesh):
        descendants = Usd.PrimRange(prim, Usd.TraverseInstanceProxies())
        others = (other for other in descendants if not mesh.GetPath().HasPrefix(other.GetPath()))
        if UsdSkel.Root(prim) or any(map(UsdGeom.Xformable, others)):  # a SkelRoot's extent is in its local space
            return carrier
        carrier = prim if UsdGeom.Xformable(prim) else carrier
    return carrier


@dataclass(frozen=True, eq=False)
class MatchedMesh:
    """Mesh of the sequence matched with a mesh of the original.

    `corner_points` ``(C,)`` are the points at the original's corners. `match` maps the original's polygons and corners
    to the sequence; with `is_reversed`, the corner orders are opposite.
    """

    scene_mesh: SceneMesh
    mesh: UsdGeom.Mesh
    corner_points: IntArray
    match: PolygonMatch
    is_reversed: bool
    weld: Weld


@dataclass(frozen=True, eq=False)
class Original:
    """File below the layer, and its meshes matched with the sequence's meshes."""

    path: Path
    stage: Usd.Stage
    meshes: tuple[MatchedMesh, ...]


def open_original(path: Path, header: SequenceHeader) -> Original:
    """Open a file for a layer over it; raise an error if its meshes do not match the sequence."""
    try:
        with translate_usd_read_errors(path):
            stage = open_stage(path)
    except FormatError as error:
        raise OutputError(str(error)) from error
    up = str(UsdGeom.GetStageUpAxis(stage))
    if up != header.up_axis:
        raise OutputError(
            f"{path} has {up} up, the sequence {header.up_axis}; convert_units (--convert-axes {up}) turns it"
        )
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    if not np.isclose(unit, header.metres_per_unit, rtol=1e-6):
        raise OutputError(
            f"{path} has units of {unit:g} m, the sequence of {header.metres_per_unit:g} m; convert_units "
            f"(--convert-units {unit:g}) scales it"
        )
    rate = stage.GetTimeCodesPerSecond()
    if not 0 < rate < np.inf:
        raise OutputError(f"{path} has {rate:g} time codes per second, a positive number is needed")
    try:
        meshes = {str(prim.GetPath()): mesh for prim in traverse_prims(path, stage) if (mesh := UsdGeom.Mesh(prim))}
        return Original(path, stage, tuple(match_meshes(path, header, meshes, _match_mesh, _describe_difference)))
    except FormatError as error:
        raise OutputError(str(error)) from error


def _describe_difference(scene_mesh: SceneMesh, mesh: UsdGeom.Mesh) -> str:
    """Describe the first difference from the only candidate mesh, or return "" if the candidate is invalid."""
    point_polygons, points = _read_polygons(mesh)
    if point_polygons is None:
        return ""
    for weld in (Weld.from_mesh(mesh, points), Weld.identity(len(points))):
        if weld.vertex_count == scene_mesh.vertex_count:
            stored = weld.weld_polygons(point_polygons)
            return describe_difference_up_to_winding(scene_mesh.polygons, stored, str(mesh.GetPath()))
    return f"it has {len(points)} points, the sequence {scene_mesh.vertex_count} vertices"


def _match_mesh(scene_mesh: SceneMesh, mesh: UsdGeom.Mesh) -> MatchedMesh | None:
    """Match a mesh of the sequence with a mesh of the file; return None if their faces differ."""
    point_polygons, points = _read_polygons(mesh)
    if point_polygons is None:
        return None
    reverse = reversed_winding(point_polygons.counts, keep_first=True)
    # A sequence from another file may have a vertex for every point.
    for weld in (Weld.from_mesh(mesh, points), Weld.identity(len(points))):
        if weld.vertex_count != scene_mesh.vertex_count:
            continue
        for is_reversed in (False, True):  # the reader reverses left-handed faces
            order = reverse if is_reversed else None
            if matched := scene_mesh.match(weld.weld_polygons(point_polygons), order):
                return MatchedMesh(matched[0], mesh, point_polygons.indices, matched[1], is_reversed, weld)
    return None


def _read_polygons(mesh: UsdGeom.Mesh) -> tuple[Polygons | None, FloatArray]:
    """Return a mesh's polygons, or None if invalid, and its points ``(P, 3)``."""
    earliest = Usd.TimeCode.EarliestTime()
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(earliest) or (), dtype=np.int32)
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get(earliest) or (), dtype=np.int32)
    points = np.array(mesh.GetPointsAttr().Get(earliest) or np.zeros((0, 3)), dtype=np.float32)
    is_valid = points.shape[1:] == (3,) and counts.min(initial=3) >= 3 and counts.sum() == indices.size
    is_valid = is_valid and are_valid_indices(indices, len(points))
    return (Polygons(counts, indices) if is_valid else None), points


_COPIED_METADATA = (
    "defaultPrim",
    "expressionVariables",
    "kilogramsPerUnit",
    "renderSettingsPrimPath",
    "colorConfiguration",
    "colorManagementSystem",
)
"""Names of the metadata that USD reads only from the root layer."""


def author_overlay(
    layer: Sdf.Layer, target: Path, original: Original, time_map: TimeMap, has_velocities: bool
) -> SampledPrims:
    """Author the layer without samples, and return the prims that get samples."""
    author_sublayer(layer, target, original)
    moving = [matched for matched in original.meshes if WorldTransform(matched.mesh.GetPrim()).is_animated]
    freezes = {matched: freeze for matched in moving if (freeze := find_freeze(matched.mesh.GetPrim()))}
    for freeze in freezes.values():
        freeze.author(layer, time_map)
    if not_frozen := [str(matched.mesh.GetPath()) for matched in moving if matched not in freezes]:
        warn(
            f"{target}: meshes with other things below them still move with their parents, between frames and "
            f"beyond them, and have no velocities: {format_names(not_frozen, str)}; flatten keeps everything"
        )
    meshes = tuple(
        SampledMesh(
            path=str(matched.mesh.GetPath()),
            scene_mesh=matched.scene_mesh,
            vertex_of_point=None if matched.weld.is_identity else matched.weld.vertex_of_point,
            space=_local_space(original, matched.mesh.GetPrim(), time_map, freezes.get(matched)),
            normals=_replace_normals(matched),
            has_velocities=has_velocities and (matched in freezes or matched not in moving),
        )
        for matched in original.meshes
    )
    for matched, sampled in zip(original.meshes, meshes, strict=True):
        _block_stale_attributes(layer, matched.mesh, sampled)
        _set_orientation(layer, matched, sampled, time_map.start_time)
        _store_vertices(layer, matched)
    return SampledPrims(meshes, _root_extents(original, time_map))


def author_sublayer(layer: Sdf.Layer, target: Path, original: Original) -> None:
    """Add a file to an empty layer as its sublayer."""
    layer.subLayerPaths.append(relative_asset_path(original.path, target))
    below = original.stage.GetRootLayer()
    for key in _COPIED_METADATA:
        if below.pseudoRoot.HasInfo(key):
            layer.pseudoRoot.SetInfo(key, below.pseudoRoot.GetInfo(key))
    disable_instancing(layer, target, [matched.mesh.GetPrim() for matched in original.meshes])


def disable_instancing(layer: Sdf.Layer, target: Path, prims: Iterable[Usd.Prim]) -> None:
    """Turn instances above the given prims into ordinary prims, which can be overridden."""
    instances = [each for prim in prims for each in self_and_ancestors(prim) if each.IsInstance()]
    paths = list(dict.fromkeys(str(prim.GetPath()) for prim in instances))
    for path in paths:
        Sdf.CreatePrimInLayer(layer, path).SetInfo("instanceable", False)
    if paths:
        warn(f"{target}: instances with moving meshes are instances no longer: {format_names(paths, str)}")


def _local_space(original: Original, prim: Usd.Prim, time_map: TimeMap, freeze: Freeze | None = None) -> LocalSpaceAt:
    transform = WorldTransform(prim)

    def check_invertible(matrix: Gf.Matrix4d, time: float) -> None:
        if np.linalg.matrix_rank(np.array(matrix)[:3, :3]) < 3:
            raise OutputError(
                f"{original.path}: the transform of {prim.GetPath()} is singular at {time:g} s, for example by a scale "
                "of 0, so that its points cannot reach all places; write a stand-alone file with flatten=True "
                "(--flatten)"
            )

    def space_of(matrix: Gf.Matrix4d, time: float) -> LocalSpace:
        if matrix == Gf.Matrix4d(1.0):
            return WORLD_SPACE
        check_invertible(matrix, time)
        to_world = np.array(matrix, dtype=np.float64)
        return LocalSpace(to_world, np.asarray(np.linalg.inv(to_world), dtype=np.float64))

    if not freeze and transform.is_animated:
        return lambda time: space_of(transform.at(time_map.original_code(time)), time)
    start = time_map.start_time
    matrix = transform.at(0.0)
    if freeze:
        matrix = compose_ops((*freeze.own_ops, *freeze.constant_ops), time_map.original_code(start))
    constant_space = space_of(matrix, start)

    def frozen_space(time: float) -> LocalSpace:
        if freeze:
            check_invertible(compose_ops(freeze.inverted_ops, time_map.original_code(time)), time)
        return constant_space

    return frozen_space


def _replace_normals(matched: MatchedMesh) -> SampledNormals | None:
    """Return the samples that replace authored normals; None if normals are missing or the mesh is subdivided."""
    mesh, scene_mesh = matched.mesh, matched.scene_mesh
    if mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none:
        return None
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")  # takes precedence over the attribute
    if primvar.HasAuthoredValue():
        attribute, interpolation = "primvars:normals", primvar.GetInterpolation()
    elif mesh.GetNormalsAttr().HasAuthoredValue():
        attribute, interpolation = "normals", mesh.GetNormalsInterpolation()
    else:
        return None
    group_of_corner = scene_mesh.normal_groups[matched.match.corners]
    groups: IntArray | None = scene_mesh.normal_groups
    order: IntArray | None = group_of_corner
    if interpolation == UsdGeom.Tokens.uniform:
        counts = scene_mesh.polygons.counts
        groups, order = np.repeat(np.arange(len(counts)), counts), matched.match.polygons
    elif interpolation != UsdGeom.Tokens.faceVarying:
        interpolation = UsdGeom.Tokens.vertex
        order = np.zeros(len(matched.weld.vertex_of_point), dtype=np.int64)
        order[matched.corner_points] = group_of_corner  # all corners of a point share a normal
        if matched.weld.is_identity:
            groups = order = None
    return SampledNormals(attribute, interpolation, groups, order)


def _block_stale_attributes(layer: Sdf.Layer, mesh: UsdGeom.Mesh, sampled: SampledMesh) -> None:
    """Block attributes that belong to the old points, and unbind skeletons and blend shapes."""
    prim = mesh.GetPrim()
    is_bound = any(UsdSkel.BindingAPI(each) for each in self_and_ancestors(prim))
    stale = [prim.GetAttribute(name) for name in ("velocities", "accelerations", "primvars:normals:indices")]
    if is_bound:
        stale += [each for each in prim.GetAuthoredAttributes() if _is_skel_property(each.GetName())]
    for attribute in stale:
        if attribute.HasAuthoredValue() and attribute.GetName() not in sampled.attributes:
            override_spec(layer, attribute).default = Sdf.ValueBlock()
    if is_bound:  # overriding an ancestor's binding requires the schema on the mesh
        spec = Sdf.CreatePrimInLayer(layer, sampled.path)
        if not UsdSkel.BindingAPI(prim):
            spec.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["SkelBindingAPI"]))
        names = [each.GetName() for each in prim.GetAuthoredRelationships()]
        for name in {"skel:skeleton", *filter(_is_skel_property, names)}:
            unbound = Sdf.RelationshipSpec(spec, name, False, Sdf.VariabilityUniform)
            unbound.targetPathList.ClearEditsAndMakeExplicit()
    for ancestor in self_and_ancestors(prim):
        hint = ancestor.GetAttribute("extentsHint")
        if hint and hint.HasAuthoredValue():
            override_spec(layer, hint).default = Sdf.ValueBlock()


def _is_skel_property(name: str) -> bool:
    return name.startswith(("skel:", "primvars:skel:"))


def _set_orientation(layer: Sdf.Layer, matched: MatchedMesh, sampled: SampledMesh, start: float) -> None:
    """Override the orientation if the layer changes whether the transform to the world mirrors the mesh."""
    if not matched.corner_points.size:
        return
    tokens, orientation = UsdGeom.Tokens, matched.mesh.GetOrientationAttr()
    is_mirrored = np.linalg.det(sampled.space(start).to_world[:3, :3]) < 0
    # Faces of the sequence are counter-clockwise in the world; the mesh's faces are clockwise if reversed.
    is_left_handed = matched.is_reversed != is_mirrored
    if is_left_handed != (orientation.Get() == tokens.leftHanded):
        override_spec(layer, orientation).default = tokens.leftHanded if is_left_handed else tokens.rightHanded


def _store_vertices(layer: Sdf.Layer, matched: MatchedMesh) -> None:
    """Store the vertex of every point, since readers cannot derive it from time-sampled points."""
    if matched.weld.is_identity:
        return
    path = f"{matched.mesh.GetPath()}.{VERTICES_ATTRIBUTE}"
    spec = attribute_spec(layer, path, Sdf.ValueTypeNames.IntArray, Sdf.VariabilityUniform)
    spec.custom = True
    spec.default = Vt.IntArrayFromBuffer(matched.weld.vertex_of_point.astype(np.int32))


def _root_extents(original: Original, time_map: TimeMap) -> tuple[SampledExtent, ...]:
    """Return the extents of SkelRoots above the meshes, which take precedence over extents of the meshes."""
    meshes_of_root: dict[Usd.Prim, list[SceneMesh]] = {}
    for matched in original.meshes:
        for prim in self_and_ancestors(matched.mesh.GetPrim()):
            if UsdSkel.Root(prim):
                meshes_of_root.setdefault(prim, []).append(matched.scene_mesh)
    return tuple(
        SampledExtent(
            path=str(root.GetPath()),
            scene_meshes=tuple(scene_meshes),
            space=_local_space(original, root, time_map),
            other_corners=_original_extent(root, time_map, len(scene_meshes)),
        )
        for root, scene_meshes in meshes_of_root.items()
    )


def _original_extent(root: Usd.Prim, time_map: TimeMap, mesh_count: int) -> Callable[[float], FloatArray]:
    """Return a SkelRoot's original extent as a function of time, empty without contents outside the sequence."""
    empty = np.zeros((0, 3))
    gprims = [each for each in Usd.PrimRange(root, Usd.TraverseInstanceProxies()) if UsdGeom.Gprim(each)]
    if len(gprims) <= mesh_count:
        return lambda time: empty
    boundable = UsdGeom.Boundable(root)

    def extent_at(time: float) -> FloatArray:
        code = Usd.TimeCode(time_map.original_code(time))
        extent = boundable.GetExtentAttr().Get(code)
        extent = extent or UsdGeom.Boundable.ComputeExtentFromPlugins(boundable, code)
        return empty if extent is None else np.array(extent, dtype=np.float64)

    return extent_at


def warn_of_other_motion(target: Path, header: SequenceHeader, original: Original, times: NDArray[np.float64]) -> None:
    """Warn of animated visible prims outside the sequence if it is retimed to source times ``(T,)`` in s."""
    if not is_retimed(header, times):
        return
    cure = "; whole_stage=True (--whole-stage) retimes everything" if np.isfinite(times).all() else ""
    matched_paths = {matched.mesh.GetPath() for matched in original.meshes}
    prims = traverse_prims(original.path, original.stage)
    others = [prim for prim in prims if prim.GetPath() not in matched_paths]
    meshes = [mesh for prim in others if (mesh := UsdGeom.Mesh(prim))]
    skins = find_skins(meshes, PrimWarnings(original.path))
    animated = [prim for prim in others if _is_visible_type(prim) and _is_animated_prim(prim, skins)]
    if paths := [str(prim.GetPath()) for prim in animated]:
        warn(f"{target}: other motion in {original.path} is not retimed: {format_names(paths, str)}{cure}")


def retime_other_attributes(layer: Sdf.Layer, target: Path, original: Original, time_map: TimeMap) -> None:
    """Author retimed samples of the original's animated attributes that the layer does not override yet."""
    prims = Usd.PrimRange.Stage(original.stage, Usd.TraverseInstanceProxies())
    attributes = [
        attribute
        for prim in prims
        for attribute in _animated_attributes(prim)
        if not layer.GetAttributeAtPath(attribute.GetPath())
    ]
    disable_instancing(layer, target, [attribute.GetPrim() for attribute in attributes])
    samples = SampleWriter(layer)
    for attribute in attributes:
        path = str(attribute.GetPath())
        override_spec(layer, attribute)
        for code, value in time_map.samples(attribute):
            samples.put((code, {path: _rebase_asset_path(target, value)}))


def _is_visible_type(prim: Usd.Prim) -> bool:
    """Whether a prim has a visible type, which excludes groups, skeletons and skeletal animations."""
    schemas = (UsdGeom.Scope, UsdSkel.Root, UsdSkel.Skeleton, UsdSkel.Animation)
    return prim.GetTypeName() not in ("", "Xform") and not any(schema(prim) for schema in schemas)


def _is_animated_prim(prim: Usd.Prim, skins: Mapping[Sdf.Path, Skin]) -> bool:
    if mesh := UsdGeom.Mesh(prim):
        return bool(MeshMotion(mesh, skins.get(prim.GetPath())).animated_attributes)
    is_moving = bool(UsdGeom.Xformable(prim)) and WorldTransform(prim).is_animated
    return is_moving or any(True for _ in _animated_attributes(prim))


def _animated_attributes(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    return (each for each in prim.GetAuthoredAttributes() if each.ValueMightBeTimeVarying())


def _rebase_asset_path(target: Path, value: Any) -> Any:
    """Return an attribute value, with an asset path rewritten for the target file."""
    if isinstance(value, Sdf.AssetPath) and value.resolvedPath:
        return Sdf.AssetPath(relative_asset_path(Path(value.resolvedPath), target))
    return value
