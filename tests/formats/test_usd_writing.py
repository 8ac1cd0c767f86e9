"""USD, writing: files that stand alone, layers over other files, value clips, packages."""

from __future__ import annotations

import shutil
import zipfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils, Vt

from mixseq.errors import InvalidSequenceError, MixseqWarning, OutputError, SettingsError
from mixseq.geometry.normals import shared_normals
from mixseq.sequence import FloatArray, MeshSequence, Polygons, collect, header_fields
from mixseq.surface import CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq_io import open_sequence, write
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
    plain = MeshSequence.from_arrays(
        given, FACES, name=name, up_axis="Z", times=[0.0, 0.5, 1.0][: len(given)]
    )
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
        return collect(reader.header, reader.blocks(2))


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


@pytest.fixture
def asset(tmp_path: Path) -> Asset:
    return Asset(tmp_path / "asset.usda")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out.usda"


# Files that stand alone


@pytest.mark.parametrize("extension", ["usda", "usdc", "usd", "usdz"])
@pytest.mark.parametrize("name", ["walker", "Männchen", "1st try.001", ""])
def test_what_is_written_is_a_valid_asset(
    plain: MeshSequence, tmp_path: Path, extension: str, name: str
) -> None:
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
        uvs=CornerValues(
            np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), np.array([0, 1, 2, 3, 0, 1, 2, 3, 2, 1])
        ),
        creases=np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
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
    assert before.creases is not None and after.creases is not None
    one, other = (
        shared_normals(written.points, FACES_OF_TWO, each)[:, each]
        for each in (before.creases, after.creases)
    )
    np.testing.assert_array_equal(one, other)
    sets = {each.name: (each.polygons.tolist(), each.material) for each in after.face_sets}
    assert sets == {
        "skin": ([0], "/pair/Looks/skin"),
        "left half": ([0, 1], ""),
        "cloth": ([2], "/pair/Looks/cloth"),
    }


def test_normals_follow_the_creases(path: Path) -> None:
    creases = np.array([0, 1, 2, 3, 1, 4, 5])  # the edge from 1 to 2 is sharp at vertex 2 only
    stage = save(path, shot(creases=creases))
    mesh = mesh_at(stage, "/mesh/mesh")
    assert mesh.GetNormalsInterpolation() == TOKENS.faceVarying
    assert problems(stage) == set()
    # In frame 1 vertex 4 is one higher; the quad has the area 1, the triangle half of the root of 2.
    quad, triangle = np.array([0, 0, 1]), np.array([-1, 0, 1]) / np.sqrt(2)
    both = np.array([-0.5, 0, 1.5]) / np.sqrt(2.5)
    expected = [quad, both, quad, quad, both, triangle, triangle]
    np.testing.assert_allclose(mesh.GetNormalsAttr().Get(12), expected, atol=1e-6)
    stage = save(path, shot(creases=creases, subdivision="catmullClark"))
    assert not mesh_at(stage, "/mesh/mesh").GetNormalsAttr().HasAuthoredValue()
    assert mesh_at(stage, "/mesh/mesh").GetSubdivisionSchemeAttr().Get() == "catmullClark"


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
    save(
        path,
        MeshSequence(**{**header_fields(written), "surface": Surface(objects=objects), "points": points}),
    )
    got = load(path)
    assert (got.name, [each.name for each in got.objects]) == ("1st try", ["leg.L", "leg.R"])


def test_materials_that_overlap(path: Path) -> None:
    one, two, more = np.array([1]), np.array([1]), np.array([0])
    sets = (FaceSet("one", one, "one"), FaceSet("two", two, "two"), FaceSet("two", more))
    with pytest.warns(MixseqWarning) as caught:
        stage = save(path, shot(face_sets=sets))
    assert any(
        "'mesh': the material of 'two' gives way to that of 'one'" in str(each.message) for each in caught
    )
    assert problems(stage) == set()
    subsets = mesh_at(stage, "/mesh/mesh").GetPrim().GetChildren()
    assert [prim.GetName() for prim in subsets] == ["one", "two", "two_1"]


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
    primvar = UsdGeom.PrimvarsAPI(asset.mesh).CreatePrimvar(
        uvs, Sdf.ValueTypeNames.TexCoord2fArray, TOKENS.vertex
    )
    primvar.Set(Vt.Vec2fArrayFromBuffer(np.ascontiguousarray(CORNERS[:, :2])))
    UsdShade.MaterialBindingAPI.Apply(asset.mesh.GetPrim()).Bind(material)
    return material


def link(
    shader: UsdShade.Shader, name: str, kind: Sdf.ValueTypeName, source: UsdShade.Shader, output: str
) -> None:
    source.CreateOutput(output, kind)
    shader.CreateInput(name, kind).ConnectToSource(source.ConnectableAPI(), output)


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
    with pytest.warns(
        MixseqWarning, match=r"outside of it, which are left out at .*surface\.inputs:roughness"
    ):
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


# Layers over other files


