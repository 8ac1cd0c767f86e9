"""USD, writing: parts as a family of subsets that partitions the faces of every mesh.

Specification: https://openusd.org/release/api/class_usd_geom_subset.html (families and their types)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from mixseq.arrays import IntArray
from mixseq_io.labels.markings import FAMILY
from mixseq_io.usd.markings import NUMBER
from mixseq_io.usd.paths import identifier


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of a sequence's polygons.

    Parameters
    ----------
    of_polygon : tuple of (n,) int
        Part of every polygon, mesh by mesh.
    names : sequence of str
        What the parts are called.
    """

    of_polygon: tuple[IntArray, ...]
    names: Sequence[str]


def define_parts(layer: Sdf.Layer, meshes: Sequence[str], parts: Parts) -> None:
    """Author a subset for every part of every mesh; those that the meshes have from before are replaced.

    Parameters
    ----------
    layer : Sdf.Layer
        The layer, which may have others below it.
    meshes : sequence of str
        Paths of the meshes' prims, in the order of `parts`.
    parts : Parts
        The parts.
    """
    stage = Usd.Stage.Open(layer)
    for path, of_polygon in zip(meshes, parts.of_polygon, strict=True):
        _define(UsdGeom.Mesh(stage.GetPrimAtPath(path)), of_polygon, parts.names)


def _define(mesh: UsdGeom.Mesh, of_polygon: IntArray, names: Sequence[str]) -> None:
    old = {each.GetPrim().GetName() for each in UsdGeom.Subset.GetGeomSubsets(mesh, "", FAMILY)}
    others = mesh.GetPrim().GetFilteredChildren(Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
    taken = [name for each in others if (name := each.GetName()) not in old]
    for part in np.unique(of_polygon).tolist():
        name = identifier(names[part], taken)
        taken.append(name)
        faces = np.flatnonzero(of_polygon == part).astype(np.int32)
        subset = UsdGeom.Subset.CreateGeomSubset(
            mesh, name, UsdGeom.Tokens.face, Vt.IntArrayFromBuffer(faces), FAMILY
        )
        prim = subset.GetPrim()
        prim.SetCustomDataByKey(NUMBER, part)
        if names[part] != name or prim.GetDisplayName():
            prim.SetDisplayName(names[part])
    for name in old.difference(taken):
        mesh.GetPrim().GetChild(name).SetActive(False)
    UsdGeom.Subset.SetFamilyType(mesh, FAMILY, UsdGeom.Tokens.partition)
