"""USD stages: diagnostics, prim names and asset paths, traversal, transforms, and the choice of meshes.

USD prints its diagnostics to stderr from C++, or raises them with C++ file names; here they become mixseq's errors.
Transform operations that are inverse at all times, as written by `mixseq_io.usd.overlay`, cancel exactly, so that they
cause neither rounding nor additional frames.

Specification: https://openusd.org/release/api/class_usd_stage.html
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import takewhile
from pathlib import Path
from secrets import token_hex
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Pcp, Sdf, Tf, Usd, UsdGeom, UsdUtils

from mixseq.errors import FormatError, MissingFileError, MixseqError, NoMeshError, OutputError
from mixseq.runtime.text_files import strip_byte_order_mark
from mixseq.sequence.header import UP_AXES
from mixseq_io.files import out_of_memory_error, raise_system_error
from mixseq_io.reader import check_regular_file, warn
from mixseq_io.scene_meshes import SceneObject, format_names, select_meshes

ROUNDING_TOLERANCE = 1e-9
_MAX_REASON_LENGTH = 200

_TEMPORARY_NAME = re.compile(r"\.mixseq\.[\w-]+\.[0-9a-f]{8}(?:(\.new)|\.\w+)")
"""Names of temporary files (see `mixseq_io.files`) and of temporary clip folders (see `mixseq_io.usd.layers`)."""


@contextmanager
def capture_diagnostics() -> Iterator[list[str]]:
    """Yield a list that receives USD's warnings when the block ends, instead of stderr."""
    messages: list[str] = []
    delegate = UsdUtils.CoalescingDiagnosticDelegate()  # collects diagnostics until it is deleted
    try:
        yield messages
    finally:
        messages.extend(_format_diagnostic(report) for report in delegate.TakeUncoalescedDiagnostics())
        del delegate


_LINE_NUMBER = re.compile(r"\.usda?:(\d+):\d+:")


@contextmanager
def translate_usd_read_errors(path: Path) -> Iterator[None]:
    """Translate USD's `RuntimeError`, and exceptions raised by damaged values, into `FormatError`."""
    try:
        yield
    except MixseqError:
        raise
    except MemoryError:
        raise out_of_memory_error(path) from None
    except (RuntimeError, ValueError, TypeError) as error:
        line = _LINE_NUMBER.search(_join_diagnostics(error))  # of a syntax error; the rest is about USD's own code
        place = f" at line {line[1]}" if line else ""
        raise FormatError(
            f"{path} cannot be read as USD; it is damaged{place}, truncated or of another type"
        ) from error


@contextmanager
def translate_usd_write_errors(path: Path) -> Iterator[None]:
    """Translate USD's errors in writing a file into `OutputError`, or into `OSError` if the disk caused them."""
    try:
        yield
    except Tf.ErrorException as error:
        message = _join_diagnostics(error)
        raise_system_error(message, path.resolve().parent)
        message = _TEMPORARY_NAME.sub(lambda match: f"{path.name}{'.clips' if match[1] else ''}", message)
        reason = shorten(message, _MAX_REASON_LENGTH, placeholder=" ...")
        raise OutputError(f"cannot write {path}: {reason}; check the free space of the disk and the path") from error


def save_layer(layer: Sdf.Layer) -> None:
    """Save a layer; raise an error if saving fails, even without a diagnostic."""
    if not layer.Save():
        raise Tf.ErrorException("USD does not save it, and does not say why")


def _join_diagnostics(error: Exception) -> str:
    return "; ".join(dict.fromkeys(map(_format_diagnostic, error.args))) or type(error).__name__


def _format_diagnostic(diagnostic: object) -> str:
    """Format a USD diagnostic, or an argument of another exception, in one line."""
    try:
        return " ".join(str(getattr(diagnostic, "commentary", diagnostic)).split())
    except UnicodeDecodeError:  # the message contains bytes of a damaged file
        return "its contents are not text"


PART_NUMBER_KEY = "mixseq:part"
"""Key for a part's index in the custom data of the part's subset."""

UDIM_PLACEHOLDER = "<UDIM>"
"""Placeholder for the tile number (from 1001 on) in a texture's file name."""


