"""USD, choosing: which meshes of a stage to read.

Specifications: https://openusd.org/release/api/class_usd_geom_imageable.html (visibility and purpose),
https://openusd.org/release/api/class_usd_geom_point_instancer.html
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from pxr import Sdf, Usd, UsdGeom

from mixseq.errors import AmbiguousError, FormatError
from mixseq_io.usd.stage import LONGEST_LIST, Notes, lineage, prims_of, shortened


def meshes_of(path: Path, stage: Usd.Stage, prim: str | None, notes: Notes) -> list[UsdGeom.Mesh]:
    """Return the meshes of a stage, or those at or below `prim`, in the order of the stage.

    Hidden meshes, guides, proxies, and meshes without points count only where there is nothing else.

    Raises
    ------
    AmbiguousError
        If `prim` is a plain name that several prims have.
    FormatError
        If there is none; the message lists what there is.
    """
    prims = list(prims_of(path, stage))
    meshes = [mesh for each in prims if (mesh := UsdGeom.Mesh(each))]
    instancers = [each for each in prims if UsdGeom.PointInstancer(each)]
    if not meshes:
        raise FormatError(f"{path} holds no mesh; {_what_else(prims, instancers)}")
    if prim is not None:
        root = _root(path, meshes, prim)
        meshes = [mesh for mesh in meshes if mesh.GetPath().HasPrefix(root)]
        instancers = [each for each in instancers if each.GetPath().HasPrefix(root)]
    for each in instancers:
        notes.add(each, "point instances cannot be read and are left out; make them real first")
    shown = [mesh for mesh in meshes if not _is_hidden(mesh.GetPrim())] or meshes
    chosen = [mesh for mesh in shown if mesh.GetPointsAttr().HasAuthoredValue()] or shown
    for mesh in chosen:
        if any(_visibility(each).GetNumTimeSamples() > 1 for each in lineage(mesh.GetPrim())):
            notes.add(
                mesh.GetPrim(), "visibility that changes over time is left out; these are always visible"
            )
    return chosen


def name_of(path: Path, meshes: Sequence[UsdGeom.Mesh]) -> str:
    """Return the name of a mesh, or of the deepest prim that all meshes are below, or of the file."""
    common = meshes[0].GetPath()
    for mesh in meshes:
        common = common.GetCommonPrefix(mesh.GetPath())
    prim = meshes[0].GetPrim().GetStage().GetPrimAtPath(common)
    return path.stem if prim.IsPseudoRoot() else display_name(prim)


def display_name(prim: Usd.Prim) -> str:
    """Return the name that a prim is shown under."""
    return prim.GetDisplayName() or prim.GetName()


def _root(path: Path, meshes: Sequence[UsdGeom.Mesh], prim: str) -> Sdf.Path:
    """Return the path that `prim`, a path or a plain name, stands for."""
    above = {prefix for mesh in meshes for prefix in mesh.GetPath().GetPrefixes()}
    named = Sdf.Path.RemoveDescendentPaths([each for each in above if each.name == prim])
    if len(named) > 1:
        raise AmbiguousError(
            f"{path} has several prims called {prim!r}; choose one by its path: "
            f"{shortened(sorted(map(str, named)))}"
        )
    if named:
        return Sdf.Path(named[0])
    if Sdf.Path.IsValidPathString(prim) and Sdf.Path(prim) in above | {Sdf.Path.absoluteRootPath}:
        return Sdf.Path(prim)
    raise FormatError(f"{path} has no mesh at or below {prim!r}; its meshes are{_listing(meshes)}")


def _is_hidden(prim: Usd.Prim) -> bool:
    """Whether a prim is always invisible, or only a helper of its authors."""
    if UsdGeom.Imageable(prim).ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
        return True
    first = Usd.TimeCode.EarliestTime()
    return any(
        (attribute := _visibility(each)).GetNumTimeSamples() < 2
        and attribute.Get(first) == UsdGeom.Tokens.invisible
        for each in lineage(prim)
    )


def _visibility(prim: Usd.Prim) -> Usd.Attribute:
    return prim.GetAttribute(UsdGeom.Tokens.visibility)


def _what_else(prims: Sequence[Usd.Prim], instancers: Sequence[Usd.Prim]) -> str:
    if instancers:
        paths = shortened([str(each.GetPath()) for each in instancers])
        return f"it has point instancers, whose instances cannot be read; make them real first: {paths}"
    kinds = Counter(str(each.GetTypeName()) or "untyped" for each in prims)
    return "it has " + (", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) or "nothing")


def _listing(meshes: Sequence[UsdGeom.Mesh]) -> str:
    lines = [
        f"\n  {mesh.GetPath()} ({len(mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime()) or ())} vertices)"
        for mesh in meshes[:LONGEST_LIST]
    ]
    more = len(meshes) - LONGEST_LIST
    return "".join(lines) + (f"\n  and {more} more" if more > 0 else "")
