"""Stages of USD: diagnostics, names and paths, prims, transforms, and the choice of meshes.

USD's diagnostics, printed to stderr from C++ or raised with C++ file names, are turned into mixseq's errors.
Transforming operations that invert the next one at all times, as written by `mixseq_io.usd.overlay`, are dropped with
it, so that the transform is exact and their samples make no frames.

Specification: https://openusd.org/release/api/class_usd_stage.html
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import takewhile
from pathlib import Path
from secrets import token_hex
from textwrap import shorten

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdUtils

from mixseq.errors import FormatError, NoMeshError, OutputError
from mixseq_io.files import out_of_memory_error, raise_system_error
from mixseq_io.reader import check_regular_file, warn
from mixseq_io.scene_meshes import SceneObject, format_names, select_meshes

_LONGEST_REASON = 200

_TEMPORARY = re.compile(r"\.mixseq\.[\w-]+\.[0-9a-f]{8}(?:(\.new)|\.\w+)")
"""Temporary file names, see `mixseq_io.files` and `mixseq_io.usd.layers`."""


@contextmanager
def quiet() -> Iterator[list[str]]:
    """Yield a list that collects USD's warnings; it is complete when the block ends."""
    messages: list[str] = []
    delegate = UsdUtils.CoalescingDiagnosticDelegate()  # listens as long as it lives
    try:
        yield messages
    finally:
        messages.extend(_text(report) for report in delegate.TakeUncoalescedDiagnostics())
        del delegate


@contextmanager
def translate_usd_read_errors(path: Path) -> Iterator[None]:
    """Translate USD's errors (`RuntimeError`), and those of damaged values, about a file read into `FormatError`."""
    try:
        yield
    except MemoryError:
        raise out_of_memory_error(path) from None
    except (RuntimeError, ValueError, TypeError) as error:
        raise FormatError(
            f"{path} cannot be read as USD; it is damaged, truncated or of another type ({_reasons(error)})"
        ) from error


@contextmanager
def translate_usd_write_errors(path: Path) -> Iterator[None]:
    """Translate USD's errors about a file that is written into `OutputError`, except for errors of the system."""
    try:
        yield
    except Tf.ErrorException as error:
        reasons = _reasons(error)
        raise_system_error(reasons, path.resolve().parent)
        named = _TEMPORARY.sub(lambda found: f"{path.name}{'.clips' if found[1] else ''}", reasons)
        short = shorten(named, _LONGEST_REASON, placeholder=" ...")
        raise OutputError(
            f"cannot write {path}: {short}; check the free space of the disk and the path"
        ) from error


def save_layer(layer: Sdf.Layer) -> None:
    """Save a layer; raise an error even if USD gives no reason."""
    if not layer.Save():
        raise Tf.ErrorException("USD does not save it, and does not say why")


def _reasons(error: Exception) -> str:
    return "; ".join(dict.fromkeys(map(_text, error.args))) or type(error).__name__


def _text(report: object) -> str:
    """Return a diagnostic, or an argument of another error, in one line."""
    try:
        return " ".join(str(getattr(report, "commentary", report)).split())
    except UnicodeDecodeError:  # the message quotes a damaged file
        return "what it holds is not text"


TILES = "<UDIM>"
"""Placeholder in a texture's name for the number of its tiles, from 1001 on."""