def time_codes(times: NDArray[np.float64], fps: float) -> NDArray[np.float64]:
    """Convert times ``(T,)`` to time codes; round codes that differ from whole numbers by floating-point error only.

    Examples
    --------
    >>> time_codes(np.arange(4) / 29.97, 29.97).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    codes = times * fps
    nearest = np.rint(codes)
    is_whole = np.abs(codes - nearest) <= ROUNDING_TOLERANCE * np.maximum(1.0, np.abs(codes))
    rounded = np.where(is_whole, nearest, codes)
    return rounded if (np.diff(rounded) > 0).all() else codes


def identifier(name: str) -> str:
    """Return a valid prim name with invalid characters replaced by underscores: "2nd try" becomes "_2nd_try"."""
    cleaned = "".join(letter if Sdf.Path.IsValidIdentifier("_" + letter) else "_" for letter in name) or "mesh"
    return cleaned if Sdf.Path.IsValidIdentifier(cleaned) else "_" + cleaned


class Identifiers:
    """Generator of valid prim names that are unique among siblings: a second "leg" becomes "leg_1"."""

    def __init__(self, *reserved: str) -> None:
        self._reserved = set(reserved)
        self._next_suffix: dict[str, int] = {}

    def reserve(self, name: str) -> str:
        """Return a free name for an object, and reserve it."""
        base = identifier(name)
        suffix = self._next_suffix.get(base, 0)
        while (unique := f"{base}_{suffix}" if suffix else base) in self._reserved:
            suffix += 1
        self._next_suffix[base] = suffix + 1
        self._reserved.add(unique)
        return unique


def is_prim_path(text: str) -> bool:
    """Whether a string is the absolute path of a prim, such as "/world/fox"."""
    path = Sdf.Path(text) if Sdf.Path.IsValidPathString(text) else Sdf.Path()
    return bool(path.IsAbsolutePath() and path.IsPrimPath())


def relative_asset_path(file: Path, target: Path) -> str:
    """Return the asset path of `file` in `target`: relative in a shared folder, but absolute if links interfere."""
    absolute, folder = file.absolute(), target.absolute().parent
    try:
        relative = os.path.relpath(absolute, folder)
        shared = os.path.commonpath([absolute, folder])
    except ValueError:  # on different drives
        return absolute.as_posix()
    resolved = (folder.resolve() / relative).parent
    is_same = resolved.exists() and resolved.samefile(absolute.parent)
    if Path(shared) == Path(absolute.anchor) or not is_same:
        return absolute.as_posix()
    path = Path(relative).as_posix()
    return path if path.startswith("../") else f"./{path}"


def find_sublayer(path: Path) -> str:
    """Return the asset path of a USD file's first sublayer, or "" without sublayers."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    return next(iter(layer.subLayerPaths), "") if layer else ""


def clips_folder(path: Path) -> Path:
    """Return the folder of a USD file's value clips; its name has the file's extension, as x.usda and x.usdc differ."""
    return path.with_name(f"{path.name}.clips")


def find_clips(path: Path) -> list[Path]:
    """Return the files of the value clips and the manifest that a USD file uses."""
    folder = clips_folder(path)
    layer = Sdf.Layer.FindOrOpen(str(path)) if folder.is_dir() else None
    if not layer:
        return []
    used: set[str] = set()

    def collect(prim_path: Sdf.Path | str) -> None:
        prim = layer.GetPrimAtPath(prim_path)
        for clips in prim.GetInfo("clips").values() if prim else ():
            used.update(asset.path for asset in _clip_assets(clips, "assetPaths", "manifestAssetPath"))

    layer.Traverse(Sdf.Path.absoluteRootPath, collect)
    return [file for file in sorted(folder.iterdir()) if f"./{folder.name}/{file.name}" in used]


def _clip_assets(clips: Any, *keys: str) -> list[Sdf.AssetPath]:
    """Return the asset paths of a set of value clips; a file may hold values of other types."""
    values = [clips.get(key) for key in keys] if isinstance(clips, dict) else []
    values = [asset for value in values for asset in (value if isinstance(value, Sdf.AssetPathArray) else [value])]
    return [asset for asset in values if isinstance(asset, Sdf.AssetPath)]


_MAX_PRIMS = 1_000_000
"""Limit on visited prims, since a few nested instances can multiply the number of prims without bound."""