def test_what_usd_takes_from_the_root_layer_only(asset: Asset, path: Path) -> None:
    asset.stage.Save()
    shot = Usd.Stage.CreateNew(str(path.with_name("shot.usda")))
    UsdGeom.SetStageUpAxis(shot, "Z")
    shot.SetTimeCodesPerSecond(1000)
    shot.SetFramesPerSecond(25)
    shot.SetStartTimeCode(-40)
    shot.SetEndTimeCode(4000)
    shot.SetMetadata("expressionVariables", {"ASSET": "asset"})
    shot.DefinePrim("/hero").GetReferences().AddReference('`"./${ASSET}.usda"`')
    shot.Save()
    before = load(path.with_name("shot.usda"))
    stage = save(path, before.with_points(before.points + 1))
    np.testing.assert_array_equal(points_at(stage, "/hero/walker", 80), lift()[2] + 1)
    assert not Sdf.Layer.FindOrOpen(str(path)).HasDefaultPrim()
    assert (stage.GetFramesPerSecond(), stage.GetTimeCodesPerSecond()) == (25, 1000)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (-40, 4000)
    later = MeshSequence.from_header(before.header.with_times([1, 2, 5], 50), before.points)
    stage = save(path, later)  # the range is that of the shot, as long as the frames are in it
    assert (stage.GetFramesPerSecond(), stage.GetTimeCodesPerSecond()) == (50, 50)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (-2, 250)


def test_everything_else_of_the_file_stays(asset: Asset, path: Path) -> None:
    paint(asset)
    asset.path.with_name("wool.png").touch()
    UsdGeom.Camera.Define(asset.stage, "/set/camera").AddTranslateOp().Set(Gf.Vec3d(0, 0, 0), 0)
    slide = UsdGeom.Camera(asset.stage.GetPrimAtPath("/set/camera")).GetOrderedXformOps()[0]
    slide.Set(Gf.Vec3d(50, 0, 0), 50)
    before = asset.read()
    header = before.header.with_times(np.array([0, 0.5, 1.0]), 60)
    stage = save(path, MeshSequence.from_header(header, 2 * before.points))
    assert problems(stage) == set()
    (over,) = Sdf.Layer.FindOrOpen(str(path)).GetPrimAtPath("/set").nameChildren
    assert (over.specifier, sorted(over.properties.keys())) == (Sdf.SpecifierOver, ["extent", "points"])
    assert stage.GetRootLayer().subLayerPaths == ["./asset.usda"]
    assert stage.GetDefaultPrim().GetPath() == "/set"
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.01)
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (60, 0, 60)
    mesh = mesh_at(stage, "/set/walker")
    assert mesh.GetPointsAttr().GetTimeSamples() == mesh.GetExtentAttr().GetTimeSamples() == [0, 30, 60]
    np.testing.assert_array_equal(points_at(stage, "/set/walker", 30), 2 * lift()[1])
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    assert str(material.GetPath()) == "/set/looks/wool"
    # The camera is at its time code 25, of 50, after one second of either file.
    camera = UsdGeom.Xformable(stage.GetPrimAtPath("/set/camera"))
    assert camera.ComputeLocalToWorldTransform(60).ExtractTranslation()[0] == pytest.approx(25)
    got = load(path)
    np.testing.assert_array_equal(got.points, 2 * before.points)
    np.testing.assert_allclose(got.times, header.times)


def test_a_layer_and_its_origin_can_move_together(asset: Asset, tmp_path: Path) -> None:
    written = asset.read()
    (tmp_path / "Läufe [1]").mkdir()
    save(tmp_path / "Läufe [1]" / "größer@.usda", written)
    shutil.copytree(tmp_path, tmp_path.parent / "elsewhere" / "deeper")
    shutil.rmtree(tmp_path)
    moved = load(tmp_path.parent / "elsewhere" / "deeper" / "Läufe [1]" / "größer@.usda")
    np.testing.assert_array_equal(moved.points, written.points)


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_points_are_in_the_space_of_their_prim(
    asset: Asset, path: Path, left_handed: bool, mirrored: bool
) -> None:
    turn = asset.rig.AddRotateZOp()
    for code, degrees in ((0, 0.0), (2, 90.0)):
        turn.Set(degrees, code)
    asset.mesh.AddTranslateOp().Set(Gf.Vec3d(0, 0, 10))
    asset.mesh.AddScaleOp().Set(Gf.Vec3f(-2 if mirrored else 2, 1, 1))
    asset.mesh.CreateOrientationAttr(TOKENS.leftHanded if left_handed else TOKENS.rightHanded)
    before = asset.read()
    written = before.with_points(before.points[::-1].copy())
    stage = save(path, written)
    assert problems(stage) == set()
    for frame, code in enumerate((before.times * 25).tolist()):
        np.testing.assert_allclose(world_points(stage, "/set/walker", code), written.points[frame], atol=1e-5)
    got = load(path)
    np.testing.assert_allclose(got.points, written.points, atol=1e-5)
    assert got.polygons.same_as(before.polygons)
    mesh = mesh_at(stage, "/set/walker")
    extent, own = np.array(mesh.GetExtentAttr().Get(1)), points_at(stage, "/set/walker", 1)
    np.testing.assert_array_equal(extent, [own.min(axis=0), own.max(axis=0)])


