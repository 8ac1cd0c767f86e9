"""Writing of USD (.usd and .usdc binary, .usda text, .usdz packages), with points rounded to float32.

A sequence from a USD file becomes a layer over this file (`overlay`). Any other sequence becomes a stand-alone
component file, whose default prim ``/<name>`` is an Xform with one Mesh per object and materials in ``/<name>/Looks``.
Meshes are right-handed and in world space, or below a translation if they are far from zero. Normals are written only
for unsubdivided meshes with hard edges.

Materials are copied from the original's composed stage as flattened networks; connections that leave a material are
lost. Textures are not copied; their asset paths are rewritten. Parts are a family of subsets that partitions the faces
of every mesh.

Specification: https://openusd.org/release/glossary.html#usdglossary-component,
https://openusd.org/release/api/class_usd_geom_subset.html (families and their types)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pxr import Ar, Gf, Kind, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt

from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.mesh.surface import DEFAULT_COLOUR, CornerValues, FaceSet, Origin
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, IntArray
from mixseq_io.files import atomic_file
from mixseq_io.reader import validate_blocks, warn
from mixseq_io.scene_meshes import SceneMesh, format_names, split_meshes
from mixseq_io.surfaces import RoundingMonitor
from mixseq_io.text.labels import LABEL_SUBSET_FAMILY
from mixseq_io.usd.layers import (
    LocalSpace,
    SampledMesh,
    SampledNormals,
    SampledPrims,
    SampleWriter,
    compute_frame_values,
    declare_attributes,
    open_clip_folder,
    save_clips,
    write_package,
)
from mixseq_io.usd.motion import MeshMotion, TimeMap, find_skins
from mixseq_io.usd.overlay import (
    Original,
    author_overlay,
    author_sublayer,
    open_original,
    retime_other_attributes,
    warn_of_other_motion,
)
from mixseq_io.usd.stage import (
    PART_NUMBER_KEY,
    ROUNDING_TOLERANCE,
    UDIM_PLACEHOLDER,
    Identifiers,
    PrimWarnings,
    capture_diagnostics,
    define_prim_spec,
    identifier,
    is_prim_path,
    open_stage,
    relative_asset_path,
    save_layer,
    self_and_ancestors,
    translate_usd_read_errors,
    translate_usd_write_errors,
)


@dataclass(frozen=True, eq=False)
class FaceParts:
    """Part of every polygon ``(P,)`` of every mesh, and the names of the parts."""

    part_of_polygon: tuple[IntArray, ...]
    names: Sequence[str]


def _author_parts(layer: Sdf.Layer, paths: Sequence[str], parts: FaceParts, original: Original | None) -> None:
    """Author a subset for every part of every mesh; replace the part subsets of an earlier layer."""
    stage = Usd.Stage.Open(layer)
    for index, path in enumerate(paths):
        part_of_polygon = parts.part_of_polygon[index]
        if original:
            part_of_polygon = part_of_polygon[original.meshes[index].match.polygons]
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
        subsets = UsdGeom.Subset.GetGeomSubsets(mesh, "", LABEL_SUBSET_FAMILY)
        old = {subset.GetPrim().GetName() for subset in subsets}
        children = mesh.GetPrim().GetFilteredChildren(Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
        kept = {name for child in children if (name := child.GetName()) not in old}
        identifiers = Identifiers(*kept)
        for part in np.unique(part_of_polygon).tolist():
            name = identifiers.reserve(parts.names[part])
            kept.add(name)
            faces = Vt.IntArrayFromBuffer(np.flatnonzero(part_of_polygon == part).astype(np.int32))
            subset = UsdGeom.Subset.CreateGeomSubset(mesh, name, UsdGeom.Tokens.face, faces, LABEL_SUBSET_FAMILY)
            prim = subset.GetPrim()
            prim.SetCustomDataByKey(PART_NUMBER_KEY, part)
            if parts.names[part] != name or prim.GetDisplayName():
                prim.SetDisplayName(parts.names[part])
        for name in old.difference(kept):
            mesh.GetPrim().GetChild(name).SetActive(False)
        UsdGeom.Subset.SetFamilyType(mesh, LABEL_SUBSET_FAMILY, UsdGeom.Tokens.partition)


_LOOKS_SCOPE = "Looks"

_UV_NAME_INPUTS = {
    "UsdPrimvarReader_float2": "inputs:varname",
    "ND_UsdPrimvarReader_vector2": "inputs:varname",
    "ND_geompropvalue_vector2": "inputs:geomprop",
}
"""Name of the shader input that selects texture coordinates, by shader id."""


def _define_materials(
    stage: Usd.Stage, target: Path, scope: str, names: Iterable[str], origin: Origin | None
) -> Mapping[str, UsdShade.Material]:
    """Define materials below a scope; return the materials by name."""
    used = list(dict.fromkeys(names))
    if not used:
        return {}
    UsdGeom.Scope.Define(stage, scope)
    layer = stage.GetRootLayer()
    source = _flatten_materials(Path(origin.path), used) if origin and origin.format == "USD" else None
    identifiers = Identifiers()
    paths = {name: Sdf.Path(scope).AppendChild(identifiers.reserve(name.rpartition("/")[2])) for name in used}
    with Sdf.ChangeBlock():
        for name, path in paths.items():
            material = source.GetPrimAtPath(name) if source and is_prim_path(name) else None
            if source and material and material.typeName == "Material":
                _copy_material(source, name, layer, path)
            define_prim_spec(layer, path, "Material")
    materials = {name: UsdShade.Material.Get(stage, path) for name, path in paths.items()}
    empty = [name for name, each in materials.items() if not each.GetPrim().GetAuthoredProperties()]
    if empty and not _is_missing(origin):
        warn(f"{target}: materials are written by name only: {format_names(empty, str)}; bind them to networks again")
    origin_path = origin.path if origin else ""
    UsdUtils.ModifyAssetPaths(layer, lambda asset: _rebase_texture(target, asset, origin_path))
    return materials


def _is_missing(origin: Origin | None) -> bool:
    """Whether the original is a USD file that no longer exists."""
    return origin is not None and origin.format == "USD" and not Path(origin.path).is_file()


def _flatten_materials(origin: Path, materials: Iterable[str]) -> Sdf.Layer | None:
    """Return a flattened layer of a file with only the named materials, or None if the file cannot be read."""
    try:
        with translate_usd_read_errors(origin):
            original = open_stage(origin)
    except FormatError:
        return None
    mask = Usd.StagePopulationMask()
    session = Sdf.Layer.CreateAnonymous()
    for path in filter(is_prim_path, materials):
        mask.Add(path)
        for prim in self_and_ancestors(original.GetPrimAtPath(path)):
            if prim.IsInstance():
                Sdf.CreatePrimInLayer(session, prim.GetPath()).SetInfo("instanceable", False)
    return Usd.Stage.OpenMasked(original.GetRootLayer(), session, mask).Flatten()


def _copy_material(source: Sdf.Layer, name: str, layer: Sdf.Layer, path: Sdf.Path) -> None:
    Sdf.CopySpec(source, name, layer, path)
    disconnected = []
    for prim in _walk_specs(layer.GetPrimAtPath(path)):
        _read_written_uvs(prim)
        for attribute in prim.attributes:
            if any(not each.HasPrefix(path) for each in attribute.connectionPathList.explicitItems):
                attribute.connectionPathList.ClearEdits()
                disconnected.append(str(attribute.path))
    if disconnected:
        outside = format_names(disconnected, str)
        warn(f"the material {name} uses networks outside of it, which are left out at {outside}")


def _read_written_uvs(shader: Sdf.PrimSpec) -> None:
    """Set a shader's texture coordinate input to ``st``, the name of the written texture coordinates."""
    shader_id = shader.attributes.get("info:id")
    name = _UV_NAME_INPUTS.get(shader_id.default) if shader_id else None
    if name:
        if existing := shader.attributes.get(name):
            shader.RemoveProperty(existing)
        Sdf.AttributeSpec(shader, name, Sdf.ValueTypeNames.String).default = "st"


