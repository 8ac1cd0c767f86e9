"""USD, writing: materials of a stand-alone file, copied from the original.

Networks are taken from the composed file, flattened. Connections that leave the material are lost. Textures stay in
place; asset paths are rewritten.

Specification: https://openusd.org/release/api/class_usd_shade_material.html
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from pxr import Ar, Sdf, Usd, UsdGeom, UsdShade, UsdUtils

from mixseq.errors import FormatError
from mixseq.surface import Origin
from mixseq_io.blocks import warn
from mixseq_io.usd.diagnostics import reading_usd
from mixseq_io.usd.paths import TILES, Identifiers, is_prim_path, reference_to
from mixseq_io.usd.prims import define, lineage, open_stage, shortened

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
        with reading_usd(origin):
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