def test_a_transform_without_inverse(asset: Asset, path: Path) -> None:
    before = asset.read()
    scale = asset.mesh.AddScaleOp()
    scale.Set(Gf.Vec3f(1, 1, 1), 0)
    scale.Set(Gf.Vec3f(1, 1, 0), 2)
    asset.stage.Save()
    with pytest.raises(OutputError, match=r"transform of /set/walker is singular at 0\.08 s.*flatten=True"):
        save(path, before)
    assert not path.exists()
    save(path, before, flatten=True)
    np.testing.assert_array_equal(load(path).points, before.points)


def test_a_transform_without_inverse_before_the_first_frame(asset: Asset, path: Path) -> None:
    scale = asset.mesh.AddScaleOp()
    for code, value in ((0, 0.0), (1, -2.0), (2, -2.0)):
        scale.Set(Gf.Vec3f(value, 2, 2), code)
    before = asset.read()
    cut = MeshSequence.from_header(before.header.with_times(before.times[1:]), before.points[1:] + 1)
    stage = save(path, cut)
    np.testing.assert_allclose(world_points(stage, "/set/walker", 2), cut.points[-1])


def test_meshes_without_points_or_faces(asset: Asset, path: Path) -> None:
    for name, points in (("nothing", 0), ("dots", 5)):
        mesh = UsdGeom.Mesh.Define(asset.stage, f"/set/rig/{name}")
        mesh.CreateSubdivisionSchemeAttr("none")
        mesh.CreatePointsAttr([(1, 1, 1)] * points)
        mesh.CreateFaceVertexCountsAttr([])
        mesh.CreateFaceVertexIndicesAttr([])
    UsdSkel.Root.Define(asset.stage, "/set/rig")
    before = asset.read("/")
    assert [each.vertex_count for each in before.objects] == [5, 0, 5]
    for options in ({}, {"flatten": True}):
        save(path, before.with_points(before.points + 1), **options)
        got = load(path, "/")
        np.testing.assert_array_equal(got.points, before.points + 1)
        assert [each.vertex_count for each in got.objects] == [5, 0, 5]


def test_several_meshes_go_back_to_their_prims(asset: Asset, path: Path) -> None:
    hat = UsdGeom.Mesh.Define(asset.stage, "/set/hat")
    hat.AddTranslateOp().Set(Gf.Vec3d(0, 0, 3))
    hat.CreateSubdivisionSchemeAttr("none")
    hat.CreateFaceVertexCountsAttr([3])
    hat.CreateFaceVertexIndicesAttr([0, 1, 2])
    for frame, points in enumerate(lift()):
        hat.CreatePointsAttr().Set(Vt.Vec3fArrayFromBuffer(points[:3]), frame)
    before = asset.read("/")
    assert before.vertex_count == 8
    stage = save(path, before.with_points(before.points + 1))
    np.testing.assert_allclose(world_points(stage, "/set/walker", 2), 1 + lift()[2])
    np.testing.assert_allclose(world_points(stage, "/set/hat", 2), 1 + lift()[2, :3] + [0, 0, 3])


def test_velocities(asset: Asset, path: Path) -> None:
    turn = asset.rig.AddRotateZOp()
    turn.Set(90.0)
    before = asset.read()
    speeds = np.zeros_like(before.points)
    speeds[..., 1] = 7
    header = before.header
    stage = save(path, MeshSequence.from_header(header, before.points, speeds))
    got = mesh_at(stage, "/set/walker").GetVelocitiesAttr()
    np.testing.assert_allclose(got.Get(1), [[7, 0, 0]] * 5, atol=1e-6)
    turn.Set(0.0, 0)
    turn.Set(90.0, 2)
    asset.mesh.SetResetXformStack(True)
    asset.stage.Save()
    stage = save(path, MeshSequence.from_header(header, before.points, speeds))
    np.testing.assert_array_equal(mesh_at(stage, "/set/walker").GetVelocitiesAttr().Get(1), [[0, 7, 0]] * 5)
    asset.mesh.SetResetXformStack(False)
    asset.stage.Save()
    with pytest.warns(MixseqWarning, match="velocities are left out where transforms move, too: /set/walker"):
        stage = save(path, MeshSequence.from_header(header, before.points, speeds))
    assert mesh_at(stage, "/set/walker").GetVelocitiesAttr().Get(1) is None