def _walk_specs(prim: Sdf.PrimSpec) -> Iterator[Sdf.PrimSpec]:
    yield prim
    for child in prim.nameChildren:
        yield from _walk_specs(child)


def _rebase_texture(target: Path, asset: str, origin: str) -> str:
    """Return a texture's asset path for use in the target; the texture may be inside a .usdz file."""
    # USD has made all paths absolute except for tiles in packages.
    if UDIM_PLACEHOLDER in asset and origin.endswith(".usdz") and not Path(asset).is_absolute():
        asset = Ar.JoinPackageRelativePath(origin, asset)
    outer, inner = Ar.SplitPackageRelativePathOuter(asset)
    file = Path(outer)
    if not (file.is_absolute() and file.parent.is_dir()):
        return asset
    path = relative_asset_path(file, target)
    return Ar.JoinPackageRelativePath(path, inner) if inner else path


def define_component(
    layer: Sdf.Layer, target: Path, header: SequenceHeader, has_velocities: bool, origin: Float
) -> SampledPrims:
    """Author a stand-alone file without samples, whose root is at an origin ``(3,)``; return the prims for samples."""
    stage = Usd.Stage.Open(layer)
    name = identifier(header.name)
    xform = UsdGeom.Xform.Define(stage, f"/{name}")
    if origin.any():
        xform.AddTranslateOp().Set(Gf.Vec3d(*origin.tolist()))
    space, root = LocalSpace.at_origin(origin), xform.GetPrim()
    _set_display_name(root, header.name)
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    scene_meshes = split_meshes(header)
    used = [each.material for scene_mesh in scene_meshes for each in scene_mesh.face_sets if each.material]
    materials = _define_materials(stage, target, f"/{name}/{_LOOKS_SCOPE}", used, header.surface.origin)
    meshes, identifiers = [], Identifiers(_LOOKS_SCOPE)
    for scene_mesh in scene_meshes:
        path = f"/{name}/{identifiers.reserve(scene_mesh.name)}"
        _define_mesh(stage, path, scene_mesh)
        _bind_materials(stage.GetPrimAtPath(path), target, scene_mesh, materials)
        normals = None
        if scene_mesh.hard_edges is not None and scene_mesh.subdivision == "none":
            normals = SampledNormals("normals", UsdGeom.Tokens.faceVarying, *[scene_mesh.hard_edges] * 2)
        mesh = SampledMesh(
            path=path,
            scene_mesh=scene_mesh,
            space=lambda time: space,
            normals=normals,
            has_velocities=has_velocities,
        )
        meshes.append(mesh)
    return SampledPrims(tuple(meshes))


