"""Scenes of USD, Alembic and glTF with one mesh that cannot be read: it is named and left out, the others are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import MixseqError, MixseqWarning
from mixseq_io import read
from tests.formats.conftest import lossy
from tests.formats.gltf_maker import TRIANGLE, Maker

GOOD = np.array([[[0, 0, z], [1, 0, z], [0, 1, z]] for z in range(3)], np.float32)


def write_usd(path: Path, spoil: Callable[[Usd.Stage, UsdGeom.Mesh], object], with_good: bool) -> None:
    stage = Usd.Stage.CreateNew(str(path))
    root = UsdSkel.Root.Define(stage, "/root")
    skeleton = UsdSkel.Skeleton.Define(stage, "/root/skeleton")
    skeleton.CreateJointsAttr(["joint"])
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray([Gf.Matrix4d(1)]))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray([Gf.Matrix4d(1)]))
    for name in ("bad", "good") if with_good else ("bad",):
        mesh = UsdGeom.Mesh.Define(stage, f"{root.GetPath()}/{name}")
        mesh.CreateFaceVertexCountsAttr([3])
        mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
        for code, points in enumerate(GOOD):
            mesh.CreatePointsAttr().Set(Vt.Vec3fArrayFromBuffer(points), code)
    spoil(stage, UsdGeom.Mesh(stage.GetPrimAtPath("/root/bad")))
    stage.Save()


def retype(mesh: UsdGeom.Mesh, name: str, kind: Any, value: Any) -> None:
    mesh.GetPrim().RemoveProperty(name)
    spec = mesh.GetPrim().GetStage().GetRootLayer().GetPrimAtPath(mesh.GetPath())
    Sdf.AttributeSpec(spec, name, kind).default = value


def bind(mesh: UsdGeom.Mesh, joints: list[int], points: list[Any] | None = None) -> None:
    if points is not None:
        mesh.GetPointsAttr().Clear()
        mesh.GetPointsAttr().Set(points)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/root/skeleton"])
    binding.CreateJointIndicesPrimvar(False, 1).Set(joints)
    binding.CreateJointWeightsPrimvar(False, 1).Set([1.0] * len(joints))


Types = Sdf.ValueTypeNames
USD: dict[str, Callable[[Usd.Stage, UsdGeom.Mesh], object]] = {
    "points of integers": lambda stage, mesh: retype(mesh, "points", Types.IntArray, [0, 1, 2, 3]),
    "points of text": lambda stage, mesh: retype(mesh, "points", Types.StringArray, ["a", "b"]),
    "corners of text": lambda stage, mesh: retype(mesh, "faceVertexIndices", Types.TokenArray, ["a", "b", "c"]),
    "faces of two corners": lambda stage, mesh: mesh.GetFaceVertexCountsAttr().Set([2, 1]),
    "negative faces": lambda stage, mesh: mesh.GetFaceVertexCountsAttr().Set([-3]),
    "too few corners": lambda stage, mesh: mesh.GetFaceVertexIndicesAttr().Set([0, 1]),
    "missing vertices": lambda stage, mesh: mesh.GetFaceVertexIndicesAttr().Set([0, 1, 7]),
    "changing faces": lambda stage, mesh: [mesh.GetFaceVertexIndicesAttr().Set([0, k, 3 - k], k) for k in (1, 2)],
    "not finite": lambda stage, mesh: mesh.GetPointsAttr().Set([(0, 0, 0), (1, np.nan, 0), (0, 1, 0)], 0),
    "no points, but joints": lambda stage, mesh: bind(mesh, [], []),
    "joints that are not there": lambda stage, mesh: bind(mesh, [0, 5, 0], [(0, 0, 0), (1, 0, 0), (0, 1, 0)]),
    "too few joints": lambda stage, mesh: bind(mesh, [0, 0], [(0, 0, 0), (1, 0, 0), (0, 1, 0)]),
}


@pytest.mark.parametrize("fault", USD)
def test_usd(tmp_path: Path, fault: str) -> None:
    path = tmp_path / "scene.usda"
    write_usd(path, USD[fault], True)
    check_left_out(path, "/root/bad", prim="/")
    path = tmp_path / "alone.usda"
    write_usd(path, USD[fault], False)
    check_refused(path)


def first_primitive(maker: Maker) -> Any:
    return maker.json["meshes"][0]["primitives"][0]


def spoil_accessor(maker: Maker, **fields: Any) -> None:
    primitive = first_primitive(maker)
    maker.json["accessors"][primitive["attributes"]["POSITION"]].update(fields)


GLTF: dict[str, Callable[[Maker], object]] = {
    "missing vertices": lambda maker: first_primitive(maker).update(indices=maker.add([0, 1, 7], "u2")),
    "missing accessor": lambda maker: first_primitive(maker)["attributes"].update(POSITION=99),
    "too many points": lambda maker: spoil_accessor(maker, count=10_000),
    "points of two numbers": lambda maker: spoil_accessor(maker, type="VEC2"),
    "lines": lambda maker: first_primitive(maker).update(mode=1),
    "not finite": lambda maker: maker.json["nodes"][0].update(translation=[1e308, 0, 0], scale=[1e308, 1e308, 1]),
}


@pytest.mark.parametrize("fault", GLTF)
def test_gltf(tmp_path: Path, fault: str) -> None:
    for name in ("scene", "alone"):
        maker = Maker()
        for node in ("bad", "good") if name == "scene" else ("bad",):
            maker.node(node, mesh=maker.mesh(TRIANGLE))
            maker.animate(
                len(maker.json["nodes"]) - 1, "translation", [0, 1 / 24, 2 / 24], [[0, 0, z] for z in range(3)]
            )
        GLTF[fault](maker)
        path = maker.glb(tmp_path / f"{name}.glb")
        if name == "scene":
            check_left_out(path, "bad")
        else:
            check_refused(path)


ALEMBIC = ("no points", "missing vertices", "faces of two corners", "changing faces", "changing points", "no schema")


@pytest.mark.parametrize("fault", ALEMBIC)
def test_alembic(tmp_path: Path, fault: str) -> None:
    abc = pytest.importorskip("alembic3d.Abc")
    from alembic3d import AbcCoreAbstract, AbcGeom

    from tests.formats.alembic.alembic_maker import add_mesh, filled, imath, positions

    for name in ("scene", "alone"):
        archive = abc.OArchive(str(tmp_path / f"{name}.abc"))
        top = archive.getTop()
        if fault == "no schema":
            metadata = AbcCoreAbstract.MetaData()
            metadata.set("schema", "AbcGeom_PolyMesh_v1")
            metadata.set("schemaObjTitle", "AbcGeom_PolyMesh_v1:.geom")
            abc.OObject(top, "bad", metadata)
        elif fault == "no points":
            add_mesh(top, "bad", GOOD[:, :0], faces=[])
        else:
            faces = [0, 1, 7] if fault == "missing vertices" else [0, 1, 2]
            mesh = add_mesh(top, "bad", GOOD[:1], faces=faces)
            corners, counts = [[0, 1, 2], [3]] if fault != "changing faces" else [[0, 2, 1], [3]]
            if fault == "faces of two corners":
                counts = [2, 1]
            points = positions(GOOD[0] if fault != "changing points" else np.concatenate(GOOD[:2]))
            arrays = filled(imath.IntArray, corners), filled(imath.IntArray, counts)
            mesh.getSchema().set(AbcGeom.OPolyMeshSchemaSample(points, *arrays))
            del mesh
        if name == "scene":
            add_mesh(top, "good", GOOD, AbcCoreAbstract.TimeSampling(1 / 24, 0.0), faces=[2, 1, 0])
        del archive, top
    check_left_out(tmp_path / "scene.abc", "/bad", prim="/")
    check_refused(tmp_path / "alone.abc")


LIBRARY_WORDS = (
    "reshape",
    "array of size",
    "pxrInternal",
    "Tf",
    "Vt.",
    "Traceback",
    "could not convert",
    "ERROR:",
    "dtype",
)


def check_left_out(path: Path, name: str, **options: Any) -> None:
    with pytest.warns(MixseqWarning) as caught:
        got = read(path, **options)
    told = [str(warning.message) for warning in caught]
    assert any(name in each and "left out" in each for each in told), told
    assert not any(word in each for each in told for word in LIBRARY_WORDS), told
    assert [each.name for each in got.objects] == ["good"] or got.name == "good"
    np.testing.assert_array_equal(got.points, GOOD)
    np.testing.assert_allclose(got.times, np.arange(3) / 24, atol=1e-12)


def check_refused(path: Path) -> None:
    with lossy(), pytest.raises(MixseqError) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert not any(word in str(caught.value) for word in LIBRARY_WORDS), caught.value
