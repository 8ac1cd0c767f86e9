"""A stage, meshes on it, and an arm with a skeleton."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from tests.formats.usd.stage_maker import CORNERS, INDICES, Make, raised
from tests.formats.usd_maker import Asset


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "scene.usda"


@pytest.fixture
def asset(tmp_path: Path) -> Asset:
    return Asset(tmp_path / "asset.usda")


@pytest.fixture
def stage(path: Path) -> Usd.Stage:
    return Usd.Stage.CreateNew(str(path))


@pytest.fixture
def make(stage: Usd.Stage) -> Make:
    """Make a quad and a triangle that rise by one unit per time code, or stand still without codes."""

    def mesh_at(path: str, *codes: float) -> UsdGeom.Mesh:
        mesh = UsdGeom.Mesh.Define(stage, path)
        mesh.CreateFaceVertexCountsAttr([4, 3])
        mesh.CreateFaceVertexIndicesAttr(INDICES)
        mesh.CreateSubdivisionSchemeAttr("none")
        points = mesh.CreatePointsAttr()
        if not codes:
            points.Set(Vt.Vec3fArrayFromBuffer(CORNERS))
        for code in codes:
            points.Set(raised(code), code)
        return mesh

    return mesh_at


@pytest.fixture
def arm(stage: Usd.Stage, make: Make) -> UsdGeom.Mesh:
    """A mesh with two joints below a root that is moved; the second joint turns and slides, codes 0 to 4."""
    root = UsdSkel.Root.Define(stage, "/arm")
    root.AddTranslateOp().Set(Gf.Vec3d(5, 0, 0))
    skeleton = UsdSkel.Skeleton.Define(stage, "/arm/bones")
    skeleton.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    joints = Vt.TokenArray(["upper", "upper/lower"])
    rest = [Gf.Matrix4d(1), Gf.Matrix4d().SetTranslate((1, 0, 0))]
    skeleton.CreateJointsAttr(joints)
    skeleton.CreateBindTransformsAttr(rest)
    skeleton.CreateRestTransformsAttr(rest)
    animation = UsdSkel.Animation.Define(stage, "/arm/motion")
    animation.CreateJointsAttr(joints)
    animation.CreateScalesAttr([Gf.Vec3h(1)] * 2)
    for code in range(5):
        animation.CreateTranslationsAttr().Set([Gf.Vec3f(0), Gf.Vec3f(1, code, 0)], code)
        half = np.radians(30 * code) / 2
        animation.CreateRotationsAttr().Set(
            [Gf.Quatf(1), Gf.Quatf(float(np.cos(half)), 0, 0, float(np.sin(half)))], code
        )
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/arm/motion"])
    mesh = make("/arm/skin")
    mesh.AddTranslateOp().Set(Gf.Vec3d(100, 0, 0))  # a skinned mesh ignores its own transform
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/arm/bones"])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * 5)
    binding.CreateJointWeightsPrimvar(False, 2).Set([1, 0, 1, 0, 0.5, 0.5, 0.5, 0.5, 0, 1])
    return mesh