def _define_mesh(stage: Usd.Stage, path: str, scene_mesh: SceneMesh) -> None:
    mesh = UsdGeom.Mesh.Define(stage, path)
    _set_display_name(mesh.GetPrim(), scene_mesh.name)
    mesh.CreateSubdivisionSchemeAttr(scene_mesh.subdivision)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArrayFromBuffer(scene_mesh.polygons.counts))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArrayFromBuffer(scene_mesh.polygons.indices))
    if scene_mesh.uvs is not None:
        UsdGeom.PrimvarsAPI(mesh).CreateIndexedPrimvar(
            "st",
            Sdf.ValueTypeNames.TexCoord2fArray,
            Vt.Vec2fArrayFromBuffer(scene_mesh.uvs.values),
            Vt.IntArrayFromBuffer(scene_mesh.uvs.indices),
            UsdGeom.Tokens.faceVarying,
        )
    if scene_mesh.colours is not None:
        _define_colours(mesh, scene_mesh, scene_mesh.colours)


def _define_colours(mesh: UsdGeom.Mesh, scene_mesh: SceneMesh, colours: CornerValues) -> None:
    """Author colours in the most compact interpolation, and opacities if any opacity is below 1."""
    vertices, values, indices = scene_mesh.polygons.indices, colours.values, None
    if len(values) == 1:
        interpolation = UsdGeom.Tokens.constant
    elif colours.one_per_vertex(vertices):
        interpolation = UsdGeom.Tokens.vertex
        values = colours.at_vertices(vertices, scene_mesh.vertex_count, DEFAULT_COLOUR)
    else:
        interpolation, indices = UsdGeom.Tokens.faceVarying, Vt.IntArrayFromBuffer(colours.indices)
    primvars = [mesh.CreateDisplayColorPrimvar(interpolation)]
    primvars[0].Set(Vt.Vec3fArrayFromBuffer(np.ascontiguousarray(values[:, :3])))
    if (values[:, 3] != 1).any():
        primvars.append(mesh.CreateDisplayOpacityPrimvar(interpolation))
        primvars[1].Set(Vt.FloatArrayFromBuffer(np.ascontiguousarray(values[:, 3])))
    if indices is not None:
        for primvar in primvars:
            primvar.SetIndices(indices)


