"""What tests of writing USD have in common: sequences, files to lay them over, and looks at what was written."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import Surface
from mixseq.sequence.header import header_fields
from mixseq.sequence.sequence import MeshSequence, join_blocks
from mixseq.types import FloatArray
from mixseq_io.usd.reader import open_usd
from mixseq_io.usd.writer import write_usd

UsdValidation: Any = import_module("pxr.UsdValidation")  # not in the type stubs yet

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], dtype=np.float32)
FACES = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 1, 4, 2]))
TOKENS = UsdGeom.Tokens


def lift(frames: int = 3) -> FloatArray:
    """Return a quad and a triangle beside it that rise along z by one per frame, and bend ever more."""
    points = np.repeat(CORNERS[None], frames, axis=0)
    points[:, :, 2] += np.arange(frames)[:, None]
    points[:, 4, 2] += np.arange(frames)
    return points


def shot(points: FloatArray | None = None, name: str = "mesh", **surface: Any) -> MeshSequence:
    given = lift() if points is None else points
    plain = MeshSequence.from_arrays(given, FACES, name=name, up_axis="Z", times=[0.0, 0.5, 1.0][: len(given)])
    return MeshSequence(**{**header_fields(plain), "surface": Surface(**surface), "points": given})


def save(path: Path, sequence: MeshSequence, **options: Any) -> Usd.Stage:
    """Write a sequence in two blocks, and open what was written."""
    velocities = sequence.velocities
    write_usd(
        path,
        sequence.header,
        [sequence.points[:2], sequence.points[2:]] if len(sequence) > 2 else [sequence.points],
        None if velocities is None else [velocities[:2], velocities[2:]],
        **options,
    )
    assert not [file for file in path.parent.iterdir() if file.name.startswith(".")]  # no temporary files
    if cached := Sdf.Layer.Find(str(path)):
        cached.Reload(force=True)
    return Usd.Stage.Open(str(path))


def load(path: Path, prim: str | None = None) -> MeshSequence:
    with open_usd(path, prim) as reader:
        return join_blocks(reader.header, reader.blocks(2))


def problems(stage: Usd.Stage) -> set[str]:
    """Return what all validators of USD, and its check of topology, have against a stage."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = {each.GetErrorAsString() for each in UsdValidation.ValidationContext(validators).Validate(stage)}
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if mesh := UsdGeom.Mesh(prim):
            counts, indices = mesh.GetFaceVertexCountsAttr().Get(), mesh.GetFaceVertexIndicesAttr().Get()
            number = len(mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime()))
            fits, why = UsdGeom.Mesh.ValidateTopology(indices, counts, number)
            found |= set() if fits else {why}
    return found


def mesh_at(stage: Usd.Stage, path: str) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
    assert mesh
    return mesh


def points_at(stage: Usd.Stage, path: str, code: float) -> FloatArray:
    return np.asarray(mesh_at(stage, path).GetPointsAttr().Get(code), dtype=np.float32)


def world_points(stage: Usd.Stage, path: str, code: float) -> FloatArray:
    matrix = np.array(mesh_at(stage, path).ComputeLocalToWorldTransform(Usd.TimeCode(code)))
    return np.asarray(points_at(stage, path, code) @ matrix[:3, :3] + matrix[3, :3])


class Asset:
    """A file to lay points over, in 25 time codes per second, with one mesh in it."""

    def __init__(self, path: Path, faces: Polygons = FACES) -> None:
        self.path = path
        self.stage = Usd.Stage.CreateNew(str(path))
        UsdGeom.SetStageUpAxis(self.stage, "Z")
        UsdGeom.SetStageMetersPerUnit(self.stage, 0.01)
        self.stage.SetTimeCodesPerSecond(25)
        self.rig = UsdGeom.Xform.Define(self.stage, "/set")
        self.stage.SetDefaultPrim(self.rig.GetPrim())
        self.mesh = UsdGeom.Mesh.Define(self.stage, "/set/walker")
        self.mesh.CreateSubdivisionSchemeAttr("none")
        self.mesh.CreateFaceVertexCountsAttr(faces.counts.tolist())
        self.mesh.CreateFaceVertexIndicesAttr(faces.indices.tolist())
        for frame, points in enumerate(lift()):
            self.mesh.CreatePointsAttr().Set(Vt.Vec3fArrayFromBuffer(points), frame)
        self.mesh.CreateExtentAttr([(0, 0, 0), (2, 1, 4)])

    def read(self, prim: str | None = None) -> MeshSequence:
        self.stage.Save()
        return load(self.path, prim)


