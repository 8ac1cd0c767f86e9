"""USD, writing (.usd and .usdc binary, .usda text, .usdz packages), points rounded to float32.

Sequences from a USD file become a layer over it (`overlay`), others a stand-alone component file: the default prim
``/<name>`` is an Xform with one Mesh per object and the materials in ``/<name>/Looks``. Meshes are right-handed and in
world space. Normals are written only for hard edges on meshes without subdivision.

Specification: https://openusd.org/release/glossary.html#usdglossary-component
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pxr import Ar, Kind, Sdf, Usd, UsdGeom, UsdShade, Vt

from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.mesh.surface import DEFAULT_COLOUR, CornerValues, FaceSet
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.files import atomic_file
from mixseq_io.reader import validate_blocks, warn
from mixseq_io.scene_meshes import SceneMesh, split_meshes
from mixseq_io.usd.layers import (
    Cast,
    Frame,
    Normals,
    Placed,
    declare,
    frames,
    new_folder,
    pack,
    save,
    save_in_clips,
)
from mixseq_io.usd.motion import Mover, Shown, shown_by, skins_of, source_times
from mixseq_io.usd.overlay import Original, lay_over, open_original, put_over, retime_rest, warn_of_rest
from mixseq_io.usd.stage import (
    Identifiers,
    Notes,
    define,
    identifier,
    open_stage,
    quiet,
    save_layer,
    shortened,
    translate_usd_read_errors,
    translate_usd_write_errors,
)
from mixseq_io.usd.surface import Parts, define_materials, is_gone, write_parts

_LOOKS = "Looks"


def define_component(layer: Sdf.Layer, target: Path, header: SequenceHeader, velocities: bool) -> Cast:
    """Author everything but samples, and return the prims that get them."""
    stage = Usd.Stage.Open(layer)
    name = identifier(header.name)
    root = UsdGeom.Xform.Define(stage, f"/{name}")
    _show_name(root.GetPrim(), header.name)
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kind.Tokens.component)
    scene_meshes = split_meshes(header)
    wanted = [each.material for scene_mesh in scene_meshes for each in scene_mesh.face_sets if each.material]
    materials = define_materials(stage, target, f"/{name}/{_LOOKS}", wanted, header.surface.origin)
    placed, names = [], Identifiers(_LOOKS)
    for scene_mesh in scene_meshes:
        path = f"/{name}/{names.take(scene_mesh.name)}"
        _define_mesh(stage, path, scene_mesh)
        _bind(stage.GetPrimAtPath(path), target, scene_mesh, materials)
        placed.append(
            Placed(path=path, scene_mesh=scene_mesh, normals=_normals(scene_mesh), velocities=velocities)
        )
    return Cast(tuple(placed))


def _define_mesh(stage: Usd.Stage, path: str, scene_mesh: SceneMesh) -> None:
    mesh = UsdGeom.Mesh.Define(stage, path)
    _show_name(mesh.GetPrim(), scene_mesh.name)
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
    """Author colours in the interpolation with the fewest numbers; opacity if any is below 1."""
    vertices, values, rows = scene_mesh.polygons.indices, colours.values, None
    if len(values) == 1:
        interpolation = UsdGeom.Tokens.constant
    elif colours.one_per_vertex(vertices):
        interpolation = UsdGeom.Tokens.vertex
        values = colours.at_vertices(vertices, scene_mesh.vertex_count, DEFAULT_COLOUR)
    else:
        interpolation, rows = UsdGeom.Tokens.faceVarying, Vt.IntArrayFromBuffer(colours.indices)
    primvars = [mesh.CreateDisplayColorPrimvar(interpolation)]
    primvars[0].Set(Vt.Vec3fArrayFromBuffer(np.ascontiguousarray(values[:, :3])))
    if (values[:, 3] != 1).any():
        primvars.append(mesh.CreateDisplayOpacityPrimvar(interpolation))
        primvars[1].Set(Vt.FloatArrayFromBuffer(np.ascontiguousarray(values[:, 3])))
    if rows is not None:
        for each in primvars:
            each.SetIndices(rows)


def _show_name(prim: Usd.Prim, name: str) -> None:
    """Store a name that is invalid for a prim as its display name."""
    if prim.GetName() != name:
        prim.SetDisplayName(name)


def _normals(scene_mesh: SceneMesh) -> Normals | None:
    if scene_mesh.hard_edges is None or scene_mesh.subdivision != "none":
        return None
    return Normals(
        attribute="normals",
        interpolation=UsdGeom.Tokens.faceVarying,
        groups=scene_mesh.hard_edges,
        order=scene_mesh.hard_edges,
    )


def _bind(
    prim: Usd.Prim, target: Path, scene_mesh: SceneMesh, materials: Mapping[str, UsdShade.Material]
) -> None:
    """Bind a material to the whole mesh, and others to non-overlapping subsets of its faces."""
    count = len(scene_mesh.polygons.counts)
    whole = next(
        (each for each in scene_mesh.face_sets if each.material and each.polygons.size == count), None
    )
    if whole:
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(materials[whole.material])
    owners = [""] * count
    names = Identifiers()
    subsets = [(names.take(each.name), each) for each in scene_mesh.face_sets if each is not whole]
    with Sdf.ChangeBlock():
        for name, _ in subsets:
            define(prim.GetStage().GetRootLayer(), prim.GetPath().AppendChild(name), "GeomSubset")
    for name, each in subsets:
        faces = (
            _unowned(each, owners, f"{target}: {scene_mesh.name!r}")
            if each.material
            else each.polygons.tolist()
        )
        subset = UsdGeom.Subset.CreateGeomSubset(
            UsdGeom.Mesh(prim),
            name,
            UsdGeom.Tokens.face,
            Vt.IntArray(faces),
            UsdShade.Tokens.materialBind if each.material else "",
        )
        _show_name(subset.GetPrim(), each.name)
        if each.material:
            UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[each.material])
            for face in faces:
                owners[face] = each.name
    if any(owners):
        kind = UsdGeom.Tokens.partition if all(owners) else UsdGeom.Tokens.nonOverlapping
        UsdGeom.Subset.SetFamilyType(UsdGeom.Mesh(prim), UsdShade.Tokens.materialBind, kind)


def _unowned(face_set: FaceSet, owners: Sequence[str], place: str) -> list[int]:
    """Return the faces of a set that no set of another material owns."""
    faces: list[int] = face_set.polygons.tolist()
    before = dict.fromkeys(repr(owners[face]) for face in faces if owners[face])
    if before:
        warn(f"{place}: the material of {face_set.name!r} gives way to that of {', '.join(before)}")
    return [face for face in faces if not owners[face]]


_SAME_END = 1.0 - 1e-3
"""Fraction of a frame by which frames at whole time codes may miss the end of a motion."""


def author_times(layer: Sdf.Layer, header: SequenceHeader, shown: Shown, original: Original | None) -> None:
    """Author units, rates and the time range.

    The range is that of the frames. On a side where they cover the meshes' motion in the file, the file's range is kept
    if it is longer, since the meshes are at rest there.
    """
    layer.timeCodesPerSecond = layer.framesPerSecond = header.fps
    start, end = float(shown.codes[0]), float(shown.codes[-1])
    if original:
        below = original.stage
        scale = shown.rate / shown.rate_below
        if scale == 1.0:
            layer.framesPerSecond = below.GetFramesPerSecond()
        if below.HasAuthoredTimeCodeRange() and shown.sources is None:
            first, last = _motion(original, start / scale, end / scale)
            if start < first * scale + _SAME_END:
                start = min(start, _scaled(below.GetStartTimeCode(), scale, np.ceil))
            if end > last * scale - _SAME_END:
                end = max(end, _scaled(below.GetEndTimeCode(), scale, np.floor))
    layer.startTimeCode, layer.endTimeCode = start, end
    layer.pseudoRoot.SetInfo("upAxis", header.up_axis)
    layer.pseudoRoot.SetInfo("metersPerUnit", header.metres_per_unit)


def _motion(original: Original, *otherwise: float) -> tuple[float, float]:
    """Return the first and last time code of the meshes' motion, or the given defaults."""
    meshes = [fit.mesh for fit in original.fits]
    skins = skins_of(meshes, Notes(original.path))
    sources = [each for mesh in meshes for each in Mover(mesh, skins.get(mesh.GetPath())).sources]
    codes = [code for each in sources for code in each.GetTimeSamples()] or otherwise
    return min(codes), max(codes)


