"""USD, writing: files that stand alone."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Tf, Usd, UsdGeom, UsdShade, UsdUtils, Vt

from mixseq.errors import InvalidSequenceError, MixseqWarning, OutputError
from mixseq.mesh.measures import corner_normals
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.header import header_fields
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import open_sequence, read, write
from mixseq_io.usd.stage import define_prim_spec
from tests.formats.usd_maker import TOKENS, Asset, lift, link, load, mesh_at, paint, problems, save, shot


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out.usda"


@pytest.mark.parametrize("extension", ["usda", "usdc", "usd", "usdz"])
@pytest.mark.parametrize("name", ["walker", "Männchen", "1st try.001", ""])
def test_what_is_written_is_a_valid_asset(plain: MeshSequence, tmp_path: Path, extension: str, name: str) -> None:
    path = tmp_path / f"asset.{extension}"
    stage = save(path, MeshSequence.from_arrays(plain.points, plain.polygons, name=name, up_axis="Z"))
    assert problems(stage) == set()
    root = stage.GetDefaultPrim()
    assert Usd.ModelAPI(root).GetKind() == "component"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 4)
    (prim,) = root.GetChildren()
    mesh = UsdGeom.Mesh(prim)
    assert (prim.GetDisplayName() or prim.GetName()) == name or not name
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert not mesh.GetNormalsAttr().HasAuthoredValue()
    assert mesh.GetPointsAttr().GetTimeSamples() == mesh.GetExtentAttr().GetTimeSamples() == [0, 1, 2, 3, 4]
    extents = np.array([mesh.GetExtentAttr().Get(code) for code in range(5)])
    np.testing.assert_array_equal(extents[:, 0], plain.points.min(axis=1))
    np.testing.assert_array_equal(extents[:, 1], plain.points.max(axis=1))


@pytest.mark.parametrize("fps", [24.0, 23.976, 30000 / 1001, 59.94, 1 / 3])
def test_whole_time_codes_stay_whole(tmp_path: Path, fps: float) -> None:
    points = np.zeros((500, 3, 3), np.float32)
    written = MeshSequence.from_arrays(points, [[0, 1, 2]], times=(1001 + np.arange(500)) / fps, fps=fps)
    stage = save(tmp_path / "long.usdc", written)
    assert mesh_at(stage, "/mesh/mesh").GetPointsAttr().GetTimeSamples() == list(range(1001, 1501))
    np.testing.assert_array_equal(load(tmp_path / "long.usdc").times, written.times)


def test_times_that_are_closer_than_the_rounding(tmp_path: Path) -> None:
    times = np.array([1.0, 1.0 + 1e-11, 1.0 + 2e-11])
    points = np.arange(27, dtype=np.float32).reshape(3, 3, 3)
    stage = save(tmp_path / "close.usdc", MeshSequence.from_arrays(points, [[0, 1, 2]], times=times))
    attribute = mesh_at(stage, "/mesh/mesh").GetPointsAttr()
    got = [attribute.Get(code) for code in attribute.GetTimeSamples()]
    np.testing.assert_array_equal(np.array(got), points)


def test_values_beyond_float32(tmp_path: Path) -> None:
    points = np.zeros((3, 4, 3))
    points[2, 1, 0] = 1e39
    for options in ({}, {"clips": 1}):
        with pytest.raises(InvalidSequenceError, match=r"frame 2: vertex 1 is .* too large for USD"):
            write(tmp_path / "large.usdc", MeshSequence.from_arrays(points, [[0, 1, 2]]), **options)
        assert list(tmp_path.iterdir()) == []


def test_x_up_has_no_place(plain: MeshSequence, tmp_path: Path) -> None:
    sequence = MeshSequence.from_arrays(plain.points, plain.polygons, up_axis="X")
    with pytest.raises(OutputError, match="USD stages have Y or Z up, this mesh has X"):
        write(tmp_path / "x.usda", sequence)


@pytest.mark.parametrize("options", [{}, {"clips": 15}])
def test_files_that_are_saved_in_several_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]
) -> None:
    monkeypatch.setattr("mixseq_io.usd.layers._BYTES_BETWEEN_SAVES", 100)
    points = np.random.default_rng(0).normal(size=(40, 6, 3)).astype(np.float32)
    write(tmp_path / "parts.usdc", MeshSequence.from_arrays(points, [[0, 1, 2]]), **options)
    with open_sequence(tmp_path / "parts.usdc") as reader:
        np.testing.assert_array_equal(np.concatenate(list(reader.blocks())), points)


FACES_OF_TWO = Polygons(np.array([4, 3, 3]), np.array([0, 1, 2, 3, 1, 4, 2, 5, 6, 7]))


def two_objects() -> MeshSequence:
    """Return two meshes of one name: one like `shot`, with everything on it, the other a triangle."""
    points = np.concatenate([lift()[::-1], 5 + lift()[:, :3]], axis=1)
    plain = MeshSequence.from_arrays(points, FACES_OF_TWO, name="pair")
    surface = Surface(
        uvs=CornerValues(np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), np.array([0, 1, 2, 3, 0, 1, 2, 3, 2, 1])),
        hard_edges=np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
        face_sets=(
            FaceSet("skin", np.array([0]), "skin"),
            FaceSet("left half", np.array([0, 1])),
            FaceSet("cloth", np.array([2]), "cloth"),
        ),
        objects=(MeshObject("leg.L", "", 5, 2), MeshObject("leg.L", "", 3, 1)),
    )
    return MeshSequence(**{**header_fields(plain), "surface": surface, "points": points})


def test_everything_on_a_mesh_comes_back(path: Path) -> None:
    written = two_objects()
    with pytest.warns(MixseqWarning, match="materials are written by name only: skin, cloth"):
        stage = save(path, written)
    assert problems(stage) == set()
    names = [prim.GetName() for prim in stage.GetPrimAtPath("/pair").GetChildren()]
    assert names == ["Looks", "leg_L", "leg_L_1"]
    got = load(path)
    np.testing.assert_array_equal(got.points, written.points)
    assert got.polygons.same_as(written.polygons)
    before, after = written.surface, got.surface
    assert [(each.name, each.vertex_count) for each in after.objects] == [("leg.L", 5), ("leg.L", 3)]
    assert before.uvs and after.uvs
    np.testing.assert_array_equal(after.uvs.at_corners, before.uvs.at_corners)
    assert before.hard_edges is not None and after.hard_edges is not None
    one, other = (
        corner_normals(written.points, FACES_OF_TWO, each)[:, each] for each in (before.hard_edges, after.hard_edges)
    )
    np.testing.assert_array_equal(one, other)
    sets = {each.name: (each.polygons.tolist(), each.material) for each in after.face_sets}
    assert sets == {"skin": ([0], "/pair/Looks/skin"), "left half": ([0, 1], ""), "cloth": ([2], "/pair/Looks/cloth")}


def test_normals_follow_the_hard_edges(path: Path) -> None:
    hard_edges = np.array([0, 1, 2, 3, 1, 4, 5])  # the edge from 1 to 2 is sharp at vertex 2 only
    stage = save(path, shot(hard_edges=hard_edges))
    mesh = mesh_at(stage, "/mesh/mesh")
    assert mesh.GetNormalsInterpolation() == TOKENS.faceVarying
    assert problems(stage) == set()
    # In frame 1 vertex 4 is one higher; the quad has the area 1, the triangle half of the root of 2.
    quad, triangle = np.array([0, 0, 1]), np.array([-1, 0, 1]) / np.sqrt(2)
    both = np.array([-0.5, 0, 1.5]) / np.sqrt(2.5)
    expected = [quad, both, quad, quad, both, triangle, triangle]
    np.testing.assert_allclose(mesh.GetNormalsAttr().Get(12), expected, atol=1e-6)
    stage = save(path, shot(hard_edges=hard_edges, subdivision="catmullClark"))
    assert not mesh_at(stage, "/mesh/mesh").GetNormalsAttr().HasAuthoredValue()
    assert mesh_at(stage, "/mesh/mesh").GetSubdivisionSchemeAttr().Get() == "catmullClark"


def test_meshes_keep_their_own_subdivision(path: Path, tmp_path: Path) -> None:
    """A sword without subdivision leaves the body its own, also through HDF5."""
    objects = (MeshObject("body", "", 5, 2, subdivision="catmullClark"), MeshObject("sword", "", 3, 1))
    points = np.concatenate([lift(), 5 + lift()[:, :3]], axis=1)
    plain = MeshSequence.from_arrays(points, FACES_OF_TWO)
    write(tmp_path / "pair.h5", replace(plain, surface=Surface(objects=objects)))
    stage = save(path, read(tmp_path / "pair.h5"))
    schemes = [mesh_at(stage, f"/mesh/{name}").GetSubdivisionSchemeAttr().Get() for name in ("body", "sword")]
    assert schemes == ["catmullClark", "none"]
    assert load(path).surface.subdivisions == ("catmullClark", "none")


def test_a_material_on_the_whole_mesh_is_bound_to_it(path: Path) -> None:
    whole = FaceSet("everywhere", np.array([0, 1]), "wool")
    part = FaceSet("patch", np.array([1]), "tweed")
    with pytest.warns(MixseqWarning, match="by name only"):
        stage = save(path, shot(face_sets=(whole, part)))
    assert problems(stage) == set()
    mesh = mesh_at(stage, "/mesh/mesh")
    bound = [
        UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        for prim in (mesh, stage.GetPrimAtPath("/mesh/mesh/patch"))
    ]
    assert [str(material.GetPath()) for material in bound] == ["/mesh/Looks/wool", "/mesh/Looks/tweed"]
    (subset,) = UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets()
    assert subset.GetIndicesAttr().Get() == Vt.IntArray([1])
    assert UsdGeom.Subset.GetFamilyType(mesh, "materialBind") == TOKENS.nonOverlapping


def test_names_that_no_prim_can_have(path: Path) -> None:
    objects = (MeshObject("leg.L", "", 5, 2), MeshObject("leg.R", "", 3, 1))
    points = np.concatenate([lift(), 5 + lift()[:, :3]], axis=1)
    written = MeshSequence.from_arrays(points, FACES_OF_TWO, name="1st try")
    save(path, MeshSequence(**{**header_fields(written), "surface": Surface(objects=objects), "points": points}))
    got = load(path)
    assert (got.name, [each.name for each in got.objects]) == ("1st try", ["leg.L", "leg.R"])


def test_materials_that_overlap(path: Path) -> None:
    one, two, more = np.array([1]), np.array([1]), np.array([0])
    sets = (FaceSet("one", one, "one"), FaceSet("two", two, "two"), FaceSet("two", more))
    with pytest.warns(MixseqWarning) as caught:
        stage = save(path, shot(face_sets=sets))
    assert any("'mesh': the material of 'two' gives way to that of 'one'" in str(each.message) for each in caught)
    assert problems(stage) == set()
    subsets = mesh_at(stage, "/mesh/mesh").GetPrim().GetChildren()
    assert [prim.GetName() for prim in subsets] == ["one", "two", "two_1"]


def test_prims_defined_at_once_are_those_defined_one_by_one() -> None:
    """The same text, and the stage is composed anew once."""
    paths = [Sdf.Path(f"/Looks/{name}") for name in ("wool", "skin", "cloth")]
    one_by_one, at_once = Usd.Stage.CreateInMemory(), Usd.Stage.CreateInMemory()
    composed: list[Usd.Notice.ObjectsChanged] = []
    for stage in (one_by_one, at_once):
        UsdGeom.Scope.Define(stage, "/Looks")
    listener = Tf.Notice.Register(Usd.Notice.ObjectsChanged, lambda notice, _: composed.append(notice), at_once)
    for path in paths:
        UsdShade.Material.Define(one_by_one, path)
    with Sdf.ChangeBlock():
        for path in paths:
            define_prim_spec(at_once.GetRootLayer(), path, "Material")
    listener.Revoke()
    assert at_once.GetRootLayer().ExportToString() == one_by_one.GetRootLayer().ExportToString()
    assert len(composed) == 1


def test_flattened_materials_keep_their_networks(asset: Asset, tmp_path: Path) -> None:
    paint(asset)
    asset.stage.Save()
    (tmp_path / "wool.png").write_bytes(b"a picture")
    (tmp_path / "below").mkdir()
    path = tmp_path / "below" / "flat.usda"
    stage = save(path, asset.read(), flatten=True)
    assert problems(stage) == set()
    assert stage.GetRootLayer().subLayerPaths == []
    material, _ = UsdShade.MaterialBindingAPI(mesh_at(stage, "/walker/walker")).ComputeBoundMaterial()
    assert str(material.GetPath()) == "/walker/Looks/wool"
    surface, _, _ = material.ComputeSurfaceSource()
    picture = surface.GetInput("diffuseColor").GetConnectedSources()[0][0].source
    file = picture.GetPrim().GetAttribute("inputs:file").Get()
    assert file.path == "../wool.png" and Path(file.resolvedPath).samefile(tmp_path / "wool.png")
    where = UsdShade.Shader(stage.GetPrimAtPath("/walker/Looks/wool/where"))
    assert where.GetInput("varname").Get() == "st"  # what the texture coordinates are called now
    assert UsdGeom.PrimvarsAPI(mesh_at(stage, "/walker/walker")).GetPrimvar("st").IsIndexed()


def test_networks_that_leave_their_material(asset: Asset, path: Path) -> None:
    paint(asset)
    shared = UsdShade.Shader.Define(asset.stage, "/set/shared")
    surface = UsdShade.Shader(asset.stage.GetPrimAtPath("/set/looks/wool/surface"))
    link(surface, "roughness", Sdf.ValueTypeNames.Float, shared, "value")
    with pytest.warns(MixseqWarning, match=r"outside of it, which are left out at .*surface\.inputs:roughness"):
        save(path, asset.read(), flatten=True)


@pytest.mark.parametrize("folder", [".", "tiles"])
def test_textures_of_many_tiles(asset: Asset, tmp_path: Path, folder: str) -> None:
    (tmp_path / folder).mkdir(exist_ok=True)
    (tmp_path / "below").mkdir()
    for number in (1001, 1012):
        (tmp_path / folder / f"wool.{number}.png").write_bytes(b"a tile")
    paint(asset, f"./{folder}/wool.<UDIM>.png")
    before = asset.read()
    picture, flat = "/walker/Looks/wool/picture", tmp_path / "below" / "flat.usda"
    stage = save(flat, before, flatten=True)
    expected = Path("..") / folder / "wool.<UDIM>.png"
    assert Path(stage.GetPrimAtPath(picture).GetAttribute("inputs:file").Get().path) == expected
    one, two = (tmp_path / "below" / f"{name}.usdz" for name in ("one", "two"))
    save(one, before, flatten=True)
    save(two, load(one), flatten=True)  # from package to package
    for package in (one, two):
        names = zipfile.ZipFile(package).namelist()
        assert [Path(name).name for name in names[1:]] == ["wool.1001.png", "wool.1012.png"]
        assert not any(".." in name for name in names)
        (file,) = {name.replace("1001", "<UDIM>").replace("1012", "<UDIM>") for name in names[1:]}
        stage = Usd.Stage.Open(str(package))
        assert stage.GetPrimAtPath(picture).GetAttribute("inputs:file").Get().path == file


def test_what_is_temporary_beside_a_package_has_one_name(
    plain: MeshSequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So whoever is killed while packing leaves nothing that the next writer does not find."""
    seen: list[str] = []
    usual = UsdUtils.CreateNewUsdzPackage

    def package(*arguments: Any) -> bool:
        seen.extend(file.name for file in tmp_path.iterdir())
        return bool(usual(*arguments))

    monkeypatch.setattr(UsdUtils, "CreateNewUsdzPackage", package)
    write(tmp_path / "walk.usdz", plain)
    assert len(seen) == 3  # lock, layer, textures
    (lock,) = (name for name in seen if name.endswith(".lock"))
    assert all(name.startswith(lock.removesuffix(".lock")) for name in seen)
    assert [file.name for file in tmp_path.iterdir()] == ["walk.usdz"]