def test_what_belongs_to_the_old_points_is_blocked(asset: Asset, path: Path) -> None:
    for code in range(3):
        asset.mesh.CreateVelocitiesAttr().Set([(1, 0, 0)] * 5, code)
    asset.mesh.CreateAccelerationsAttr([(1, 0, 0)] * 5)
    UsdGeom.ModelAPI.Apply(asset.rig.GetPrim()).SetExtentsHint([(0, 0, 0), (1, 1, 1)])
    stage = save(path, asset.read())
    mesh = mesh_at(stage, "/set/walker")
    assert mesh.GetVelocitiesAttr().Get(1) is None and mesh.GetAccelerationsAttr().Get(1) is None
    assert UsdGeom.ModelAPI(stage.GetDefaultPrim()).GetExtentsHint() in (None, Vt.Vec3fArray())
    box = UsdGeom.BBoxCache(2, ["default"], useExtentsHint=True).ComputeWorldBound(stage.GetDefaultPrim())
    assert box.ComputeAlignedRange().GetMax() == Gf.Vec3d(2, 1, 4)


def author_normals(mesh: UsdGeom.Mesh, where: str, interpolation: str) -> None:
    counts = {"uniform": 2, "vertex": 5, "faceVarying": 7, "constant": 1}
    if where == "normals":
        mesh.CreateNormalsAttr([(1, 0, 0)] * counts[interpolation])
        mesh.SetNormalsInterpolation(interpolation)
        return
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "normals", Sdf.ValueTypeNames.Normal3fArray, interpolation
    )
    primvar.Set([(1, 0, 0), (0, 1, 0)])
    primvar.SetIndices(
        [0, 0, 0, 0, 1, 1, 1][: counts[interpolation]] if interpolation != "uniform" else [0, 1]
    )


@pytest.mark.parametrize("where", ["normals", "primvars:normals"])
@pytest.mark.parametrize("interpolation", ["uniform", "vertex", "faceVarying", "constant"])
@pytest.mark.parametrize("left_handed", [False, True])
def test_normals_are_made_anew(
    asset: Asset, path: Path, where: str, interpolation: str, left_handed: bool
) -> None:
    asset.rig.AddRotateYOp().Set(90.0)
    asset.mesh.AddScaleOp().Set(Gf.Vec3f(1, 1, 2))
    if left_handed:
        asset.mesh.CreateOrientationAttr(TOKENS.leftHanded)
    author_normals(asset.mesh, where, interpolation)
    stage = save(path, asset.read())
    assert problems(stage) == set()
    mesh = mesh_at(stage, "/set/walker")
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if where == "normals":
        got, kind = np.array(mesh.GetNormalsAttr().Get(2)), mesh.GetNormalsInterpolation()
        assert not primvar.HasAuthoredValue()
    else:
        got, kind = np.array(primvar.ComputeFlattened(2)), primvar.GetInterpolation()
        assert not primvar.IsIndexed()
    kept = "vertex" if interpolation == "constant" else interpolation
    assert kind == kept
    groups = {
        "uniform": np.repeat([0, 1], FACES.counts),
        "vertex": FACES.indices,
        # Normals that are the same on all faces of a vertex share one.
        "faceVarying": FACES.indices if where == "normals" else np.arange(7),
    }[kept]
    scaled = np.array([points_at(stage, "/set/walker", 2)])
    expected = shared_normals(scaled, FACES, groups)[0] * (-1 if left_handed else 1)
    # Averages of normals are not those of the scaled mesh, but of the mesh in the world.
    world = shared_normals(scaled * [1, 1, 2], FACES, groups)[0] * [1, 1, 2] * (-1 if left_handed else 1)
    expected = world / np.linalg.norm(world, axis=1, keepdims=True)
    if kept == "faceVarying":
        expected = expected[groups]
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_normals_of_subdivided_meshes_do_not_count(asset: Asset, path: Path) -> None:
    author_normals(asset.mesh, "normals", "vertex")
    asset.mesh.CreateSubdivisionSchemeAttr("catmullClark")
    save(path, asset.read())
    assert not Sdf.Layer.FindOrOpen(str(path)).GetAttributeAtPath("/set/walker.normals")


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


def bake(stage: Usd.Stage) -> None:
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/set/rig")), Gf.Interval(0, 2))


@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_characters_are_not_moved_twice(asset: Asset, path: Path, scale: float) -> None:
    character(asset, scale)
    asset.rig.AddTranslateOp().Set(Gf.Vec3d(100, 0, 0))
    before = asset.read("/set/rig/body")
    # The blend shape comes before the bind transform, which may mirror.
    wide = [CORNERS[:3] + np.array([2.5 * code, 0, 0]) for code in range(3)]
    expected = [wide[code] * np.array([scale, 1, 1]) + np.array([100, 0, code]) for code in range(3)]
    np.testing.assert_allclose(before.points, expected, atol=1e-5)
    written = before.with_points(before.points + 1)
    stage = save(path, written)
    assert problems(stage) - problems(asset.stage) == set()
    prim = stage.GetPrimAtPath("/set/rig/body")
    cache, root = UsdSkel.Cache(), UsdSkel.Root(stage.GetPrimAtPath("/set/rig"))
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkinningQuery(prim)
    assert not (query and (query.HasJointInfluences() or query.HasBlendShapes()))
    assert cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate) == []
    np.testing.assert_allclose(world_points(stage, "/set/rig/body", 2), written.points[2], atol=1e-5)
    got = load(path, "/set/rig/body")  # without a warning
    np.testing.assert_allclose(got.points, written.points, atol=1e-5)
    assert got.polygons.same_as(before.polygons)  # faces point outwards, also if the bind transform mirrors
    # USD takes the bounds of what is below a skeleton's root from the root.
    box = UsdGeom.BBoxCache(2, ["default"]).ComputeWorldBound(root.GetPrim()).ComputeAlignedRange()
    np.testing.assert_allclose(np.array(box.GetMin()), written.points[2].min(axis=0), atol=1e-4)
    np.testing.assert_allclose(np.array(box.GetMax()), written.points[2].max(axis=0), atol=1e-4)
    bake(stage)
    np.testing.assert_allclose(world_points(stage, "/set/rig/body", 2), written.points[2], atol=1e-5)