def _scaled(code: float, scale: float, inwards: Callable[[float], float]) -> float:
    """Return an end of a range at another rate, kept whole and within the range if it was whole.

    Examples
    --------
    >>> _scaled(1, 30 / 24, np.ceil), _scaled(0.5, 30 / 24, np.ceil), _scaled(1001, 29.97 / 999, np.floor)
    (2.0, 0.625, 30.0)
    """
    scaled, nearest = scale * code, np.rint(scale * code)
    if abs(scaled - nearest) <= 1e-9 * max(1.0, abs(scaled)):
        return float(nearest)
    return float(inwards(scaled)) if float(code).is_integer() else scaled


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
    parts: Parts | None = None,
) -> None:
    """Write a USD file; options as in `FORMATS`.

    `sources` are ``(T,)`` in seconds, NaN for frames that show no single time of the original; `parts` are written as
    subsets of the faces, see `mixseq_io.text.label_files`.
    """
    packed = path.suffix.lower() == ".usdz"
    _check_options(packed, flatten, onto, clips, pack_from)
    if whole_stage and (flatten or packed or sources is None):
        raise SettingsError(
            "whole_stage retimes what a layer is laid over; leave out flatten, write .usdc, and give sources=..., the "
            "time of the original that every frame shows"
        )
    check_up_axis(path, header)
    original = _original(path, header, flatten, onto)
    if whole_stage and not original:
        raise OutputError(
            f"{path} stands alone, without a stage that could be retimed; leave out whole_stage"
        )
    times = None if sources is None else source_times(header, sources)
    shown = shown_by(header, original.rate if original else header.fps, times if whole_stage else None)
    _, numbered = validate_blocks(header, blocks, velocities)

    def begun(file: Path) -> tuple[Sdf.Layer, Cast, Iterable[Frame]]:
        layer = Sdf.Layer.CreateNew(str(file))
        author_times(layer, header, shown, original)
        moving = velocities is not None
        cast = (
            lay_over(layer, path, original, shown, moving)
            if original
            else define_component(layer, path, header, moving)
        )
        declare(layer, cast)
        if original and whole_stage:
            retime_rest(layer, path, original, shown)
        elif original and times is not None:
            warn_of_rest(path, header, original, times)
        if parts is not None:
            write_parts(layer, [each.path for each in cast.meshes], _laid(parts, original))
        return layer, cast, frames(cast, shown.codes, header.times, numbered)

    elsewhere: list[str] = []
    with (
        new_folder(path) as folder,
        atomic_file(path) as temporary,
        quiet(),
        translate_usd_write_errors(path),
    ):
        if clips:
            folder.make()
            save_in_clips(*begun(temporary), clips, folder)
            folder.install()
        else:
            layer, _, samples = begun(temporary.with_suffix(".usdc") if packed else temporary)
            save(layer, samples)
            if packed:
                name = path.with_suffix(".usdc").name
                elsewhere = pack(layer, temporary, name, folders_of(header, pack_from))
    warn_of_unpacked(path, elsewhere)
    if not clips:
        folder.warn_if_unused()