def open_stage(path: Path) -> Usd.Stage:
    """Open a USD file in its current state on disk, with all payloads."""
    if not path.is_file():
        raise MissingFileError(f"{path} does not exist")
    with path.open("rb") as file:
        start = file.read(4)
    if strip_byte_order_mark(path, start, "USD") != start:
        raise FormatError(f"{path} begins with a byte order mark, which USD does not read; save it as UTF-8 without it")
    # USD shares layers within a process by identifier, with unsaved edits and outdated contents. A unique argument
    # makes this layer's identifier unique.
    layer = Sdf.Layer.FindOrOpen(absolute_path(path), {"mixseq": token_hex(8)})
    if not layer:
        raise FormatError(f"{path} cannot be read as USD; it is damaged, truncated or of another type")
    for asset in layer.GetCompositionAssetDependencies():
        check_regular_file(layer.ComputeAbsolutePath(asset), f"a layer for {path}")
    _convert_metadata(path, layer)
    try:
        return Usd.Stage.Open(layer, Usd.Stage.LoadAll)
    except Tf.ErrorException:
        layers = _find_layers(layer)
        for other in layers:
            _convert_metadata(path, other)
        return Usd.Stage.Open(layer, Usd.Stage.LoadAll)


def _find_layers(layer: Sdf.Layer) -> list[Sdf.Layer]:
    """Return a layer and all layers that it refers to, in memory; they stay open as long as the list."""
    layers = [layer]
    for each in layers:
        for asset in each.GetCompositionAssetDependencies():
            with suppress(Tf.ErrorException):
                if (other := Sdf.Layer.FindOrOpenRelativeToLayer(each, asset)) and other not in layers:
                    layers.append(other)
    return layers


_UNIT_METADATA = ("metersPerUnit", "timeCodesPerSecond", "framesPerSecond")
_TIME_METADATA = ("startTimeCode", "endTimeCode")


def _convert_metadata(path: Path, layer: Sdf.Layer) -> None:
    """Convert stage metadata in memory to the types that USD requires; other exporters write float, int and text."""
    root = layer.pseudoRoot
    for key in filter(root.HasInfo, (*_UNIT_METADATA, *_TIME_METADATA)):
        value = root.GetInfo(key)
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = np.nan
        if np.isfinite(number) and (number > 0 or key in _TIME_METADATA):
            root.SetInfo(key, number)
        else:
            root.ClearInfo(key)
            default = f", and {root.GetFallbackForInfo(key):g} is taken" if key in _UNIT_METADATA else ""
            warn(f"{path}: {key} is {value!r}, not a valid number; it is left out{default}")
    if root.HasInfo("upAxis"):
        value = root.GetInfo("upAxis")
        root.ClearInfo("upAxis")
        if str(value).upper() in UP_AXES:
            root.SetInfo("upAxis", str(value).upper())
        else:
            warn(f"{path}: upAxis is {value!r}, not an axis; it is left out, and Y is taken (--up-axis)")


_REFERENCE_PATTERN = re.compile(r"@(.+?)@(?:<(.*?)>)?")
"""Asset path and prim path of a reference in the text of a composition error."""


def _describe_missing(path: Path, stage: Usd.Stage) -> str:
    """Describe the files and prims that a stage refers to and lacks, or return ""."""
    files: dict[str, None] = {}
    prims: dict[str, None] = {}
    unresolved = (Pcp.ErrorType_UnresolvedPrimPath, Pcp.ErrorType_InvalidAssetPath, Pcp.ErrorType_InvalidSublayerPath)
    untyped: Any = stage  # the type stubs lack GetCompositionErrors
    for error in untyped.GetCompositionErrors():
        match = _REFERENCE_PATTERN.search(str(error))
        if match and error.errorType in unresolved:
            file = match[1].removeprefix(f"{os.path.dirname(absolute_path(path))}{os.sep}")  # noqa: PTH120
            if error.errorType == Pcp.ErrorType_UnresolvedPrimPath:
                prims[f"{match[2]} in {file}"] = None
            else:
                files[file] = None
    for prim in stage.TraverseAll():
        for clips in (prim.GetMetadata("clips") or {}).values():
            files |= {asset.path: None for asset in _clip_assets(clips, "assetPaths") if not asset.resolvedPath}
    problems = []
    if files:
        problems.append(f"files that it refers to are missing or cannot be read: {format_names(list(files), str)}")
    if prims:
        problems.append(f"prims that it refers to do not exist: {format_names(list(prims), str)}")
    return "; ".join(problems)


