"""USD, writing: a stand-alone component file, textures apart.

The default prim ``/<name>`` is an Xform with one Mesh per object and the materials in ``/<name>/Looks``. Meshes are
right-handed and in world space. Normals are written only for hard edges on meshes without subdivision.

Specification: https://openusd.org/release/glossary.html#usdglossary-component
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pxr import Kind, Sdf, Usd, UsdGeom, UsdShade, Vt

from mixseq.sequence import SequenceHeader
from mixseq.surface import WHITE, CornerValues, FaceSet
from mixseq_io.blocks import warn
from mixseq_io.scene_meshes import SceneMesh, split
from mixseq_io.usd.frame_values import Cast, Normals, Placed
from mixseq_io.usd.materials import define_materials
from mixseq_io.usd.paths import Identifiers, identifier
from mixseq_io.usd.prims import define

_LOOKS = "Looks"


def define_component(layer: Sdf.Layer, target: Path, header: SequenceHeader, velocities: bool) -> Cast:
    """Author everything but samples, and return the prims that get them."""
    stage = Usd.Stage.Open(layer)
    name = identifier(header.name)
    root = UsdGeom.Xform.Define(stage, f"/{name}")
    _show_name(root.GetPrim(), header.name)
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kind.Tokens.component)
    scene_meshes = split(header)
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
        values = colours.at_vertices(vertices, scene_mesh.vertex_count, WHITE)
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