def write_usd_parts(path: Path, header: SequenceHeader, parts: Parts) -> bool:
    """Write a layer over a sequence's original file that only adds parts; return whether that was possible."""
    original = _original(path, header, flatten=False, onto=None)
    if original is None:
        return False
    with atomic_file(path) as temporary, quiet(), translate_usd_write_errors(path):
        layer = Sdf.Layer.CreateNew(str(temporary))
        author_times(layer, header, shown_by(header, original.rate), original)
        put_over(layer, path, original)
        write_parts(layer, [str(fit.mesh.GetPath()) for fit in original.fits], _laid(parts, original))
        save_layer(layer)
    return True


def check_up_axis(path: Path, header: SequenceHeader) -> None:
    """Raise an error for an up axis that USD does not support."""
    if header.up_axis == "X":
        raise OutputError(
            f"{path}: USD stages have Y or Z up, this mesh has X; turn it with convert_units (--convert-axes Y), or "
            "write .npz or .h5"
        )


def warn_of_unpacked(path: Path, files: list[str]) -> None:
    """Warn of files that `pack` left out."""
    if files:
        warn(
            f"{path}: what is no texture in the original's folder is not packed: {shortened(files)}; if textures "
            "may be shared, name their folder with pack_from=... (--pack-from)"
        )