@pytest.mark.parametrize("applied", [False, True])
@pytest.mark.parametrize("options", [{}, {"clips": 2}])
def test_a_binding_above_the_mesh_is_undone(
    asset: Asset, path: Path, applied: bool, options: dict[str, Any]
) -> None:
    character(asset)
    group = UsdGeom.Xform.Define(asset.stage, "/set/rig/props").GetPrim()
    binding = UsdSkel.BindingAPI.Apply(group)
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    asset.stage.Save()
    Sdf.CopySpec(
        asset.stage.GetRootLayer(), "/set/walker", asset.stage.GetRootLayer(), "/set/rig/props/glove"
    )
    glove = asset.stage.GetPrimAtPath("/set/rig/props/glove")
    if applied:
        UsdSkel.BindingAPI.Apply(glove)
    before = asset.read("/set/rig/props/glove")
    np.testing.assert_allclose(before.points, lift() + np.arange(3)[:, None, None] * [0, 0, 1])
    save(path, before, **options)
    np.testing.assert_allclose(load(path, "/set/rig/props/glove").points, before.points)


def test_the_bounds_of_a_skeleton_contain_its_other_meshes(asset: Asset, path: Path) -> None:
    body = character(asset)
    hat = UsdGeom.Mesh.Define(asset.stage, "/set/rig/hat")
    hat.CreatePointsAttr(body.GetPointsAttr().Get())
    UsdGeom.Boundable(asset.stage.GetPrimAtPath("/set/rig")).CreateExtentAttr([(-9, -9, -9), (0, 0, 0)])
    before = asset.read("/set/rig/body")
    stage = save(path, before.with_points(before.points + 50))
    extent = UsdGeom.Boundable(stage.GetPrimAtPath("/set/rig")).GetExtentAttr().Get(0)
    np.testing.assert_allclose(extent, [(-9, -9, -9), (51, 51, 50)])


def test_instances_become_prims(tmp_path: Path, path: Path) -> None:
    Asset(tmp_path / "asset.usda").stage.Save()
    crowd = Usd.Stage.CreateNew(str(tmp_path / "crowd.usda"))
    UsdGeom.SetStageUpAxis(crowd, "Z")
    UsdGeom.SetStageMetersPerUnit(crowd, 0.01)
    crowd.SetTimeCodesPerSecond(25)
    for place, name in enumerate(("one", "two")):
        prim = UsdGeom.Xform.Define(crowd, f"/crowd/{name}")
        prim.GetPrim().GetReferences().AddReference("./asset.usda")
        prim.GetPrim().SetInstanceable(True)
        prim.AddTranslateOp().Set(Gf.Vec3d(0, 10 * place, 0))
    crowd.SetDefaultPrim(crowd.GetPrimAtPath("/crowd"))
    crowd.Save()
    before = load(tmp_path / "crowd.usda", "/crowd/two")
    with pytest.warns(
        MixseqWarning, match="instances with moving meshes are instances no longer: /crowd/two"
    ):
        stage = save(path, before.with_points(before.points + 1))
    assert problems(stage) == set()
    np.testing.assert_array_equal(world_points(stage, "/crowd/two/walker", 2), lift()[2] + [1, 11, 1])
    np.testing.assert_array_equal(world_points(stage, "/crowd/one/walker", 2), lift()[2])


@pytest.mark.parametrize("options", [{}, {"clips": 2}])
@pytest.mark.parametrize("listed", [False, True])
def test_value_clips_of_the_origin_are_weaker(
    asset: Asset, path: Path, options: dict[str, Any], listed: bool
) -> None:
    asset.stage.Save()
    clip = Usd.Stage.CreateNew(str(asset.path.with_name("clip.usda")))
    mesh = UsdGeom.Mesh(clip.OverridePrim("/set/walker"))
    for code in range(3):
        mesh.CreatePointsAttr().Set([(code, 0, 0)] * 5, code)
        mesh.CreateVelocitiesAttr().Set([(9, 0, 0)] * 5, code)
        mesh.CreateDisplayColorAttr().Set([(code, 0, 0)], code)
    clip.Save()
    asset.mesh.GetPointsAttr().Clear()
    clips = Usd.ClipsAPI(asset.mesh)
    clips.SetClipAssetPaths([Sdf.AssetPath("./clip.usda")])
    clips.SetClipPrimPath("/set/walker")
    clips.SetClipActive([(0, 0)])
    if listed:
        clips.SetClipSets(Sdf.StringListOp.CreateExplicit(["default"]))
    before = asset.read()
    assert before.points[2, 0].tolist() == [2, 0, 0]
    stage = save(path, before.with_points(before.points + 1), **options)
    np.testing.assert_array_equal(points_at(stage, "/set/walker", 2), [[3, 1, 1]] * 5)
    walker = mesh_at(stage, "/set/walker")
    assert walker.GetVelocitiesAttr().Get(1) is None
    assert walker.GetDisplayColorAttr().Get(1)[0] == Gf.Vec3f(1, 0, 0)  # what else they have, stays