def _set_display_name(prim: Usd.Prim, name: str) -> None:
    """Set the display name of a prim if the display name differs from the prim's name."""
    if prim.GetName() != name:
        prim.SetDisplayName(name)


def _bind_materials(
    prim: Usd.Prim, target: Path, scene_mesh: SceneMesh, materials: Mapping[str, UsdShade.Material]
) -> None:
    """Bind one material to the whole mesh, and other materials to non-overlapping subsets of its faces."""
    face_count = len(scene_mesh.polygons.counts)
    candidates = (each for each in scene_mesh.face_sets if each.material and each.polygons.size == face_count)
    whole = next(candidates, None)
    if whole:
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(materials[whole.material])
    owner_of_face = [""] * face_count
    identifiers = Identifiers()
    subsets = [(identifiers.reserve(each.name), each) for each in scene_mesh.face_sets if each is not whole]
    with Sdf.ChangeBlock():
        for name, _ in subsets:
            define_prim_spec(prim.GetStage().GetRootLayer(), prim.GetPath().AppendChild(name), "GeomSubset")
    for name, face_set in subsets:
        faces = face_set.polygons.tolist()
        if face_set.material:
            faces = _unassigned_faces(face_set, owner_of_face, f"{target}: {scene_mesh.name!r}")
        subset = UsdGeom.Subset.CreateGeomSubset(
            UsdGeom.Mesh(prim),
            name,
            UsdGeom.Tokens.face,
            Vt.IntArray(faces),
            UsdShade.Tokens.materialBind if face_set.material else "",
        )
        _set_display_name(subset.GetPrim(), face_set.name)
        if face_set.material:
            UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[face_set.material])
            for face in faces:
                owner_of_face[face] = face_set.name
    if any(owner_of_face):
        kind = UsdGeom.Tokens.partition if all(owner_of_face) else UsdGeom.Tokens.nonOverlapping
        UsdGeom.Subset.SetFamilyType(UsdGeom.Mesh(prim), UsdShade.Tokens.materialBind, kind)


def _unassigned_faces(face_set: FaceSet, owner_of_face: Sequence[str], location: str) -> list[int]:
    """Return the faces of a face set that have no material yet; warn of faces with another material."""
    faces: list[int] = face_set.polygons.tolist()
    owners = dict.fromkeys(repr(owner_of_face[face]) for face in faces if owner_of_face[face])
    if owners:
        warn(f"{location}: the material of {face_set.name!r} gives way to that of {', '.join(owners)}")
    return [face for face in faces if not owner_of_face[face]]


_RANGE_TOLERANCE_FRAMES = 1.0 - 1e-3
"""Distance in frames within which the first or last frame reaches an end of the motion."""


def author_time_range(layer: Sdf.Layer, header: SequenceHeader, time_map: TimeMap, original: Original | None) -> None:
    """Author units, rates and the time range.

    The time range contains the frames. If the frames reach an end of the motion of the original's meshes, the
    original's range is kept if longer at this end, since the meshes are static beyond.
    """
    layer.timeCodesPerSecond = layer.framesPerSecond = header.fps
    start, end = float(time_map.codes[0]), float(time_map.codes[-1])
    if original:
        stage = original.stage
        scale = time_map.rate / time_map.original_rate
        if scale == 1.0:
            layer.framesPerSecond = stage.GetFramesPerSecond()
        if stage.HasAuthoredTimeCodeRange() and time_map.source_times is None:
            first, last = _motion_range(original, start / scale, end / scale)
            if start < first * scale + _RANGE_TOLERANCE_FRAMES:
                start = min(start, _scale_code(stage.GetStartTimeCode(), scale, np.ceil))
            if end > last * scale - _RANGE_TOLERANCE_FRAMES:
                end = max(end, _scale_code(stage.GetEndTimeCode(), scale, np.floor))
    layer.startTimeCode, layer.endTimeCode = start, end
    layer.pseudoRoot.SetInfo("upAxis", header.up_axis)
    layer.pseudoRoot.SetInfo("metersPerUnit", header.metres_per_unit)