def folders_of(header: SequenceHeader, pack_from: str | PathLike[str] | None = None) -> list[Path]:
    """Return the folders of textures that may be packed, and the file itself, which may be a package."""
    origin = header.surface.origin
    file = [Path(origin.path)] if origin and origin.format == "USD" else []
    return [*file, *(each.parent for each in file), *([] if pack_from is None else [Path(pack_from)])]


def _laid(parts: Parts, original: Original | None) -> Parts:
    """Return parts by the polygons of the file that they are laid over."""
    if original is None:
        return parts
    own = zip(parts.of_polygon, original.fits, strict=True)
    return replace(parts, of_polygon=tuple(of_polygon[fit.match.polygons] for of_polygon, fit in own))


def _check_options(packed: bool, flatten: bool, onto: object, clips: int, pack_from: object) -> None:
    if clips < 0:
        raise SettingsError(f"clips is {clips}; give the number of frames per file, or 0 for a single file")
    if onto is not None and flatten:
        raise SettingsError("a flattened USD file stands alone; leave out either onto or flatten")
    if packed and (onto is not None or clips):
        raise SettingsError("a .usdz file has everything in itself; leave out onto and clips, or write .usdc")
    if pack_from is not None and not packed:
        raise SettingsError("only .usdz files have textures packed; leave out pack_from, or write .usdz")


def _original(
    path: Path, header: SequenceHeader, flatten: bool, onto: str | PathLike[str] | None
) -> Original | None:
    """Return the file to lay the points over, None for a stand-alone file."""
    origin = header.surface.origin
    known = origin.path if origin and origin.format == "USD" else None
    if onto is None and known is None:
        return None
    file, packed = Path(onto or known or ""), path.suffix.lower() == ".usdz"
    named = is_gone(origin) and any(each.material for each in header.surface.face_sets)
    bare = ", and materials are written by name only" if named else ""
    if not flatten:
        check_not_needed(path, file)
    if flatten or packed:
        if is_gone(origin) and (bare or not flatten):
            warn(f"{path} stands alone: the original {file} is gone{bare}")
        elif not flatten:
            warn(
                f"{path} stands alone, as .usdz files do: only the mesh and its materials are kept of {file}"
            )
        return None
    try:
        with quiet():
            return open_original(file, header)
    except OutputError as error:
        if onto is not None:
            raise
        warn(f"{path} stands alone: {error}{bare}; onto=... (--onto) names the file where it is now")
        return None


def check_not_needed(path: Path, original: Path) -> None:
    """Raise an error if an original, or a layer that it uses, would be replaced."""
    if not path.exists():
        return
    stage = None
    with suppress(FormatError), quiet(), translate_usd_read_errors(original):
        stage = open_stage(original)
    layers = stage.GetUsedLayers() if stage else []
    files = [Path(Ar.SplitPackageRelativePathOuter(each.realPath)[0]) for each in layers if each.realPath]
    if any(each.exists() and each.samefile(path) for each in (original, *files)):
        raise OutputError(
            f"{path} is the original, or a layer that it uses, and would be lost; write to another name"
        )