def test_a_usdz_file_can_be_below(asset: Asset, path: Path, tmp_path: Path) -> None:
    (tmp_path / "wool.png").write_bytes(b"a picture")
    paint(asset)
    before = asset.read()
    UsdUtils.CreateNewUsdzPackage(str(asset.path), str(tmp_path / "asset.usdz"))
    packed = load(tmp_path / "asset.usdz")
    stage = save(path, packed.with_points(before.points + 1))
    np.testing.assert_array_equal(points_at(stage, "/set/walker", 2), before.points[2] + 1)
    file = stage.GetPrimAtPath("/set/looks/wool/picture").GetAttribute("inputs:file").Get()
    assert file.resolvedPath.endswith("asset.usdz[wool.png]")


# Which file to lay over


def test_an_origin_that_is_gone_or_changed(asset: Asset, path: Path) -> None:
    before = asset.read()
    moved = asset.path.rename(asset.path.with_name("moved.usda"))
    with pytest.warns(
        MixseqWarning, match=r"out\.usda stands alone: .*asset\.usda does not exist; onto=\.\.\."
    ):
        assert save(path, before).GetDefaultPrim().GetName() == "walker"
    assert save(path, before, onto=moved).GetDefaultPrim().GetName() == "set"
    shutil.copy(moved, asset.path)
    asset.stage.Reload()
    asset.mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2, 3, 1, 2, 4])
    asset.stage.Save()
    with pytest.warns(MixseqWarning, match=r"stands alone: .* has no mesh with the faces of '/set/walker'"):
        save(path, before)


def test_onto_a_file_that_the_sequence_did_not_come_from(asset: Asset, path: Path) -> None:
    asset.read()
    like = MeshSequence.from_arrays(lift() + 1, FACES, up_axis="Z", metres_per_unit=0.01)
    stage = save(path, like, onto=str(asset.path))
    np.testing.assert_array_equal(points_at(stage, "/set/walker", 2), lift()[2] + 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"up_axis": "Y"}, "has Z up, the sequence Y"),
        ({"metres_per_unit": 1.0}, "has units of 0.01 m, the sequence of 1 m"),
        ({"polygons": Polygons(np.array([3]), np.array([0, 1, 2]))}, "has no mesh with the faces of 'mesh'"),
        ({"vertex_count": 6}, "has no mesh with the faces of 'mesh'"),
    ],
)
def test_onto_a_file_that_does_not_fit(
    asset: Asset, path: Path, change: dict[str, Any], message: str
) -> None:
    asset.read()
    sound = MeshSequence.from_arrays(lift(), FACES, up_axis="Z", metres_per_unit=0.01)
    points = lift() if "vertex_count" not in change else np.zeros((3, 6, 3), np.float32)
    with pytest.raises(OutputError, match=message):
        save(path, MeshSequence(**{**header_fields(sound), **change, "points": points}), onto=asset.path)
    assert not path.exists()


def test_onto_a_file_that_is_none(path: Path) -> None:
    with pytest.raises(OutputError, match=r"gone\.usda does not exist"):
        save(path, shot(), onto=path.with_name("gone.usda"))
    path.with_name("noise.usda").write_text("noise")
    with pytest.raises(OutputError, match=r"noise\.usda cannot be read as USD"):
        save(path, shot(), onto=path.with_name("noise.usda"))


def test_onto_two_meshes_that_fit(asset: Asset, path: Path) -> None:
    Sdf.CopySpec(asset.stage.GetRootLayer(), "/set/walker", asset.stage.GetRootLayer(), "/set/twin")
    asset.stage.Save()
    like = MeshSequence.from_arrays(lift(), FACES, up_axis="Z", metres_per_unit=0.01)
    with pytest.raises(OutputError, match="has 2 meshes with the faces of 'mesh'"):
        save(path, like, onto=asset.path)


def test_a_file_cannot_be_laid_over_itself(asset: Asset, path: Path) -> None:
    before = asset.read()
    content = asset.path.read_bytes()
    with pytest.raises(
        OutputError, match=r"is laid over .*asset\.usda and cannot replace it; .* \(--flatten\)"
    ):
        save(asset.path, before)
    save(path, before)
    with pytest.raises(
        OutputError, match="cannot replace it"
    ):  # nor over what is below the file it is laid over
        save(asset.path, load(path))
    assert asset.path.read_bytes() == content
    save(asset.path, before, flatten=True)
    np.testing.assert_array_equal(load(asset.path).points, before.points)