def _motion_range(original: Original, *default: float) -> tuple[float, float]:
    """Return the first and last time code of the meshes' motion, or the default for static meshes."""
    meshes = [matched.mesh for matched in original.meshes]
    skins = find_skins(meshes, PrimWarnings(original.path))
    motions = [MeshMotion(mesh, skins.get(mesh.GetPath())) for mesh in meshes]
    attributes = [attribute for motion in motions for attribute in motion.animated_attributes]
    codes = [code for attribute in attributes for code in attribute.GetTimeSamples()] or default
    return min(codes), max(codes)


def _scale_code(code: float, scale: float, round_inwards: Callable[[float], float]) -> float:
    """Convert an end of a time range to another rate; round a whole time code to a whole code within the range.

    Examples
    --------
    >>> _scale_code(1, 30 / 24, np.ceil), _scale_code(0.5, 30 / 24, np.ceil), _scale_code(1001, 29.97 / 999, np.floor)
    (2.0, 0.625, 30.0)
    """
    scaled, nearest = scale * code, np.rint(scale * code)
    if abs(scaled - nearest) <= ROUNDING_TOLERANCE * max(1.0, abs(scaled)):
        return float(nearest)
    return float(round_inwards(scaled)) if float(code).is_integer() else scaled


def write_usd(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | PathLike[str] | None = None,
    clips: int = 0,
    pack_from: str | PathLike[str] | None = None,
    sources: ArrayLike | None = None,
    whole_stage: bool = False,
    parts: FaceParts | None = None,
    rounding: RoundingMonitor | None = None,
) -> None:
    """Write a USD file; options as in `FORMATS`.

    `sources` ``(T,)`` are the original's times in s at the frames, NaN for frames without a single source time.
    `parts` are written as subsets of the faces; see `mixseq_io.text.label_files`.
    """
    is_package = path.suffix.lower() == ".usdz"
    _check_options(is_package, flatten, onto, clips, pack_from)
    if whole_stage and (flatten or is_package or sources is None):
        raise SettingsError(
            "whole_stage retimes what a layer is laid over; leave out flatten, write .usdc, and give sources=..., the "
            "time of the original that every frame shows"
        )
    check_up_axis(path, header)
    original = _open_original(path, header, flatten, onto)
    if whole_stage and not original:
        raise OutputError(f"{path} stands alone, without a stage that could be retimed; leave out whole_stage")
    times = None if sources is None else np.asarray(sources, dtype=np.float64)
    original_rate = original.stage.GetTimeCodesPerSecond() if original else header.fps
    time_map = TimeMap.from_header(header, original_rate, times if whole_stage else None)
    _, frame_blocks = validate_blocks(header, blocks, velocities)
    monitor = rounding or RoundingMonitor(path, "USD", header)
    with open_clip_folder(path) as folder, new_layer(path, header, pack_from) as layer:
        author_time_range(layer, header, time_map, original)
        has_velocities = velocities is not None
        if original:
            prims = author_overlay(layer, path, original, time_map, has_velocities)
        else:
            prims = define_component(layer, path, header, has_velocities, monitor.origin)
        declare_attributes(layer, prims)
        if original and whole_stage:
            retime_other_attributes(layer, path, original, time_map)
        elif original and times is not None:
            warn_of_other_motion(path, header, original, times)
        if parts is not None:
            _author_parts(layer, [mesh.path for mesh in prims.meshes], parts, original)
        frames = compute_frame_values(prims, time_map.codes, header.times, frame_blocks, monitor)
        if clips:
            folder.make()
            save_clips(layer, prims, frames, clips, folder)
            folder.install()
        else:
            samples = SampleWriter(layer)
            for frame in frames:
                samples.put(frame)
    if not clips:
        folder.warn_if_unused()


