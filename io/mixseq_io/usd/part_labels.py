"""USD, labels of parts: reads families of subsets and joints, writes a family that partitions every mesh's faces.

Specification: https://openusd.org/release/api/class_usd_geom_subset.html (families and their types)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdSkel, Vt
from scipy.sparse import csr_array

from mixseq.arrays import IntArray
from mixseq.errors import InvalidSequenceError
from mixseq.polygons import Polygons
from mixseq.sequence import SequenceHeader
from mixseq.surface import FaceSet
from mixseq_io.labels.markings import (
    FAMILY,
    GROUPS,
    LABELS,
    MATERIALS,
    Markings,
    Skinning,
    joined_skinning,
    sets_of,
)
from mixseq_io.usd.mesh_motion import AnimatedMesh
from mixseq_io.usd.paths import Identifiers
from mixseq_io.usd.stage_meshes import display_name

NUMBER = "mixseq:part"
"""Key of a part's number in the custom data of its subset."""


def markings_of(header: SequenceHeader, meshes: Sequence[AnimatedMesh]) -> Markings:
    """Return the families of subsets and the joints of a stage's meshes."""
    polygons = [_polygons(animated) for animated in meshes]
    skinned = any(_is_skinned(animated) for animated in meshes)
    materials = {source: sets for source, sets in sets_of(header).items() if source == MATERIALS}
    return Markings(
        sets=_families(meshes, polygons) | materials,
        skinning=joined_skinning([_skinning(animated) for animated in meshes]) if skinned else None,
    )


def _polygons(animated: AnimatedMesh) -> Polygons:
    """Return the faces by points, as in the file."""
    code = Usd.TimeCode(animated.start)
    counts = animated.mesh.GetFaceVertexCountsAttr().Get(code)
    indices = animated.mesh.GetFaceVertexIndicesAttr().Get(code)
    return Polygons(np.array(counts or (), dtype=np.int32), np.array(indices or (), dtype=np.int32))


def _families(meshes: Sequence[AnimatedMesh], polygons: Sequence[Polygons]) -> dict[str, tuple[FaceSet, ...]]:
    """Return subsets of faces by family; those written by mixseq in the order of their numbers."""
    found: dict[str, list[tuple[int, FaceSet]]] = {}
    first = 0
    for animated, own in zip(meshes, polygons, strict=True):
        code = Usd.TimeCode(animated.start)
        for subset in _subsets(animated.mesh):
            faces = np.array(subset.GetIndicesAttr().Get(code) or (), dtype=np.int32)
            faces = faces[(faces >= 0) & (faces < len(own.counts))]
            number = subset.GetPrim().GetCustomDataByKey(NUMBER)
            face_set = FaceSet(display_name(subset.GetPrim()), faces + first)
            found.setdefault(_source(subset), []).append((number if isinstance(number, int) else 0, face_set))
        first += len(own.counts)
    return {
        source: tuple(each for _, each in sorted(sets, key=lambda pair: pair[0]))
        for source, sets in found.items()
    }


def _subsets(mesh: UsdGeom.Mesh) -> Iterator[UsdGeom.Subset]:
    """Yield the subsets of a mesh's faces that bind no materials."""
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        of_faces = subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face
        if of_faces and subset.GetFamilyNameAttr().Get() != UsdShade.Tokens.materialBind:
            yield subset


def _source(subset: UsdGeom.Subset) -> str:
    family = str(subset.GetFamilyNameAttr().Get() or "")
    return LABELS if family == FAMILY else family or GROUPS


def _is_skinned(animated: AnimatedMesh) -> bool:
    return animated.mover.skin is not None and animated.mover.skin.has_joints


def _skinning(animated: AnimatedMesh) -> Skinning:
    skin = animated.mover.skin
    if skin is None or not skin.has_joints:
        return Skinning.rigid(str(animated.mesh.GetPath()), animated.vertex_count)
    names = [str(each) for each in skin.query.GetJointOrder() or skin.skeleton.query.GetJointOrder()]
    indices, weights = skin.query.ComputeVaryingJointInfluences(
        animated.point_count, Usd.TimeCode(animated.start)
    )
    joint = np.array(indices or (), dtype=np.int64).reshape(animated.point_count, -1)
    weight = np.array(weights or (), dtype=np.float64).reshape(animated.point_count, -1)
    if not joint.size or joint.min() < 0 or joint.max() >= len(names):
        raise InvalidSequenceError(
            f"the joint indices and weights of {animated.mesh.GetPath()} do not fit its {animated.point_count} "
            f"points and {len(names)} joints; export the character again"
        )
    rows = np.repeat(np.arange(animated.vertex_count), joint.shape[1])
    vertices = animated.weld.representatives
    matrix = csr_array(
        (weight[vertices].reshape(-1), (rows, joint[vertices].reshape(-1))),
        shape=(animated.vertex_count, len(names)),
    )
    root = str(skin.skeleton.prim.GetPath())
    return Skinning(
        matrix,
        tuple(f"{root}/{name}" for name in names),
        tuple(_above(root, name, skin.skeleton.query) for name in names),
    )


def _above(root: str, joint: str, skeleton: UsdSkel.SkeletonQuery) -> str:
    """Return the path of a joint's parent joint, "" if it has none."""
    every = [str(each) for each in skeleton.GetJointOrder()]
    parent = skeleton.GetTopology().GetParent(every.index(joint)) if joint in every else -1
    return f"{root}/{every[parent]}" if parent >= 0 else ""


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of a sequence's polygons."""

    of_polygon: tuple[IntArray, ...]
    names: Sequence[str]


def define_parts(layer: Sdf.Layer, meshes: Sequence[str], parts: Parts) -> None:
    """Author a subset for every part of every mesh, in place of earlier ones."""
    stage = Usd.Stage.Open(layer)
    for path, of_polygon in zip(meshes, parts.of_polygon, strict=True):
        _define(UsdGeom.Mesh(stage.GetPrimAtPath(path)), of_polygon, parts.names)


def _define(mesh: UsdGeom.Mesh, of_polygon: IntArray, names: Sequence[str]) -> None:
    old = {each.GetPrim().GetName() for each in UsdGeom.Subset.GetGeomSubsets(mesh, "", FAMILY)}
    others = mesh.GetPrim().GetFilteredChildren(Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
    kept = {name for each in others if (name := each.GetName()) not in old}
    free = Identifiers(*kept)
    for part in np.unique(of_polygon).tolist():
        name = free.take(names[part])
        kept.add(name)
        faces = np.flatnonzero(of_polygon == part).astype(np.int32)
        subset = UsdGeom.Subset.CreateGeomSubset(
            mesh, name, UsdGeom.Tokens.face, Vt.IntArrayFromBuffer(faces), FAMILY
        )
        prim = subset.GetPrim()
        prim.SetCustomDataByKey(NUMBER, part)
        if names[part] != name or prim.GetDisplayName():
            prim.SetDisplayName(names[part])
    for name in old.difference(kept):
        mesh.GetPrim().GetChild(name).SetActive(False)
    UsdGeom.Subset.SetFamilyType(mesh, FAMILY, UsdGeom.Tokens.partition)