@pytest.mark.parametrize(
    ("values", "indices", "interpolation", "rows"),
    [
        ([[1, 0, 0, 1]], [0] * 6, "constant", None),
        ([[0.5, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 1], [1, 1, 0, 1]], [0, 1, 2, 0, 2, 3], "vertex", None),
        ([[0.5, 0, 0, 1], [0, 1, 0, 1]], [0, 0, 0, 1, 1, 1], "faceVarying", [0, 0, 0, 1, 1, 1]),
    ],
)
def test_colours(
    tmp_path: Path, values: list[list[float]], indices: list[int], interpolation: str, rows: list[int] | None
) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)[None]
    square = MeshSequence.from_arrays(points, [[0, 1, 2], [0, 2, 3]])
    write(
        tmp_path / "a.usda", replace(square, surface=Surface(colours=CornerValues(np.array(values), np.array(indices))))
    )
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/mesh/mesh"))
    colour, opacity = mesh.GetDisplayColorPrimvar(), mesh.GetDisplayOpacityPrimvar()
    assert (colour.GetInterpolation(), colour.Get()) == (interpolation, [tuple(row[:3]) for row in values])
    assert (list(colour.GetIndices()) if colour.IsIndexed() else None) == rows
    alpha = [row[3] for row in values]
    assert (list(opacity.Get()) if opacity.HasAuthoredValue() else [1] * len(alpha)) == alpha