@contextmanager
def new_layer(
    path: Path,
    header: SequenceHeader,
    pack_from: str | PathLike[str] | None = None,
    check: Callable[[Path], object] | None = None,
) -> Iterator[Sdf.Layer]:
    """Yield an empty layer, and save it to a file if the block raises no error; see `atomic_file` for `check`.

    A .usdz file also packs textures: those in the original's folder, or in the package that it is, and in `pack_from`.
    """
    left_out: list[str] = []
    is_package = path.suffix.lower() == ".usdz"
    with atomic_file(path, check) as temporary, capture_diagnostics(), translate_usd_write_errors(path):
        layer = Sdf.Layer.CreateNew(str(temporary.with_suffix(".usdc") if is_package else temporary))
        yield layer
        save_layer(layer)
        if is_package:
            origin = header.surface.origin
            original = [Path(origin.path)] if origin and origin.format == "USD" else []
            folders = [
                *original,
                *(file.parent for file in original),
                *([] if pack_from is None else [Path(pack_from)]),
            ]
            left_out = write_package(layer, temporary, path.with_suffix(".usdc").name, folders)
    if left_out:
        warn(
            f"{path}: only textures that exist in the original's folder are packed, not {format_names(left_out, str)}; "
            "if these may be shared, name their folder with pack_from=... (--pack-from)"
        )


def write_usd_parts(path: Path, header: SequenceHeader, parts: FaceParts) -> bool:
    """Write a layer over a sequence's original that only adds parts; return whether the layer was written."""
    original = _open_original(path, header, flatten=False, onto=None)
    if original is None:
        return False
    with new_layer(path, header) as layer:
        time_map = TimeMap.from_header(header, original.stage.GetTimeCodesPerSecond())
        author_time_range(layer, header, time_map, original)
        author_sublayer(layer, path, original)
        paths = [str(matched.mesh.GetPath()) for matched in original.meshes]
        _author_parts(layer, paths, parts, original)
    return True


def check_up_axis(path: Path, header: SequenceHeader) -> None:
    """Raise an error if USD does not support the sequence's up axis."""
    if header.up_axis == "X":
        raise OutputError(
            f"{path}: USD stages have Y or Z up, this mesh has X; turn it with convert_units (--convert-axes Y), or "
            "write .npz or .h5"
        )


def _check_options(is_package: bool, flatten: bool, onto: object, clips: int, pack_from: object) -> None:
    if clips < 0:
        raise SettingsError(f"clips is {clips}; give the number of frames per file, or 0 for a single file")
    if onto is not None and flatten:
        raise SettingsError("a flattened USD file stands alone; leave out either onto or flatten")
    if is_package and (onto is not None or clips):
        raise SettingsError("a .usdz file has everything in itself; leave out onto and clips, or write .usdc")
    if pack_from is not None and not is_package:
        raise SettingsError("only .usdz files have textures packed; leave out pack_from, or write .usdz")


def _open_original(
    path: Path, header: SequenceHeader, flatten: bool, onto: str | PathLike[str] | None
) -> Original | None:
    """Open the original file for a layer over it; return None if a stand-alone file is to be written."""
    origin = header.surface.origin
    origin_path = origin.path if origin and origin.format == "USD" else None
    if onto is None and origin_path is None:
        return None
    file = Path(onto or origin_path or "")
    loses_materials = _is_missing(origin) and any(each.material for each in header.surface.face_sets)
    loss = ", and materials are written by name only" if loses_materials else ""
    if not flatten:
        check_not_overwritten(path, file)
    if flatten or path.suffix.lower() == ".usdz":
        if _is_missing(origin) and (loss or not flatten):
            warn(f"{path} stands alone: the original {file} is gone{loss}")
        elif not flatten:
            warn(f"{path} stands alone, as .usdz files do: only the mesh and its materials are kept of {file}")
        return None
    try:
        with capture_diagnostics():
            return open_original(file, header)
    except OutputError as error:
        if onto is not None:
            raise
        warn(f"{path} stands alone: {error}{loss}; onto=... (--onto) names the file where it is now")
        return None


def check_not_overwritten(path: Path, original: Path) -> None:
    """Raise an error if `path` is the original, or a layer that the original uses."""
    if not path.exists():
        return
    stage = None
    with suppress(FormatError), capture_diagnostics(), translate_usd_read_errors(original):
        stage = open_stage(original)
    layers = stage.GetUsedLayers() if stage else []
    files = [Path(Ar.SplitPackageRelativePathOuter(each.realPath)[0]) for each in layers if each.realPath]
    if any(each.exists() and each.samefile(path) for each in (original, *files)):
        raise OutputError(f"{path} is the original, or a layer that it uses, and would be lost; write to another name")
