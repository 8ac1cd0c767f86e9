"""USD, reading: scenes of several meshes, characters, instances, surfaces, in stages that are made by hand."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils, Vt

from mixseq.arrays import FloatArray
from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, MixseqError, MixseqWarning
from mixseq.sequence import MeshSequence
from mixseq.surface import FaceSet
from mixseq_io.usd.reader import open_usd
from mixseq_io.usd.seams import weld

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], dtype=np.float32)
INDICES = [0, 1, 2, 3, 1, 4, 2]
Make = Callable[..., UsdGeom.Mesh]


def raised(height: float) -> Any:
    return Vt.Vec3fArrayFromBuffer(CORNERS + np.array([0, 0, height], dtype=np.float32))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "scene.usda"


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


def read(path: Path, prim: str | None = None) -> MeshSequence:
    """Read in this process, where breakpoints and coverage work; `mixseq.read` uses another."""
    with open_usd(path, prim) as reader:
        speeds = reader.velocity_blocks(2)
        return MeshSequence.from_header(
            reader.header,
            np.concatenate(list(reader.blocks(2))),
            None if speeds is None else np.concatenate(list(speeds)),
        )


def saved(stage: Usd.Stage, prim: str | None = None) -> MeshSequence:
    stage.Save()
    return read(Path(stage.GetRootLayer().realPath), prim)


def paths(sequence: MeshSequence) -> list[str]:
    return [each.path for each in sequence.objects]


class TestChoosing:
    def test_meshes_that_move_are_joined(self, stage: Usd.Stage, make: Make) -> None:
        make("/set/hero/body", 1, 3)
        make("/set/hero/hat", 2, 3)
        joined = saved(stage)
        assert paths(joined) == ["/set/hero/body", "/set/hero/hat"]
        assert joined.name == "hero"
        assert (joined.times * 24).tolist() == [1, 2, 3]
        assert joined.polygons.indices.tolist() == [*INDICES, *(index + 5 for index in INDICES)]
        assert joined.points[:, [0, 5], 2].tolist() == [
            [1, 2],
            [2, 2],
            [3, 3],
        ]  # held before the first sample
        assert joined.surface.origin is not None
        assert (joined.surface.origin.format, Path(joined.surface.origin.path).name) == ("USD", "scene.usda")

    def test_meshes_that_stand_still_are_left_out_and_named(self, stage: Usd.Stage, make: Make) -> None:
        make("/floor")
        make("/hero/body", 1, 2)
        with pytest.warns(
            MixseqWarning, match=r"stand still are left out; prim='/' .* takes them, too: '/floor'"
        ):
            assert paths(saved(stage)) == ["/hero/body"]
        assert paths(saved(stage, "/")) == ["/floor", "/hero/body"]
        assert paths(saved(stage, "/floor")) == ["/floor"]
        assert read(Path(stage.GetRootLayer().realPath), "/").name == "scene"

    def test_a_name_stands_for_the_prim(self, stage: Usd.Stage, make: Make) -> None:
        for path in ("/a/walker/walker", "/a/walker/hat", "/b/shoe", "/c/shoe"):
            make(path)
        assert paths(saved(stage, "walker")) == ["/a/walker/walker", "/a/walker/hat"]
        with pytest.raises(
            AmbiguousError, match=r"'shoe' is in several places, '/b/shoe', '/c/shoe'; give its path"
        ):
            saved(stage, "shoe")

    def test_names_that_are_shown_count_too(self, stage: Usd.Stage, make: Make) -> None:
        make("/hero/leg_L").GetPrim().SetDisplayName("leg.L")
        make("/hero/leg_R")
        stage.GetPrimAtPath("/hero").SetDisplayName("Männchen")
        assert saved(stage).name == saved(stage, "/").name == "Männchen"
        assert paths(saved(stage, "leg.L")) == paths(saved(stage, "leg_L")) == ["/hero/leg_L"]
        assert len(paths(saved(stage, "Männchen"))) == 2

    @pytest.mark.parametrize("prim", ["/", "", "/hero/", "hero"])
    def test_slashes_at_the_ends_of_a_path(self, stage: Usd.Stage, make: Make, prim: str) -> None:
        make("/hero/body")
        assert paths(saved(stage, prim)) == ["/hero/body"]

    @pytest.mark.parametrize(
        "prim", ["/hero/shoe", "hero hat", "/hero/bod", "body.points", "/hero/body1.points"]
    )
    def test_a_prim_that_is_not_there(self, stage: Usd.Stage, make: Make, prim: str) -> None:
        for number in range(25):
            make(f"/hero/body{number}")
        with pytest.raises(FormatError, match=r"no mesh at or below .* '/hero/body19' and 5 more"):
            saved(stage, prim)

    def test_hidden_meshes_count_where_there_is_nothing_else(self, stage: Usd.Stage, make: Make) -> None:
        make("/shown")
        UsdGeom.Imageable(make("/rig/cage").GetPrim().GetParent()).GetPrim().SetTypeName("Xform")
        UsdGeom.Imageable(stage.GetPrimAtPath("/rig")).MakeInvisible()
        make("/guide").CreatePurposeAttr("guide")
        make("/proxy").CreatePurposeAttr("proxy")
        make("/render").CreatePurposeAttr("render")
        UsdGeom.Mesh.Define(stage, "/empty")
        assert paths(saved(stage)) == ["/shown", "/render"]
        assert paths(saved(stage, "/rig")) == ["/rig/cage"]
        assert paths(saved(stage, "/guide")) == ["/guide"]

    def test_visibility_over_time_is_told(self, stage: Usd.Stage, make: Make) -> None:
        visibility = make("/ghost", 1, 2).CreateVisibilityAttr()
        visibility.Set("invisible", 1)
        visibility.Set("inherited", 2)
        with pytest.warns(MixseqWarning, match=r"visibility that changes .* always visible: /ghost"):
            assert saved(stage).frame_count == 2

    def test_visibility_that_is_repeated_does_not_change(self, stage: Usd.Stage, make: Make) -> None:
        for path, value in (("/shown", "inherited"), ("/hidden", "invisible")):
            mesh = make(path, 1, 2)
            for code in (1, 2):
                mesh.CreateVisibilityAttr().Set(value, code)
        assert paths(saved(stage)) == ["/shown"]  # without a warning

    def test_point_instances_are_left_out(self, stage: Usd.Stage, make: Make) -> None:
        UsdGeom.PointInstancer.Define(stage, "/forest")
        make("/forest/prototypes/tree", 1, 2)
        with pytest.raises(FormatError, match=r"holds no mesh; it has point instancers, .*: /forest"):
            saved(stage)
        make("/hero", 1, 2)
        with pytest.warns(MixseqWarning, match=r"point instances cannot be read .*: /forest"):
            assert paths(saved(stage)) == ["/hero"]
        assert paths(saved(stage, "/hero")) == ["/hero"]  # which has none below it
        with pytest.raises(FormatError, match="no mesh at or below '/forest'; its meshes are '/hero'"):
            saved(stage, "/forest")

    def test_native_instances_are_resolved(self, stage: Usd.Stage, make: Make) -> None:
        make("/asset/mesh", 1, 2)
        stage.GetPrimAtPath("/asset").SetSpecifier(Sdf.SpecifierClass)
        for number in range(2):
            twin = UsdGeom.Xform.Define(stage, f"/twin{number}")
            twin.AddTranslateOp().Set(Gf.Vec3d(10 * number, 0, 0))
            twin.GetPrim().GetReferences().AddInternalReference("/asset")
            twin.GetPrim().SetInstanceable(True)
        both = saved(stage)
        assert paths(both) == ["/twin0/mesh", "/twin1/mesh"]
        np.testing.assert_array_equal(both.points[:, 5:] - both.points[:, :5], np.full((2, 5, 3), [10, 0, 0]))

    def test_instances_of_instances_without_end(
        self, stage: Usd.Stage, make: Make, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("mixseq_io.usd.prims._MOST_PRIMS", 1000)
        make("/level0/mesh")
        for level in range(1, 40):
            for number in range(2):
                prim = stage.DefinePrim(f"/level{level}/copy{number}")
                prim.GetReferences().AddInternalReference(f"/level{level - 1}")
                prim.SetInstanceable(True)
        with pytest.raises(FormatError, match="more than 1000 prims"):
            saved(stage)


class TestComposition:
    def test_payloads_and_variants(self, path: Path, stage: Usd.Stage, make: Make) -> None:
        make("/asset/mesh", 1, 2)
        stage.SetDefaultPrim(stage.GetPrimAtPath("/asset"))
        stage.Save()
        scene = Usd.Stage.CreateNew(str(path.with_name("shot.usda")))
        hero = scene.DefinePrim("/hero")
        looks = hero.GetVariantSets().AddVariantSet("look")
        for name in ("none", "full"):
            looks.AddVariant(name)
            looks.SetVariantSelection(name)
            if name == "full":
                with looks.GetVariantEditContext():
                    hero.GetPayloads().AddPayload(f"./{path.name}")
        assert paths(saved(scene)) == ["/hero/mesh"]
        looks.SetVariantSelection("none")
        with pytest.raises(FormatError, match="no mesh; it has 1 untyped"):
            saved(scene)

    def test_value_clips(self, path: Path, stage: Usd.Stage, make: Make) -> None:
        make("/mesh", 1)
        stage.GetRootLayer().Export(str(path.with_name("topology.usda")))
        for number in range(2):
            clip = Usd.Stage.CreateNew(str(path.with_name(f"clip.{number}.usda")))
            points = UsdGeom.Mesh.Define(clip, "/mesh").CreatePointsAttr()
            for code in (3 * number, 3 * number + 2):
                points.Set(raised(code), code)
            clip.Save()
        shot = Usd.Stage.CreateNew(str(path.with_name("shot.usda")))
        mesh = UsdGeom.Mesh.Define(shot, "/mesh")
        mesh.CreateFaceVertexCountsAttr([4, 3])
        mesh.CreateFaceVertexIndicesAttr(INDICES)
        clips = Usd.ClipsAPI(mesh.GetPrim())
        clips.SetClipAssetPaths([Sdf.AssetPath("./clip.0.usda"), Sdf.AssetPath("./clip.1.usda")])
        clips.SetClipPrimPath("/mesh")
        clips.SetClipActive([(0, 0), (3, 1)])
        clips.SetClipTimes([(0, 0), (6, 6)])
        sequence = saved(shot)
        codes = sequence.times * 24
        assert set(codes.tolist()) >= {0, 2, 3, 5}
        np.testing.assert_allclose(sequence.points[:, 0, 2], np.minimum(codes, 5), atol=1e-6)

    def test_samples_that_only_rounding_sets_apart_make_one_frame(self, stage: Usd.Stage, make: Make) -> None:
        make("/one", 1, 2, 3)
        make("/two", 1 + 1e-9, 2 - 1e-9, 2.5)
        np.testing.assert_allclose(saved(stage).times * 24, [1, 2, 2.5, 3])

    def test_frames_between_samples_of_a_rotation(self, stage: Usd.Stage, make: Make) -> None:
        turn = make("/mesh").AddRotateZOp()
        for code, degrees in ((0, 0.0), (90, 90.0)):
            turn.Set(degrees, code)
        assert saved(stage).frame_count == 2  # who knows when it is played
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(200)
        turned = saved(stage)
        assert turned.frame_count == 91
        np.testing.assert_allclose(turned.points[45, 1], [np.cos(np.pi / 4), np.sin(np.pi / 4), 0], atol=1e-6)
        stage.SetEndTimeCode(1e300)
        assert saved(stage).frame_count == 91
        turn.Set(0.0, 1e12)
        assert saved(stage).frame_count == 3  # absurd; as sampled

    def test_frames_between_dense_samples_are_not_added(self, stage: Usd.Stage, make: Make) -> None:
        turn = make("/mesh").AddRotateZOp()
        for code in range(6):
            turn.Set(float(code), code)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(5)
        stage.SetTimeCodesPerSecond(30)  # played at 24: every 1.25 time codes
        assert (saved(stage).times * 30).tolist() == [0, 1, 2, 3, 4, 5]


class TestVelocities:
    def give(self, mesh: UsdGeom.Mesh, *codes: float) -> None:
        for code in codes:
            mesh.CreateVelocitiesAttr().Set([Gf.Vec3f(0, 0, 24)] * 5, code)

    def test_all_meshes_need_them(self, stage: Usd.Stage, make: Make) -> None:
        self.give(make("/one", 1, 2), 1, 2)
        two = make("/two", 1, 2)
        with pytest.warns(MixseqWarning, match="only some of its meshes have velocities"):
            assert saved(stage).velocities is None
        self.give(two, 1, 2)
        two.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
        velocities = saved(stage).velocities
        assert velocities is not None
        assert velocities[:, [0, 5], 2].tolist() == [[24, 48], [24, 48]]

    def test_under_a_transform_that_moves(self, stage: Usd.Stage, make: Make) -> None:
        mesh = make("/mesh", 1, 2)
        self.give(mesh, 1, 2)
        for code in (1, 2):
            mesh.AddTranslateOp(opSuffix=f"n{code}").Set(Gf.Vec3d(0), 1)
        assert saved(stage).velocities is not None
        move = mesh.AddTranslateOp()
        move.Set(Gf.Vec3d(0), 1)
        move.Set(Gf.Vec3d(1), 2)
        with pytest.warns(MixseqWarning, match=r"velocities are those under a transform .* left out: /mesh"):
            assert saved(stage).velocities is None


UVS = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.25), (0.75, 0.5), (0.25, 0)], dtype=np.float32)
INTERPOLATIONS = {
    "constant": [0] * 7,
    "uniform": [0, 0, 0, 0, 1, 1, 1],
    "vertex": INDICES,
    "varying": INDICES,
    "faceVarying": list(range(7)),
}


def give_uvs(
    mesh: UsdGeom.Mesh,
    values: FloatArray,
    interpolation: str,
    name: str = "st",
    kind: Sdf.ValueTypeName = Sdf.ValueTypeNames.TexCoord2fArray,
) -> UsdGeom.Primvar:
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, interpolation)
    primvar.Set(Vt.Vec2fArrayFromBuffer(np.ascontiguousarray(values, dtype=np.float32)))
    return primvar


class TestSurface:
    @pytest.mark.parametrize("interpolation", INTERPOLATIONS)
    @pytest.mark.parametrize("indexed", [False, True])
    @pytest.mark.parametrize("left_handed", [False, True])
    def test_texture_coordinates(
        self, stage: Usd.Stage, make: Make, interpolation: str, indexed: bool, left_handed: bool
    ) -> None:
        rows = np.array(INTERPOLATIONS[interpolation])
        count = int(rows.max()) + 1
        mesh = make("/mesh")
        primvar = give_uvs(mesh, UVS if indexed else UVS[:count], interpolation)
        if indexed:
            primvar.SetIndices(Vt.IntArray(range(6, 6 - count, -1)))
            rows = 6 - rows
        if left_handed:
            mesh.CreateOrientationAttr("leftHanded")
            rows = rows[[0, 3, 2, 1, 4, 6, 5]]
        sequence = saved(stage)
        assert sequence.surface.uvs is not None
        np.testing.assert_array_equal(sequence.surface.uvs.at_corners, UVS[rows])
        corners = np.array(INDICES)[[0, 3, 2, 1, 4, 6, 5]] if left_handed else INDICES
        np.testing.assert_array_equal(sequence.polygons.indices, corners)

    def test_the_first_set_of_texture_coordinates(self, stage: Usd.Stage, make: Make) -> None:
        mesh = make("/mesh")
        give_uvs(mesh, UVS[:5], "vertex", "UVMap")
        assert saved(stage).surface.uvs is not None
        give_uvs(mesh, UVS[:5] + 1, "vertex", "amap", Sdf.ValueTypeNames.Float2Array)
        with pytest.warns(MixseqWarning, match="sets of texture coordinates only 'UVMap' is kept: /mesh"):
            saved(stage)
        give_uvs(mesh, UVS[:5] + 2, "vertex", "st", Sdf.ValueTypeNames.Float2Array)
        with pytest.warns(MixseqWarning, match="only 'st' is kept"):
            uvs = saved(stage).surface.uvs
        assert uvs is not None
        assert uvs.at_corners[0].tolist() == [2, 2]

    @pytest.mark.parametrize("indices", [None, [0, 1, 2, 3, 9], [0, 1, 2, -1, 0], [0]])
    def test_texture_coordinates_that_do_not_fit(
        self, stage: Usd.Stage, make: Make, indices: list[int] | None
    ) -> None:
        primvar = give_uvs(make("/mesh"), UVS[:3], "vertex")
        if indices:
            primvar.SetIndices(Vt.IntArray(indices))
        with pytest.warns(MixseqWarning, match="texture coordinates 'st' do not fit"):
            assert saved(stage).surface.uvs is None

    @pytest.mark.parametrize("as_primvar", [False, True])
    def test_normals_tell_the_hard_edges(self, stage: Usd.Stage, make: Make, as_primvar: bool) -> None:
        mesh = make("/mesh")
        flat = [Gf.Vec3f(0, 0, 1)] * 4 + [Gf.Vec3f(0, 1, 0)] * 3
        if as_primvar:
            mesh.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * 5)  # yields to the primvar
            primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
                "normals", Sdf.ValueTypeNames.Normal3fArray, "uniform"
            )
            primvar.Set(Vt.Vec3fArray([flat[4], flat[0]]))
            primvar.SetIndices(Vt.IntArray([1, 0]))
        else:
            mesh.CreateNormalsAttr(flat)
            mesh.SetNormalsInterpolation("faceVarying")
        hard_edges = saved(stage).surface.hard_edges
        assert hard_edges is not None
        shared = hard_edges[:, None] == hard_edges[None, :]
        np.testing.assert_array_equal(shared, np.eye(7, dtype=bool))  # vertices 1 and 2 have two normals
        mesh.CreateSubdivisionSchemeAttr("catmullClark")
        assert saved(stage).surface.hard_edges is None

    def test_normals_of_vertices_are_no_hard_edges(self, stage: Usd.Stage, make: Make) -> None:
        mesh = make("/mesh")
        mesh.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * 5)
        assert saved(stage).surface.hard_edges is None
        mesh.SetNormalsInterpolation("faceVarying")
        with pytest.warns(MixseqWarning, match="normals do not fit the faces"):
            assert saved(stage).surface.hard_edges is None

    def test_materials_and_subsets(self, stage: Usd.Stage, make: Make) -> None:
        mesh = make("/hero/body")
        make("/hero/hat")
        for name in ("skin", "red"):
            UsdShade.Material.Define(stage, f"/looks/{name}")
        bind = UsdShade.MaterialBindingAPI.Apply
        bind(stage.GetPrimAtPath("/hero")).Bind(UsdShade.Material.Get(stage, "/looks/skin"))
        shirt = UsdGeom.Subset.CreateGeomSubset(mesh, "shirt", "face", Vt.IntArray([1]), "materialBind")
        bind(shirt.GetPrim()).Bind(UsdShade.Material.Get(stage, "/looks/red"))
        UsdGeom.Subset.CreateGeomSubset(mesh, "left", "face", Vt.IntArray([0, 1]), "side")
        joined = saved(stage)
        assert [plain(each) for each in joined.surface.face_sets] == [
            ("skin", [0, 1], "/looks/skin"),
            ("shirt", [1], "/looks/red"),
            ("left", [0, 1], ""),
            ("skin", [2, 3], "/looks/skin"),
        ]

    @pytest.mark.parametrize("purpose", ["full", "preview"])
    def test_materials_for_one_purpose(self, stage: Usd.Stage, make: Make, purpose: str) -> None:
        mesh = make("/mesh")
        part = UsdGeom.Subset.CreateGeomSubset(mesh, "part", "face", Vt.IntArray([1]), "materialBind")
        wool, silk = (UsdShade.Material.Define(stage, f"/{name}") for name in ("wool", "silk"))
        bind = UsdShade.MaterialBindingAPI.Apply
        bind(mesh.GetPrim()).Bind(wool, materialPurpose=purpose)
        bind(part.GetPrim()).Bind(silk, materialPurpose=purpose)
        sets = [plain(each) for each in saved(stage).surface.face_sets]
        assert sets == [("wool", [0, 1], "/wool"), ("part", [1], "/silk")]

    def test_subsets_that_change(self, stage: Usd.Stage, make: Make) -> None:
        subset = UsdGeom.Subset.CreateGeomSubset(make("/mesh", 1, 2), "part", "face", Vt.IntArray())
        for code in (1, 2):
            subset.GetIndicesAttr().Set(Vt.IntArray([code - 1]), code)
        with pytest.warns(
            MixseqWarning, match="subsets that change over time stay .* first frame: /mesh/part"
        ):
            assert plain(saved(stage).surface.face_sets[0]) == ("part", [0], "")

    def test_subsets_that_do_not_fit(self, stage: Usd.Stage, make: Make) -> None:
        mesh = make("/mesh")
        UsdGeom.Subset.CreateGeomSubset(mesh, "far", "face", Vt.IntArray([-1, 1, 7]))
        UsdGeom.Subset.CreateGeomSubset(mesh, "dots", "point", Vt.IntArray([0]))
        with pytest.warns(MixseqWarning) as caught:
            assert [plain(each) for each in saved(stage).surface.face_sets] == [("far", [1], "")]
        text = " ".join(str(each.message) for each in caught)
        assert "faces of subsets that the mesh does not have are left out: /mesh/far" in text
        assert "subsets of other elements than faces are left out: /mesh/dots" in text

    def test_subdivision_and_holes(self, stage: Usd.Stage, make: Make) -> None:
        mesh = make("/mesh")
        mesh.CreateSubdivisionSchemeAttr("loop")
        assert saved(stage).surface.subdivision == "loop"
        mesh.CreateHoleIndicesAttr([1])
        with pytest.warns(MixseqWarning, match="holes cannot be kept; these faces become visible: /mesh"):
            saved(stage)

    def test_faces_of_one_mesh_on_vertices_of_the_next(self, stage: Usd.Stage, make: Make) -> None:
        make("/one").GetFaceVertexIndicesAttr().Set([0, 1, 2, 3, 1, 5, 2])
        make("/two")
        with pytest.raises(InvalidSequenceError, match="/one: face 1 uses vertex 5, but vertices are 0 to 4"):
            saved(stage)


def plain(face_set: FaceSet) -> tuple[str, list[int], str]:
    return face_set.name, face_set.polygons.tolist(), face_set.material


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


def lower(points: FloatArray, code: int) -> FloatArray:
    """Move points with the second joint."""
    angle = np.radians(30 * code)
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return np.asarray((points - [1, 0, 0]) @ turn + [1, code, 0])


def baked(stage: Usd.Stage, prim: str, times: FloatArray) -> FloatArray:
    """Return world points as USD bakes them, in a copy."""
    copy = Usd.Stage.Open(stage.Flatten())
    for each in copy.Traverse():
        if UsdSkel.Root(each):
            assert UsdSkel.BakeSkinning(UsdSkel.Root(each))
    mesh = UsdGeom.Mesh(copy.GetPrimAtPath(prim))
    frames = []
    for code in (times * stage.GetTimeCodesPerSecond()).tolist():
        matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(mesh.GetPrim()))
        frames.append(np.array(mesh.GetPointsAttr().Get(code)) @ matrix[:3, :3] + matrix[3, :3])
    return np.array(frames)


class TestCharacters:
    def test_linear_blend_skinning(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        sequence = saved(stage)
        assert paths(sequence) == ["/arm/skin"]
        assert (sequence.times * 24).tolist() == [0, 1, 2, 3, 4]
        second = np.array([0, 0, 0.5, 0.5, 1])[:, None]
        for code in range(5):
            skinned = (1 - second) * CORNERS + second * lower(CORNERS, code)
            np.testing.assert_allclose(sequence.points[code], 2 * skinned + [5, 0, 0], atol=2e-6)
        np.testing.assert_allclose(baked(stage, "/arm/skin", sequence.times), sequence.points, atol=1e-5)

    def test_dual_quaternions(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        linear = saved(stage).points
        UsdSkel.BindingAPI(arm).CreateSkinningMethodAttr("dualQuaternion")
        sequence = saved(stage)
        assert np.abs(sequence.points - linear).max() > 0.1
        # Between two joints of equal weight, rotated by 0 and 120 degrees, a rigid motion by 60 degrees.
        edge = sequence.points[4, 3] - sequence.points[4, 2]
        np.testing.assert_allclose(edge, 2 * np.array([-np.cos(np.pi / 3), -np.sin(np.pi / 3), 0]), atol=2e-6)
        np.testing.assert_allclose(baked(stage, "/arm/skin", sequence.times), sequence.points, atol=1e-5)

    def test_inherited_rigid_bindings(self, stage: Usd.Stage, arm: UsdGeom.Mesh, make: Make) -> None:
        group = UsdGeom.Xform.Define(stage, "/arm/props").GetPrim()
        binding = UsdSkel.BindingAPI.Apply(group)
        binding.CreateSkeletonRel().SetTargets(["/arm/bones"])
        binding.CreateJointIndicesPrimvar(True, 1).Set([0])
        binding.CreateJointWeightsPrimvar(True, 1).Set([1])
        binding.CreateJointsAttr(["upper/lower"])  # the only joint of its own order
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetTranslate((0, 0, 3)))
        make("/arm/props/glove")
        sequence = saved(stage, "glove")
        for code in range(5):
            expected = 2 * lower(np.add(CORNERS, [0, 0, 3]), code) + [5, 0, 0]
            np.testing.assert_allclose(sequence.points[code], expected, atol=2e-6)
        assert paths(saved(stage)) == ["/arm/skin", "/arm/props/glove"]

    def test_blend_shapes_with_inbetweens(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        smile = UsdSkel.BlendShape.Define(stage, "/arm/skin/smile")
        smile.CreateOffsetsAttr([Gf.Vec3f(0, 0, 4)])
        smile.CreatePointIndicesAttr([1])
        smile.CreateInbetween("half").SetOffsets([Gf.Vec3f(0, 0, 10)])
        smile.GetInbetween("half").SetWeight(0.5)
        blink = UsdSkel.BlendShape.Define(stage, "/arm/skin/blink")
        blink.CreateOffsetsAttr([Gf.Vec3f(1, 0, 0)] * 5)
        binding = UsdSkel.BindingAPI(arm)
        binding.CreateBlendShapesAttr(["blink", "smile"])
        binding.CreateBlendShapeTargetsRel().SetTargets([blink.GetPath(), smile.GetPath()])
        animation = UsdSkel.Animation(stage.GetPrimAtPath("/arm/motion"))
        animation.CreateBlendShapesAttr(["smile"])  # nobody blinks
        for code, weight in ((0, 0.0), (1, 0.25), (2, 0.5), (3, 0.75), (4.5, 1.0)):
            animation.CreateBlendShapeWeightsAttr().Set([weight], code)
        sequence = saved(stage)
        assert (sequence.times * 24).tolist() == [0, 1, 2, 3, 4, 4.5]
        # Vertex 1 follows the first joint alone; its height is piecewise linear in the weight.
        weights = np.interp([0, 1, 2, 3, 4, 4.5], [0, 1, 2, 3, 4.5], [0, 0.25, 0.5, 0.75, 1])
        heights = 2 * np.interp(weights, [0, 0.5, 1], [0, 10, 4])
        np.testing.assert_allclose(sequence.points[:, 1, 2], heights, atol=1e-5)
        np.testing.assert_allclose(baked(stage, "/arm/skin", sequence.times), sequence.points, atol=1e-5)

    def test_blend_shapes_alone_leave_the_mesh_where_it_is(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        for name in ("skel:jointIndices", "skel:jointWeights"):
            UsdGeom.PrimvarsAPI(arm).RemovePrimvar(name)
        shape = UsdSkel.BlendShape.Define(stage, "/arm/skin/up")
        shape.CreateOffsetsAttr([Gf.Vec3f(0, 0, 1)] * 5)
        binding = UsdSkel.BindingAPI(arm)
        binding.CreateBlendShapesAttr(["up"])
        binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
        animation = UsdSkel.Animation(stage.GetPrimAtPath("/arm/motion"))
        animation.CreateBlendShapesAttr(["up"])
        for code in (0, 10):
            animation.CreateBlendShapeWeightsAttr().Set([float(code)], code)
        sequence = saved(stage)
        assert (sequence.times * 24).tolist() == [0, 10]
        np.testing.assert_allclose(sequence.points[1], np.add(CORNERS, [105, 0, 10]))

    def test_a_mirrored_skeleton(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        assert saved(stage).polygons.indices.tolist() == INDICES
        UsdGeom.Xformable(stage.GetPrimAtPath("/arm")).AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
        assert saved(stage).polygons.indices.tolist() == [0, 3, 2, 1, 1, 2, 4]

    def test_the_root_moves_too(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        move = UsdGeom.Xformable(stage.GetPrimAtPath("/arm")).GetOrderedXformOps()[0]
        for code in (0, 4.5):
            move.Set(Gf.Vec3d(5, 0, code), code)
        sequence = saved(stage)
        np.testing.assert_allclose(sequence.times * 24, [0, 1, 2, 3, 4, 4.5])
        np.testing.assert_allclose(sequence.points[:, 0, 2], [0, 1, 2, 3, 4, 4.5], atol=1e-6)

    def test_a_pose_at_rest_is_one_frame(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        UsdSkel.BindingAPI(stage.GetPrimAtPath("/arm/bones")).GetAnimationSourceRel().ClearTargets(True)
        sequence = saved(stage)
        np.testing.assert_allclose(sequence.points, [2 * CORNERS + [5, 0, 0]], atol=1e-6)

    def test_a_binding_without_skeleton(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        UsdSkel.BindingAPI(arm).GetSkeletonRel().ClearTargets(True)
        with pytest.warns(MixseqWarning, match=r"bound to no skeleton with a pose .*: /arm/skin"):
            np.testing.assert_allclose(saved(stage).points, [np.add(CORNERS, [105, 0, 0])])

    @pytest.mark.parametrize("indices", [[0, 1] * 4, [0, 9] * 5, [0, -1] * 5])
    def test_joints_that_do_not_fit(self, stage: Usd.Stage, arm: UsdGeom.Mesh, indices: list[int]) -> None:
        binding = UsdSkel.BindingAPI(arm)
        binding.GetJointIndicesPrimvar().Set(Vt.IntArray(indices))
        binding.GetJointWeightsPrimvar().Set(Vt.FloatArray([0.5] * len(indices)))
        with pytest.raises(
            InvalidSequenceError, match=r"frame 0 .* joint indices and weights of /arm/skin do"
        ):
            saved(stage)

    def test_shapes_that_do_not_fit(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        shape = UsdSkel.BlendShape.Define(stage, "/arm/skin/up")
        shape.CreateOffsetsAttr([Gf.Vec3f(0, 0, 1)])
        shape.CreatePointIndicesAttr([77])
        binding = UsdSkel.BindingAPI(arm)
        binding.CreateBlendShapesAttr(["up"])
        binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
        animation = UsdSkel.Animation(stage.GetPrimAtPath("/arm/motion"))
        animation.CreateBlendShapesAttr(["up"])
        animation.CreateBlendShapeWeightsAttr().Set([1.0])
        with pytest.raises(InvalidSequenceError, match=r"frame 0 .* blend shapes of /arm/skin do not fit"):
            saved(stage)

    def test_a_crowd_of_instances(self, path: Path, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        stage.SetDefaultPrim(stage.GetPrimAtPath("/arm"))
        stage.Save()
        crowd = Usd.Stage.CreateNew(str(path.with_name("crowd.usda")))
        for number in range(2):
            prim = UsdGeom.Xform.Define(crowd, f"/crowd/arm{number}").GetPrim()
            body = crowd.DefinePrim(f"/crowd/arm{number}/body")
            body.GetReferences().AddReference(f"./{path.name}")
            body.SetInstanceable(True)
            UsdGeom.Xformable(prim).AddTranslateOp().Set(Gf.Vec3d(0, 0, number))
        joined = saved(crowd)
        assert paths(joined) == ["/crowd/arm0/body/skin", "/crowd/arm1/body/skin"]
        np.testing.assert_allclose(joined.points[:, 5:] - joined.points[:, :5], np.full((5, 5, 3), [0, 0, 1]))
        np.testing.assert_allclose(joined.points[:, :5], read(path).points)

    def test_in_a_package(self, path: Path, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        stage.Save()
        assert UsdUtils.CreateNewUsdzPackage(str(path), str(path.with_suffix(".usdz")))
        np.testing.assert_array_equal(read(path.with_suffix(".usdz")).points, read(path).points)


def test_blocks_can_be_read_again_and_side_by_side(stage: Usd.Stage, arm: UsdGeom.Mesh, path: Path) -> None:
    stage.Save()
    with open_usd(path) as reader:
        whole = np.concatenate(list(reader.blocks(16)))
        for one, two in zip(reader.blocks(1), reader.blocks(1), strict=True):
            np.testing.assert_array_equal(one, two)
        np.testing.assert_array_equal(np.concatenate(list(reader.blocks(2))), whole)
    with pytest.raises(FormatError, match="is closed"):
        next(reader.blocks())


def test_opening_reads_points_of_no_more_than_one_frame(
    stage: Usd.Stage, make: Make, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make("/mesh", *range(50))
    stage.Save()
    asked: list[Any] = []
    get = Usd.Attribute.Get

    def watched(attribute: Usd.Attribute, time: Any = Usd.TimeCode.Default()) -> Any:  # noqa: B008
        asked.append((attribute.GetName(), time))
        return get(attribute, time)

    monkeypatch.setattr(Usd.Attribute, "Get", watched)
    with open_usd(path) as reader:
        assert reader.header.frame_count == 50
    assert [name for name, _ in asked].count("points") == 1


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["CesiumMan", "RiggedFigure", "RiggedSimple"])
def test_real_characters_are_as_usd_bakes_them(data: Path, name: str) -> None:
    file = data / "usd" / f"{name}.usdz"
    sequence = read(file)
    stage = Usd.Stage.Open(str(file))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(sequence.objects[0].path))
    seams = weld(mesh, np.array(mesh.GetPointsAttr().Get()))
    assert sequence.vertex_count == seams.vertex_count < len(seams.of_point)
    expected = baked(stage, sequence.objects[0].path, sequence.times)
    split = sequence.points[:, seams.of_point]
    assert np.abs(split - expected).max() <= 1e-6 * sequence.diagonal
    assert sequence.surface.face_sets[0].material.startswith(f"/{name}/Materials/")


@pytest.mark.realdata
def test_a_real_cache_is_as_its_npz(data: Path) -> None:
    sequence = read(data / "usd" / "q_man_run_blender50.usdc")
    archive = np.load(data / "npz" / "q_man_run.npz")
    np.testing.assert_array_equal(sequence.faces, archive["faces"])
    np.testing.assert_allclose(sequence.points, archive["points"], rtol=0, atol=2.4e-7)
    assert len(sequence.polygons.counts) == 3966


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["CesiumMan.usdz", "RiggedSimple.usdz", "q_man_run_blender50.usdc"])
def test_truncated_files(data: Path, tmp_path: Path, name: str) -> None:
    whole = (data / "usd" / name).read_bytes()
    expected = read(data / "usd" / name).points
    for part in range(1, 10):
        (tmp_path / name).write_bytes(whole[: len(whole) * part // 10])
        with contextlib.suppress(MixseqError):  # packages end with textures, which are not needed
            np.testing.assert_array_equal(read(tmp_path / name).points, expected)