def time_codes(times: NDArray[np.float64], fps: float) -> NDArray[np.float64]:
    """Return ``times * fps`` ``(T,)``, rounded where only floating-point error keeps them from whole numbers.

    Examples
    --------
    >>> time_codes(np.arange(4) / 29.97, 29.97).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    codes = times * fps
    nearest = np.rint(codes)
    near = np.abs(codes - nearest) <= 1e-9 * np.maximum(1.0, np.abs(codes))
    rounded = np.where(near, nearest, codes)
    return rounded if (np.diff(rounded) > 0).all() else codes


def identifier(name: str) -> str:
    """Return the closest valid prim name, letters of any script, digits, underscores: "2nd try" becomes "_2nd_try"."""
    cleaned = (
        "".join(letter if Sdf.Path.IsValidIdentifier("_" + letter) else "_" for letter in name) or "mesh"
    )
    return cleaned if Sdf.Path.IsValidIdentifier(cleaned) else "_" + cleaned


class Identifiers:
    """Unique valid prim names of siblings: a second "leg" becomes "leg_1"."""

    def __init__(self, *taken: str) -> None:
        self._taken = set(taken)
        self._next: dict[str, int] = {}

    def take(self, name: str) -> str:
        """Return the closest free name, and reserve it."""
        free = identifier(name)
        number = self._next.get(free, 0)
        while (numbered := f"{free}_{number}" if number else free) in self._taken:
            number += 1
        self._next[free] = number + 1
        self._taken.add(numbered)
        return numbered


def is_prim_path(text: str) -> bool:
    """Whether a text is the absolute path of a prim, such as "/world/fox"."""
    path = Sdf.Path(text) if Sdf.Path.IsValidPathString(text) else Sdf.Path()
    return bool(path.IsAbsolutePath() and path.IsPrimPath())


def reference_to(file: Path, target: Path) -> str:
    """Return the path of `file` in `target`: relative in a shared folder, absolute where symbolic links interfere."""
    absolute, folder = file.absolute(), target.absolute().parent
    try:
        relative = os.path.relpath(absolute, folder)
        shared = os.path.commonpath([absolute, folder])
    except ValueError:  # on different drives
        return absolute.as_posix()
    real = (folder.resolve() / relative).parent
    if Path(shared) == Path(absolute.anchor) or not (real.exists() and real.samefile(absolute.parent)):
        return absolute.as_posix()
    named = Path(relative).as_posix()
    return named if named.startswith("../") else f"./{named}"


def find_sublayer(path: Path) -> str:
    """Return the path of the file that a USD file is a layer over, as written there; "" if it stands alone."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    return next(iter(layer.subLayerPaths), "") if layer else ""


def clips_folder(path: Path) -> Path:
    """Return the folder for a USD file's value clips; it includes the extension, to keep x.usda and x.usdc apart."""
    return path.with_name(f"{path.name}.clips")


def find_clips(path: Path) -> list[Path]:
    """Return the clips and the manifest that a USD file uses; none without clips."""
    folder = clips_folder(path)
    layer = Sdf.Layer.FindOrOpen(str(path)) if folder.is_dir() else None
    if not layer:
        return []
    used: set[str] = set()

    def visit(place: Sdf.Path | str) -> None:
        prim = layer.GetPrimAtPath(place)
        for clips in prim.GetInfo("clips").values() if prim else ():
            assets = [*clips.get("assetPaths", ()), clips.get("manifestAssetPath", Sdf.AssetPath())]
            used.update(asset.path for asset in assets)

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return [file for file in sorted(folder.iterdir()) if f"./{folder.name}/{file.name}" in used]


_MOST_PRIMS = 1_000_000
"""Largest number of prims visited; nested instances multiply without bound in a few lines."""


def open_stage(path: Path) -> Usd.Stage:
    """Open a file as it is on disk, with all payloads."""
    if not path.is_file():
        raise FormatError(f"{path} does not exist")
    # A process shares layers by identifier, with unsaved edits of an application or contents that were replaced on
    # disk. A unique argument makes this one private.
    layer = Sdf.Layer.FindOrOpen(absolute(path), {"mixseq": token_hex(8)})
    if not layer:
        raise FormatError(f"{path} cannot be read as USD; it is damaged, truncated or of another type")
    for asset in layer.GetCompositionAssetDependencies():
        check_regular_file(layer.ComputeAbsolutePath(asset), f"a layer for {path}")
    return Usd.Stage.Open(layer, Usd.Stage.LoadAll)


def absolute(path: Path) -> str:
    """Return the absolute path by which USD opens a file, without resolving links.

    References start at the link's folder, and data stores (git-annex, DVC) keep files elsewhere, without extension.
    """
    return os.path.abspath(path)  # noqa: PTH100 - Path.resolve follows links