def paint(asset: Asset, texture: str = "./wool.png", uvs: str = "UVMap") -> UsdShade.Material:
    """Give an asset a textured material, that reads texture coordinates of some name."""
    stage = asset.stage
    material = UsdShade.Material.Define(stage, "/set/looks/wool")
    surface = UsdShade.Shader.Define(stage, "/set/looks/wool/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    picture = UsdShade.Shader.Define(stage, "/set/looks/wool/picture")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(texture)
    where = UsdShade.Shader.Define(stage, "/set/looks/wool/where")
    where.CreateIdAttr("UsdPrimvarReader_float2")
    where.CreateInput("varname", Sdf.ValueTypeNames.String).Set(uvs)
    link(picture, "st", Sdf.ValueTypeNames.Float2, where, "result")
    link(surface, "diffuseColor", Sdf.ValueTypeNames.Color3f, picture, "rgb")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    primvar = UsdGeom.PrimvarsAPI(asset.mesh).CreatePrimvar(uvs, Sdf.ValueTypeNames.TexCoord2fArray, TOKENS.vertex)
    primvar.Set(Vt.Vec2fArrayFromBuffer(np.ascontiguousarray(CORNERS[:, :2])))
    UsdShade.MaterialBindingAPI.Apply(asset.mesh.GetPrim()).Bind(material)
    return material


def link(shader: UsdShade.Shader, name: str, kind: Sdf.ValueTypeName, source: UsdShade.Shader, output: str) -> None:
    source.CreateOutput(output, kind)
    shader.CreateInput(name, kind).ConnectToSource(source.ConnectableAPI(), output)


def author_normals(mesh: UsdGeom.Mesh, where: str, interpolation: str) -> None:
    counts = {"uniform": 2, "vertex": 5, "faceVarying": 7, "constant": 1}
    if where == "normals":
        mesh.CreateNormalsAttr([(1, 0, 0)] * counts[interpolation])
        mesh.SetNormalsInterpolation(interpolation)
        return
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, interpolation)
    primvar.Set([(1, 0, 0), (0, 1, 0)])
    primvar.SetIndices([0, 0, 0, 0, 1, 1, 1][: counts[interpolation]] if interpolation != "uniform" else [0, 1])


def character(asset: Asset, scale: float = 1.0) -> UsdGeom.Mesh:
    """Add a triangle that a joint lifts and a blend shape spreads, with the skeleton bound above it."""
    stage = asset.stage
    root = UsdSkel.Root.Define(stage, "/set/rig")
    skeleton = UsdSkel.Skeleton.Define(stage, "/set/rig/bones")
    skeleton.CreateJointsAttr(["root"])
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1)])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1)])
    motion = UsdSkel.Animation.Define(stage, "/set/rig/motion")
    motion.CreateJointsAttr(["root"])
    motion.CreateBlendShapesAttr(["wide"])
    for code in range(3):
        motion.CreateTranslationsAttr().Set([(0, 0, code)], code)
        motion.CreateRotationsAttr().Set([Gf.Quatf(1)], code)
        motion.CreateScalesAttr().Set([Gf.Vec3h(1)], code)
        motion.CreateBlendShapeWeightsAttr().Set([code / 2], code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([motion.GetPath()])
    UsdSkel.BindingAPI.Apply(root.GetPrim()).CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    mesh = UsdGeom.Mesh.Define(stage, "/set/rig/body")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(Vt.Vec3fArrayFromBuffer(CORNERS[:3]))
    mesh.CreateExtentAttr([(0, 0, 0), (1, 1, 0)])
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetScale(Gf.Vec3d(scale, 1, 1)))
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    binding.CreateBlendShapesAttr(["wide"])
    shape = UsdSkel.BlendShape.Define(stage, "/set/rig/body/wide")
    shape.CreateOffsetsAttr([(5, 0, 0)] * 3)
    shape.CreatePointIndicesAttr([0, 1, 2])
    binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
    return mesh