def test_origins_of_other_formats_are_none(path: Path) -> None:
    stage = save(path, shot(origin=Origin("glTF", str(path.with_name("walker.glb")))))
    assert stage.GetDefaultPrim().GetName() == "mesh"


@pytest.mark.parametrize(
    ("file", "options", "message"),
    [
        ("out.usda", {"flatten": True, "onto": "asset.usda"}, "leave out either onto or flatten"),
        ("out.usda", {"clips": -1}, "clips is -1"),
        ("out.usdz", {"clips": 2}, "has everything in itself"),
        ("out.usdz", {"onto": "asset.usda"}, "has everything in itself"),
    ],
)
def test_options_that_contradict_each_other(
    tmp_path: Path, file: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(SettingsError, match=message):
        save(tmp_path / file, shot(), **options)


# Value clips


@pytest.mark.parametrize("over", [False, True])
@pytest.mark.parametrize("length", [1, 2, 3, 7, 100])
def test_clips_give_the_same_as_one_file(asset: Asset, path: Path, over: bool, length: int) -> None:
    points = np.random.default_rng(3).normal(size=(7, 5, 3)).astype(np.float32)
    times = np.array([0, 0.1, 0.2, 0.3, 0.35, 0.4, 1.7])
    beneath = asset.read()
    header = (beneath if over else shot()).header.with_times(times, 30)
    written = MeshSequence.from_header(header, points, -points)
    whole, prim = path.with_name("whole.usdc"), "/set/walker" if over else "/mesh/mesh"
    save(whole, written)
    stage, expected = save(path, written, clips=length), Usd.Stage.Open(str(whole))
    assert problems(stage) == set()
    files = sorted(file.name for file in path.with_name("out.usda.clips").iterdir())
    count = -(-7 // length)
    assert files == [*(f"out.{number:04d}.usdc" for number in range(1, count + 1)), "out.manifest.usdc"]
    one, other = mesh_at(stage, prim), mesh_at(expected, prim)
    codes = other.GetPointsAttr().GetTimeSamples()
    assert one.GetPointsAttr().GetTimeSamples() == codes
    between = (np.array(codes[1:]) + np.array(codes[:-1])) / 2
    for code in [codes[0] - 1, *codes, *between.tolist(), codes[-1] + 1]:
        for name in ("points", "extent", "velocities"):
            got, known = (mesh.GetPrim().GetAttribute(name).Get(code) for mesh in (one, other))
            assert got == known
    back = load(path)
    np.testing.assert_array_equal(back.points, points)
    np.testing.assert_array_equal(back.times, load(whole).times)


def test_clips_of_a_character_with_normals(asset: Asset, path: Path) -> None:
    body = character(asset)
    author_normals(body, "primvars:normals", "constant")
    before = asset.read("/set/rig/body")
    stage = save(path, before.with_points(before.points + 1), clips=2)
    assert problems(stage) - problems(asset.stage) == set()
    np.testing.assert_array_equal(load(path, "/set/rig/body").points, before.points + 1)
    primvar = UsdGeom.PrimvarsAPI(mesh_at(stage, "/set/rig/body")).GetPrimvar("normals")
    assert primvar.GetInterpolation() == "vertex"
    np.testing.assert_allclose(primvar.Get(2), [(0, 0, 1)] * 3)
    root = UsdGeom.Boundable(stage.GetPrimAtPath("/set/rig"))
    np.testing.assert_allclose(root.GetExtentAttr().Get(2)[1], before.points[2].max(axis=0) + 1)


def test_clips_follow_the_shot_that_refers_to_them(path: Path) -> None:
    save(path, shot(), clips=1)
    later = Usd.Stage.CreateInMemory()
    later.SetTimeCodesPerSecond(24)
    later.DefinePrim("/there").GetReferences().AddReference(str(path), Sdf.LayerOffset(1000, 2))
    points = mesh_at(later, "/there/mesh").GetPointsAttr()
    assert points.GetTimeSamples() == [1000, 1024, 1048]
    np.testing.assert_array_equal(points.Get(1024), lift()[1])


def test_clips_replace_older_ones(path: Path) -> None:
    save(path, shot(), clips=1)
    save(path, shot(lift() + 1), clips=2)
    assert len(list(path.with_name("out.usda.clips").iterdir())) == 3
    assert sorted(file.name for file in path.parent.iterdir()) == ["out.usda", "out.usda.clips"]
    np.testing.assert_array_equal(
        Sdf.Layer.OpenAsAnonymous(str(path.with_name("out.usda.clips") / "out.0002.usdc")).QueryTimeSample(
            "/mesh/mesh.points", 24
        ),
        lift()[2] + 1,
    )


def test_files_of_one_name_have_clips_of_their_own(path: Path) -> None:
    save(path, shot(), clips=1)
    save(path.with_suffix(".usdc"), shot(lift() + 1), clips=2)
    np.testing.assert_array_equal(load(path).points, lift())
    np.testing.assert_array_equal(load(path.with_suffix(".usdc")).points, lift() + 1)


@pytest.mark.parametrize("clips", [(2, 0), (0, 2), (2, 3)])
@pytest.mark.parametrize("rates", [(24, 60), (60, 25)])
def test_layers_over_layers(
    asset: Asset, path: Path, clips: tuple[int, int], rates: tuple[float, float]
) -> None:
    before = asset.read()
    between = path.with_name("between.usda")
    header = before.header.with_times([0, 0.5, 1], rates[0])
    save(between, MeshSequence.from_header(header, before.points + 1), clips=clips[0])
    header = load(between).header.with_times(np.linspace(0, 2, 5), rates[1])
    points = np.random.default_rng(1).normal(size=(5, 5, 3)).astype(np.float32)
    save(path, MeshSequence.from_header(header, points), clips=clips[1])
    got = load(path)
    np.testing.assert_allclose(got.times, header.times, atol=1e-12)
    np.testing.assert_array_equal(got.points, points)


@pytest.mark.parametrize("earlier", [False, True])
@pytest.mark.parametrize("step", ["values", "fsync", "rename", "replace"])
def test_nothing_half_written_stays(
    path: Path, files: Any, monkeypatch: pytest.MonkeyPatch, earlier: bool, step: str
) -> None:
    if earlier:
        save(path, shot(), clips=1)
    before = files()
    points = lift() + 1.0

    def refuse(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    if step == "values":
        points[2] = np.inf
    else:
        monkeypatch.setattr("os.fsync" if step == "fsync" else f"pathlib.Path.{step}", refuse)
    with pytest.raises((OutputError, InvalidSequenceError)):
        write_usd(path, shot().header, [points], clips=2)
    monkeypatch.undo()
    assert files() == before
    assert not path.with_name("out.usda.clips").exists() or earlier


def test_a_folder_of_clips_with_something_else_in_it(path: Path) -> None:
    folder = path.with_name("out.usda.clips")
    folder.mkdir()
    (folder / "notes.txt").write_text("keep me")
    with pytest.raises(OutputError, match=r"out\.usda\.clips has other files than clips"):
        save(path, shot(), clips=2)
    assert (folder / "notes.txt").read_text() == "keep me"


# Packages


def test_a_package_has_its_textures(asset: Asset, tmp_path: Path) -> None:
    (tmp_path / "wool.png").write_bytes(b"a picture")
    paint(asset)
    before = asset.read()
    with pytest.warns(MixseqWarning, match=r"stands alone, as \.usdz files do: .*asset\.usda"):
        save(tmp_path / "one.usdz", before)
    again = load(tmp_path / "one.usdz")
    save(tmp_path / "two.usdz", again, flatten=True)  # from package to package
    for name, inside in (("one", "wool.png"), ("two", "0/wool.png")):
        moved = tmp_path / "alone"
        moved.mkdir()
        shutil.copy(tmp_path / f"{name}.usdz", moved)
        stage = Usd.Stage.Open(str(moved / f"{name}.usdz"))
        assert problems(stage) == set()
        prim = stage.GetPrimAtPath("/walker/Looks/wool/picture")
        assert prim.GetAttribute("inputs:file").Get().resolvedPath == f"{moved}/{name}.usdz[{inside}]"
        np.testing.assert_array_equal(load(moved / f"{name}.usdz").points, before.points)
        shutil.rmtree(moved)


# Real files


@pytest.mark.realdata
@pytest.mark.parametrize(
    "name", ["CesiumMan.usdz", "RiggedFigure.usdz", "RiggedSimple.usdz", "q_man_run_blender50.usdc"]
)
@pytest.mark.parametrize("options", [{}, {"clips": 10}, {"flatten": True}])
def test_real_files(data: Path, tmp_path: Path, name: str, options: dict[str, Any]) -> None:
    file = data / "usd" / name
    before = load(file)
    written = before.with_points(before.points * np.float32(1.5))
    stage, origin = save(tmp_path / "out.usdc", written, **options), Usd.Stage.Open(str(file))
    assert problems(stage) - problems(origin) == set()
    got = load(tmp_path / "out.usdc")
    np.testing.assert_allclose(got.points, written.points, atol=1e-6 * written.diagonal)
    np.testing.assert_array_equal(got.times, before.times)
    assert got.polygons.same_as(before.polygons)
    assert [each.polygons.tolist() for each in got.surface.face_sets] == [
        each.polygons.tolist() for each in before.surface.face_sets
    ]
    for prim in stage.Traverse():
        if mesh := UsdGeom.Mesh(prim):
            material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
            assert bool(material) == bool(before.surface.face_sets)
            if material:
                assert material.ComputeSurfaceSource()[0]
    assert {each.typeName for each in stage.GetRootLayer().rootPrims} <= {"", "Xform"}