def prims_of(path: Path, stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Yield a stage's prims depth-first, native instances resolved, without point instancers' prototypes."""
    prims = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for count, prim in enumerate(prims):
        if count == _MOST_PRIMS:
            raise FormatError(f"{path} holds more than {_MOST_PRIMS} prims; export what is needed only")
        if UsdGeom.PointInstancer(prim):
            prims.PruneChildren()
        yield prim


def lineage(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    """Yield a prim and its ancestors."""
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()


def define(layer: Sdf.Layer, path: Sdf.Path, type_name: str) -> None:
    """Define a prim in a layer, also within an `Sdf.ChangeBlock`, where a stage recomposes siblings only once."""
    spec = Sdf.CreatePrimInLayer(layer, path)
    spec.specifier, spec.typeName = Sdf.SpecifierDef, type_name


@dataclass(frozen=True)
class Notes:
    """Warnings about prims, merged by problem."""

    path: Path
    found: dict[str, list[str]] = field(default_factory=dict)

    def add(self, prim: Usd.Prim, problem: str) -> None:
        """Note a problem, in words that the paths of the prims may follow."""
        self.found.setdefault(problem, []).append(str(prim.GetPath()))

    def warn(self) -> None:
        """Warn of all problems."""
        for problem, paths in self.found.items():
            warn(f"{self.path}: {problem}: {shortened(paths)}")


def shortened(paths: list[str]) -> str:
    """Return a list of paths for a message, truncated if long."""
    return format_names(paths, str)


Operations = tuple[UsdGeom.XformOp, ...]


@dataclass(frozen=True, eq=False)
class Placement:
    """Transform from a prim's space to the world."""

    prim: Usd.Prim

    @cached_property
    def operations(self) -> Operations:
        """Operations on points, the innermost first, without mutually inverse ones."""
        left: list[UsdGeom.XformOp] = []
        for operation in self._all:
            if left and _undo_each_other(left[-1], operation):
                left.pop()
            else:
                left.append(operation)
        return tuple(left)

    @property
    def moves(self) -> bool:
        """Whether the transform changes over time."""
        return any(varies(each.GetAttr()) for each in self.operations)

    def to_world(self, code: float) -> Gf.Matrix4d:
        """Return the local-to-world transform at a time code, for row vectors: p' = p M."""
        if len(self.operations) == len(self._all):
            return UsdGeom.XformCache(Usd.TimeCode(code)).GetLocalToWorldTransform(self.prim)
        return product(self.operations, code)

    @cached_property
    def _all(self) -> Operations:
        return tuple(operations_of(self.prim))


def operations_of(prim: Usd.Prim) -> Iterator[UsdGeom.XformOp]:
    """Yield the operations on a prim's points, the innermost first."""
    for each in lineage(prim):
        if xformable := UsdGeom.Xformable(each):
            yield from reversed(xformable.GetOrderedXformOps())
            if xformable.GetResetXformStack():
                return


def product(operations: Operations, code: float) -> Gf.Matrix4d:
    """Return the product of operations, the innermost first, at a time code."""
    matrix = Gf.Matrix4d(1.0)
    for each in operations:
        matrix *= each.GetOpTransform(Usd.TimeCode(code))
    return matrix


def varies(attribute: Usd.Attribute) -> bool:
    """Whether an attribute changes over time; a single sample is constant."""
    return attribute.GetNumTimeSamples() > 1 or is_spline(attribute)


def is_spline(attribute: Usd.Attribute) -> bool:
    """Whether an attribute is animated by a spline instead of samples."""
    return bool(attribute.ValueMightBeTimeVarying()) and not attribute.GetNumTimeSamples()


def _undo_each_other(one: UsdGeom.XformOp, other: UsdGeom.XformOp) -> bool:
    """Whether two operations of different prims are inverse at all times."""
    mine, theirs = one.GetAttr(), other.GetAttr()
    if one.IsInverseOp() == other.IsInverseOp() or mine.GetPrim() == theirs.GetPrim():
        return False
    if one.GetOpType() != other.GetOpType() or mine.GetTypeName() != theirs.GetTypeName():
        return False
    if not (varies(mine) or varies(theirs)):
        earliest = Usd.TimeCode.EarliestTime()
        return bool(mine.Get(earliest) == theirs.Get(earliest))
    times, same = mine.GetTimeSamples(), theirs.GetTimeSamples()
    if len(times) != len(same) or is_spline(mine) or is_spline(theirs):
        return False
    # USD scales the times of a layer that has another rate than the one above it.
    if not np.allclose(times, same, rtol=1e-12, atol=1e-9):
        return False
    return all(mine.Get(a) == theirs.Get(b) for a, b in zip(times, same, strict=True))


def meshes_of(path: Path, stage: Usd.Stage, prim: str | None, notes: Notes) -> list[UsdGeom.Mesh]:
    """Return the meshes of a stage, or those at or below `prim`, in stage order.

    Hidden meshes, guides, proxies, and meshes without points are used only if there are no others.
    """
    prims = list(prims_of(path, stage))
    meshes = [mesh for each in prims if (mesh := UsdGeom.Mesh(each))]
    instancers = [each for each in prims if UsdGeom.PointInstancer(each)]
    if not meshes:
        raise NoMeshError(f"{path} holds no mesh; {_what_else(prims, instancers)}")
    if prim is not None:
        places = places_of(meshes)
        instancers = [instancers[i] for i in select_meshes(path, places, prim, among=places_of(instancers))]
        meshes = [meshes[i] for i in select_meshes(path, places, prim)]
    for each in instancers:
        notes.add(each, "point instances cannot be read and are left out; make them real first")
    visibility = cache(_visibility)
    shown = [mesh for mesh in meshes if not _is_hidden(mesh.GetPrim(), visibility)] or meshes
    found = [mesh for mesh in shown if mesh.GetPointsAttr().HasAuthoredValue()] or shown
    for mesh in found:
        if any(len(visibility(each)) > 1 for each in lineage(mesh.GetPrim())):
            notes.add(
                mesh.GetPrim(), "visibility that changes over time is left out; these are always visible"
            )
    return found


def places_of(objects: Sequence[UsdGeom.Mesh | Usd.Prim]) -> list[SceneObject]:
    """Return meshes or other prims as scene objects with shared ancestors."""
    places: dict[Sdf.Path, SceneObject] = {}
    for each in objects:
        new = takewhile(lambda prim: prim.GetPath() not in places, lineage(each.GetPrim()))
        for prim in reversed(list(new)):
            path, names = prim.GetPath(), (display_name(prim), prim.GetName())
            places[path] = SceneObject(str(path), names, places.get(path.GetParentPath()))
    return [places[each.GetPath()] for each in objects]


def display_name(prim: Usd.Prim) -> str:
    """Return the display name of a prim."""
    return prim.GetDisplayName() or prim.GetName()


def _is_hidden(prim: Usd.Prim, visibility: Callable[[Usd.Prim], frozenset[str]]) -> bool:
    """Whether a prim is always invisible, a guide or a proxy."""
    if UsdGeom.Imageable(prim).ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
        return True
    return any(visibility(each) == {UsdGeom.Tokens.invisible} for each in lineage(prim))


def _visibility(prim: Usd.Prim) -> frozenset[str]:
    """Return the values of a prim's own visibility over time; some exporters repeat one at every frame."""
    attribute = prim.GetAttribute(UsdGeom.Tokens.visibility)
    return frozenset(attribute.Get(code) for code in attribute.GetTimeSamples() or [0.0])


def _what_else(prims: Sequence[Usd.Prim], instancers: Sequence[Usd.Prim]) -> str:
    if instancers:
        paths = shortened([str(each.GetPath()) for each in instancers])
        return f"it has point instancers, whose instances cannot be read; make them real first: {paths}"
    kinds = Counter(str(each.GetTypeName()) or "untyped" for each in prims)
    return "it has " + (", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) or "nothing")