def absolute_path(path: Path) -> str:
    """Return the absolute path by which USD opens a file.

    Links are not resolved: references are relative to the link, and link targets may lack extensions (git-annex, DVC).
    """
    return os.path.abspath(path)  # noqa: PTH100 - Path.resolve follows links


def traverse_prims(path: Path, stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Yield the prims of a stage depth-first, including prims in instances, without prototypes of point instancers."""
    prims = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for count, prim in enumerate(prims):
        if count == _MAX_PRIMS:
            raise FormatError(f"{path} holds more than {_MAX_PRIMS} prims; export only the meshes that are needed")
        if UsdGeom.PointInstancer(prim):
            prims.PruneChildren()
        yield prim


def self_and_ancestors(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    """Yield a prim and its ancestors."""
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()


def define_prim_spec(layer: Sdf.Layer, path: Sdf.Path, type_name: str) -> None:
    """Define a prim in a layer, also in an `Sdf.ChangeBlock`, which avoids recomposition for every sibling."""
    spec = Sdf.CreatePrimInLayer(layer, path)
    spec.specifier, spec.typeName = Sdf.SpecifierDef, type_name


@dataclass(frozen=True)
class PrimWarnings:
    """Collected warnings about the prims of a file."""

    path: Path
    paths_of_problem: dict[str, dict[str, None]] = field(default_factory=dict)

    def add(self, prim: Usd.Prim, problem: str) -> None:
        """Add a prim's problem, worded so that a list of prim paths can follow."""
        self.paths_of_problem.setdefault(problem, {})[str(prim.GetPath())] = None

    def emit(self) -> None:
        """Warn once per problem, with the paths of all affected prims."""
        for problem, paths in self.paths_of_problem.items():
            warn(f"{self.path}: {problem}: {format_names(list(paths), str)}")


TransformOps = tuple[UsdGeom.XformOp, ...]


@dataclass(frozen=True, eq=False)
class WorldTransform:
    """Transform from a prim's local space to the world."""

    prim: Usd.Prim

    @cached_property
    def ops(self) -> TransformOps:
        """Transform operations, the innermost first, without pairs that cancel."""
        remaining: list[UsdGeom.XformOp] = []
        for op in self._all_ops:
            if remaining and _are_inverse(remaining[-1], op):
                remaining.pop()
            else:
                remaining.append(op)
        return tuple(remaining)

    @property
    def is_animated(self) -> bool:
        """Whether the transform changes over time."""
        return any(is_animated(op.GetAttr()) for op in self.ops)

    def at(self, code: float) -> Gf.Matrix4d:
        """Return the matrix at a time code, for row vectors: p' = p M."""
        if len(self.ops) == len(self._all_ops):
            return UsdGeom.XformCache(Usd.TimeCode(code)).GetLocalToWorldTransform(self.prim)
        return compose_ops(self.ops, code)

    @cached_property
    def _all_ops(self) -> TransformOps:
        return tuple(transform_ops(self.prim))


def transform_ops(prim: Usd.Prim) -> Iterator[UsdGeom.XformOp]:
    """Yield the transform operations on a prim's points, the innermost first."""
    for ancestor in self_and_ancestors(prim):
        if xformable := UsdGeom.Xformable(ancestor):
            yield from reversed(xformable.GetOrderedXformOps())
            if xformable.GetResetXformStack():
                return


def compose_ops(ops: TransformOps, code: float) -> Gf.Matrix4d:
    """Return the matrix product of operations, given the innermost first, at a time code."""
    matrix = Gf.Matrix4d(1.0)
    for op in ops:
        matrix *= op.GetOpTransform(Usd.TimeCode(code))
    return matrix


def is_animated(attribute: Usd.Attribute) -> bool:
    """Whether an attribute has several time samples or a spline."""
    return attribute.GetNumTimeSamples() > 1 or is_spline(attribute)


def is_spline(attribute: Usd.Attribute) -> bool:
    """Whether an attribute is animated by a spline instead of samples."""
    return bool(attribute.ValueMightBeTimeVarying()) and not attribute.GetNumTimeSamples()


def _are_inverse(first: UsdGeom.XformOp, second: UsdGeom.XformOp) -> bool:
    """Whether two operations of different prims are inverse to each other at all times."""
    a, b = first.GetAttr(), second.GetAttr()
    if first.IsInverseOp() == second.IsInverseOp() or a.GetPrim() == b.GetPrim():
        return False
    if first.GetOpType() != second.GetOpType() or a.GetTypeName() != b.GetTypeName():
        return False
    if not (is_animated(a) or is_animated(b)):
        earliest = Usd.TimeCode.EarliestTime()
        return bool(a.Get(earliest) == b.Get(earliest))
    a_codes, b_codes = a.GetTimeSamples(), b.GetTimeSamples()
    if len(a_codes) != len(b_codes) or is_spline(a) or is_spline(b):
        return False
    # USD scales the time codes of a sublayer with another rate, which causes rounding.
    if not np.allclose(a_codes, b_codes, rtol=2.0**-22, atol=1e-9):
        return False
    return all(a.Get(a_code) == b.Get(b_code) for a_code, b_code in zip(a_codes, b_codes, strict=True))


def find_meshes(path: Path, stage: Usd.Stage, prim_path: str | None, warnings: PrimWarnings) -> list[UsdGeom.Mesh]:
    """Return the meshes of a stage, or those at or below a prim path, in stage order.

    Hidden meshes, guides, proxies, and meshes without points are omitted unless all meshes are of these kinds.
    """
    prims = list(traverse_prims(path, stage))
    meshes = [mesh for prim in prims if (mesh := UsdGeom.Mesh(prim))]
    instancers = [prim for prim in prims if UsdGeom.PointInstancer(prim)]
    missing = _describe_missing(path, stage)
    if not meshes:
        raise NoMeshError(f"{path} holds no mesh; {missing or _describe_contents(prims, instancers)}")
    if missing:
        warn(f"{path}: {missing}")
    if prim_path is not None:
        objects = scene_objects_of(meshes)
        among = scene_objects_of(instancers)
        instancers = [instancers[i] for i in select_meshes(path, objects, prim_path, among=among)]
        meshes = [meshes[i] for i in select_meshes(path, objects, prim_path)]
    for instancer in instancers:
        warnings.add(instancer, "point instances cannot be read and are left out; make them real first")
    visibility = cache(_visibility)
    visible = [mesh for mesh in meshes if not _is_hidden(mesh.GetPrim(), visibility)] or meshes
    selected = [mesh for mesh in visible if mesh.GetPointsAttr().HasAuthoredValue()] or visible
    for mesh in selected:
        if any(len(visibility(prim)) > 1 for prim in self_and_ancestors(mesh.GetPrim())):
            warnings.add(mesh.GetPrim(), "animated visibility is left out; these meshes are always visible")
    return selected


def scene_objects_of(schemas: Sequence[UsdGeom.Mesh | Usd.Prim]) -> list[SceneObject]:
    """Return meshes or other prims as scene objects, with shared objects for common ancestors."""
    objects: dict[Sdf.Path, SceneObject] = {}
    for schema in schemas:
        new_prims = takewhile(lambda prim: prim.GetPath() not in objects, self_and_ancestors(schema.GetPrim()))
        for prim in reversed(list(new_prims)):
            path, names = prim.GetPath(), (display_name(prim), prim.GetName())
            objects[path] = SceneObject(str(path), names, objects.get(path.GetParentPath()))
    return [objects[schema.GetPath()] for schema in schemas]


def display_name(prim: Usd.Prim) -> str:
    """Return the display name of a prim, or its name if no display name is set."""
    return prim.GetDisplayName() or prim.GetName()


def _is_hidden(prim: Usd.Prim, visibility: Callable[[Usd.Prim], frozenset[str]]) -> bool:
    """Whether a prim is always invisible, a guide or a proxy."""
    if UsdGeom.Imageable(prim).ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
        return True
    return any(visibility(each) == {UsdGeom.Tokens.invisible} for each in self_and_ancestors(prim))


def _visibility(prim: Usd.Prim) -> frozenset[str]:
    """Return the distinct values of a prim's visibility over time; some exporters repeat a value at every frame."""
    attribute = prim.GetAttribute(UsdGeom.Tokens.visibility)
    return frozenset(attribute.Get(code) for code in attribute.GetTimeSamples() or [0.0])


def _describe_contents(prims: Sequence[Usd.Prim], instancers: Sequence[Usd.Prim]) -> str:
    if instancers:
        paths = format_names([str(each.GetPath()) for each in instancers], str)
        return f"it has point instancers, whose instances cannot be read; make them real first: {paths}"
    kinds = Counter(str(each.GetTypeName()) or "untyped" for each in prims)
    return "it has " + (", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) or "nothing")
