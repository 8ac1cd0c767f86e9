"""USD: what tells parts of meshes apart besides their materials: families of subsets, colours, joints of skeletons.

Specifications: https://openusd.org/release/api/class_usd_geom_subset.html,
https://openusd.org/release/api/class_usd_geom_gprim.html (displayColor),
https://openusd.org/release/api/class_usd_skel_binding_a_p_i.html
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from pxr import Usd, UsdGeom, UsdShade, UsdSkel
from scipy.sparse import csr_array

from mixseq.arrays import FloatArray
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
    joined_colours,
    joined_skinning,
    sets_of,
)
from mixseq_io.usd.meshes import display_name
from mixseq_io.usd.motion import Track
from mixseq_io.usd.surface import rows_of_corners, within

NUMBER = "mixseq:part"
"""Number of a part in the custom data of its subset."""


def markings_of(header: SequenceHeader, tracks: Sequence[Track]) -> Markings:
    """Return what tells parts of the meshes of a stage apart.

    Parameters
    ----------
    header : SequenceHeader
        The sequence that joins the meshes.
    tracks : sequence of Track
        The meshes in the order of their vertices.
    """
    polygons = [_polygons(track) for track in tracks]
    colours = [_colours(track, own) for track, own in zip(tracks, polygons, strict=True)]
    skinned = any(_is_skinned(track) for track in tracks)
    materials = {source: sets for source, sets in sets_of(header).items() if source == MATERIALS}
    return Markings(
        sets=_families(tracks, polygons) | materials,
        colours=joined_colours(colours, [own.indices.size for own in polygons]),
        skinning=joined_skinning([_skinning(track) for track in tracks]) if skinned else None,
    )


def _polygons(track: Track) -> Polygons:
    """Return the faces by points, as they are in the file."""
    code = Usd.TimeCode(track.start)
    counts = track.mesh.GetFaceVertexCountsAttr().Get(code)
    indices = track.mesh.GetFaceVertexIndicesAttr().Get(code)
    return Polygons(np.array(counts or (), dtype=np.int32), np.array(indices or (), dtype=np.int32))


def _families(tracks: Sequence[Track], polygons: Sequence[Polygons]) -> dict[str, tuple[FaceSet, ...]]:
    """Return subsets of faces by family; ours in the order of their numbers."""
    found: dict[str, list[tuple[int, FaceSet]]] = {}
    first = 0
    for track, own in zip(tracks, polygons, strict=True):
        code = Usd.TimeCode(track.start)
        for subset in _subsets(track.mesh):
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
    """Yield the subsets of a mesh's faces that are none of materials."""
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        of_faces = subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face
        if of_faces and subset.GetFamilyNameAttr().Get() != UsdShade.Tokens.materialBind:
            yield subset


def _source(subset: UsdGeom.Subset) -> str:
    family = str(subset.GetFamilyNameAttr().Get() or "")
    return LABELS if family == FAMILY else family or GROUPS


def _colours(track: Track, polygons: Polygons) -> FloatArray | None:
    """Return ``displayColor`` at the corners ``(sum of counts, 3)``, None if there is none that fits."""
    primvar = UsdGeom.PrimvarsAPI(track.mesh.GetPrim()).FindPrimvarWithInheritance("displayColor")
    if not primvar or not primvar.HasAuthoredValue():
        return None
    values = np.array(primvar.ComputeFlattened(Usd.TimeCode(track.start)) or (), dtype=np.float64).reshape(
        -1, 3
    )
    rows = rows_of_corners(primvar.GetInterpolation(), polygons)
    return values[rows] if within(rows, len(values)) else None


def _is_skinned(track: Track) -> bool:
    return track.mover.skin is not None and track.mover.skin.has_joints


def _skinning(track: Track) -> Skinning:
    skin = track.mover.skin
    if skin is None or not skin.has_joints:
        return Skinning.rigid(str(track.mesh.GetPath()), track.vertex_count)
    names = [str(each) for each in skin.query.GetJointOrder() or skin.skeleton.query.GetJointOrder()]
    indices, weights = skin.query.ComputeVaryingJointInfluences(track.point_count, Usd.TimeCode(track.start))
    joint = np.array(indices or (), dtype=np.int64).reshape(track.point_count, -1)
    weight = np.array(weights or (), dtype=np.float64).reshape(track.point_count, -1)
    if not joint.size or joint.min() < 0 or joint.max() >= len(names):
        raise InvalidSequenceError(
            f"the joint indices and weights of {track.mesh.GetPath()} do not fit its {track.point_count} points and "
            f"{len(names)} joints; export the character again"
        )
    rows = np.repeat(np.arange(track.vertex_count), joint.shape[1])
    vertices = track.weld.representatives
    matrix = csr_array(
        (weight[vertices].reshape(-1), (rows, joint[vertices].reshape(-1))),
        shape=(track.vertex_count, len(names)),
    )
    root = str(skin.skeleton.prim.GetPath())
    return Skinning(
        matrix,
        tuple(f"{root}/{name}" for name in names),
        tuple(_above(root, name, skin.skeleton.query) for name in names),
    )


def _above(root: str, joint: str, skeleton: UsdSkel.SkeletonQuery) -> str:
    """Return the path of the joint above a joint of a skeleton, "" if there is none."""
    every = [str(each) for each in skeleton.GetJointOrder()]
    parent = skeleton.GetTopology().GetParent(every.index(joint)) if joint in every else -1
    return f"{root}/{every[parent]}" if parent >= 0 else ""
