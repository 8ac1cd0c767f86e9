"""Files of a small mesh with groups, colours, subsets and skins on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.mesh.polygons import Polygons
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import Labels
from tests.formats.usd_maker import Asset

# A quad and a triangle beside it, as in usd_maker.
FACES = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 1, 4, 2]))

POINTS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], dtype=np.float32)

OBJ = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in POINTS)


def mesh(polygons: Polygons = FACES, count: int = 5) -> MeshSequence:
    return MeshSequence.from_arrays(POINTS[None, :count], polygons)


def told(labels: Labels) -> list[str]:
    """Return the name of the label of every triangle."""
    return [labels.names[part] for part in labels.part_of_face]


def groups(path: Path) -> Path:
    path.write_text(OBJ + "g leg\nf 1 2 3 4\ng arm\nf 2 5 3\n")
    return path


def ply(path: Path, colours: list[str]) -> Path:
    rows = [f"{x:g} {y:g} {z:g} {colour}" for (x, y, z), colour in zip(POINTS, colours, strict=True)]
    kinds = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        + kinds
        + "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        + "\n".join([*rows, "4 0 1 2 3", "3 1 4 2"])
        + "\n"
    )
    return path


def subsets(path: Path, family: str = "limbs") -> Asset:
    asset = Asset(path)
    for name, faces in (("leg", [0]), ("arm", [1])):
        UsdGeom.Subset.CreateGeomSubset(asset.mesh, name, "face", Vt.IntArray(faces), family)
    asset.stage.Save()
    return asset


def display_colours(path: Path, values: list[tuple[float, float, float]], interpolation: str) -> Path:
    asset = Asset(path)
    asset.mesh.CreateDisplayColorPrimvar(interpolation).Set(values)
    asset.stage.Save()
    return path


def skinned_strip(path: Path) -> Path:
    """Save two triangles of a square that share no point, each on a joint of its own; the second joint rises."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdSkel.Root.Define(stage, "/man")
    skeleton = UsdSkel.Skeleton.Define(stage, "/man/bones")
    skeleton.CreateJointsAttr(["hip", "hip/knee"])
    for attribute in (skeleton.CreateBindTransformsAttr(), skeleton.CreateRestTransformsAttr()):
        attribute.Set(Vt.Matrix4dArray([Gf.Matrix4d(1.0)] * 2))
    motion = UsdSkel.Animation.Define(stage, "/man/motion")
    motion.CreateJointsAttr(["hip", "hip/knee"])
    motion.CreateRotationsAttr([Gf.Quatf(1.0)] * 2)
    motion.CreateScalesAttr([Gf.Vec3h(1, 1, 1)] * 2)
    for code in (0, 1):
        motion.CreateTranslationsAttr().Set([(0, 0, 0), (0, code, 0)], code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/man/motion"])
    body = UsdGeom.Mesh.Define(stage, "/man/body")
    body.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 0, 0), (1, 1, 0), (0, 1, 0)])
    body.CreateFaceVertexCountsAttr([3, 3])
    body.CreateFaceVertexIndicesAttr([0, 1, 2, 3, 4, 5])
    binding = UsdSkel.BindingAPI.Apply(body.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/man/bones"])
    # In an order of the mesh's own: index 0 is the knee. Points on the diagonal are halves, and are welded.
    binding.CreateJointsAttr(["hip/knee", "hip"])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * 6)
    halves = [0.5, 0.5]
    weights = [*halves, 0.0, 1.0, *halves, *halves, *halves, 1.0, 0.0]
    binding.CreateJointWeightsPrimvar(False, 2).Set(weights)
    stage.Save()
    return path
