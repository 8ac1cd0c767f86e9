"""USD, choosing: which meshes of a stage to read.

Specifications: https://openusd.org/release/api/class_usd_geom_imageable.html (visibility and purpose),
https://openusd.org/release/api/class_usd_geom_point_instancer.html
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache
from itertools import takewhile
from pathlib import Path

from pxr import Sdf, Usd, UsdGeom

from mixseq.errors import NoMeshError
from mixseq_io.choosing import SceneObject, chosen
from mixseq_io.usd.prims import Notes, lineage, prims_of, shortened


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
        instancers = [instancers[i] for i in chosen(path, places, prim, among=places_of(instancers))]
        meshes = [meshes[i] for i in chosen(path, places, prim)]
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
