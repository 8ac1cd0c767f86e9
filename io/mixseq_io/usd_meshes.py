"""USD, choosing: which mesh of a stage to read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from pxr import Sdf, Usd, UsdGeom

from mixseq.errors import AmbiguousError, FormatError

_LONGEST_LIST = 20


def choose_mesh(path: Path, stage: Usd.Stage, prim: str | None) -> UsdGeom.Mesh:
    """Return the only animated mesh, or the only mesh, of the stage or below `prim`.

    Raises
    ------
    AmbiguousError
        If there are several; the message lists them.
    FormatError
        If there is none; the message lists what there is.
    """
    prims = list(stage.Traverse(Usd.TraverseInstanceProxies()))
    meshes = [mesh for each in prims if (mesh := UsdGeom.Mesh(each))]
    if not meshes:
        kinds = Counter(str(each.GetTypeName()) or "untyped" for each in prims)
        found = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) or "nothing"
        raise FormatError(f"{path} holds no mesh; it has {found}")
    if prim is not None:
        below = [mesh for mesh in meshes if _is_below(mesh, prim)]
        if not below:
            raise FormatError(f"{path} has no mesh at or below {prim!r}; its meshes are{_listing(meshes)}")
        meshes = below
    animated = [mesh for mesh in meshes if is_animated(mesh)]
    candidates = animated or meshes
    if len(candidates) > 1:
        what = "animated meshes" if animated else "meshes"
        raise AmbiguousError(
            f"{path} holds {len(candidates)} {what}; choose one by its path with prim=... "
            f"(--prim on the command line):{_listing(candidates)}"
        )
    return candidates[0]


def is_animated(mesh: UsdGeom.Mesh) -> bool:
    """Whether the mesh's points themselves move, not only a transform or a skeleton."""
    return bool(mesh.GetPointsAttr().GetNumTimeSamples() > 1)


def is_skinned(mesh: UsdGeom.Mesh) -> bool:
    """Whether a skeleton or blend shapes are to move the mesh's points."""
    prim = mesh.GetPrim()
    names = ("primvars:skel:jointIndices", "skel:blendShapes", "skel:blendShapeTargets")
    return any(prim.HasProperty(name) and prim.GetProperty(name).IsAuthored() for name in names)


def _is_below(mesh: UsdGeom.Mesh, prim: str) -> bool:
    return bool(Sdf.Path.IsValidPathString(prim)) and bool(mesh.GetPath().HasPrefix(Sdf.Path(prim)))


def _listing(meshes: Sequence[UsdGeom.Mesh]) -> str:
    lines = [
        f"\n  {mesh.GetPath()} ({len(mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime()) or ())} vertices, "
        f"{'animated' if is_animated(mesh) else 'still'})"
        for mesh in meshes[:_LONGEST_LIST]
    ]
    more = len(meshes) - _LONGEST_LIST
    return "".join(lines) + (f"\n  and {more} more" if more > 0 else "")
