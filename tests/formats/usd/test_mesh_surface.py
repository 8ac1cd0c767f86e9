"""USD, reading: what is on a mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

import mixseq
from mixseq.errors import MixseqWarning
from mixseq.types import FloatArray
from tests.formats.usd.stage_maker import INDICES, Make, paths, plain, saved

UVS = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.25), (0.75, 0.5), (0.25, 0)], dtype=np.float32)
COLOURS = np.array([(n / 8, 0.25, 1 - n / 8) for n in range(7)], dtype=np.float32)

REVERSED = [0, 3, 2, 1, 4, 6, 5]  # corners of the quad and the triangle, clockwise

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
    @pytest.mark.parametrize("left_handed", [False, True], ids=["right-handed", "left-handed"])
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
            rows = rows[REVERSED]
        sequence = saved(stage)
        assert sequence.surface.uvs is not None
        np.testing.assert_array_equal(sequence.surface.uvs.at_corners, UVS[rows])
        corners = np.array(INDICES)[REVERSED] if left_handed else INDICES
        np.testing.assert_array_equal(sequence.polygons.indices, corners)

    @pytest.mark.parametrize("left_handed", [False, True], ids=["right-handed", "left-handed"])
    @pytest.mark.parametrize("mirrored", [False, True], ids=["unmirrored", "mirrored"])
    def test_attributes_of_corners_follow_the_winding(
        self, stage: Usd.Stage, make: Make, left_handed: bool, mirrored: bool
    ) -> None:
        mesh = make("/mesh")
        give_uvs(mesh, UVS, "faceVarying")
        mesh.CreateDisplayColorPrimvar("faceVarying").Set(COLOURS.tolist())
        mesh.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * 4 + [Gf.Vec3f(0, 1, 0)] * 3)
        mesh.SetNormalsInterpolation("faceVarying")
        unreversed_edges = saved(stage).surface.hard_edges
        if left_handed:
            mesh.CreateOrientationAttr("leftHanded")
        if mirrored:
            mesh.AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
        order = REVERSED if left_handed != mirrored else list(range(7))
        sequence = saved(stage)
        uvs, colours, hard_edges = sequence.surface.uvs, sequence.surface.colours, sequence.surface.hard_edges
        assert uvs is not None and colours is not None and hard_edges is not None and unreversed_edges is not None
        np.testing.assert_array_equal(sequence.polygons.indices, np.array(INDICES)[order])
        np.testing.assert_array_equal(uvs.at_corners, UVS[order])
        np.testing.assert_array_equal(colours.at_corners[:, :3], COLOURS[order])
        np.testing.assert_array_equal(hard_edges, unreversed_edges[order])

    @pytest.mark.parametrize("interpolation", INTERPOLATIONS)
    @pytest.mark.parametrize("opacity", ["none", "alike", "constant"])
    def test_colours(self, stage: Usd.Stage, make: Make, interpolation: str, opacity: str) -> None:
        rows = np.array(INTERPOLATIONS[interpolation])
        mesh = make("/mesh")
        mesh.CreateDisplayColorPrimvar(interpolation).Set(COLOURS[: rows.max() + 1].tolist())
        alpha = np.array([1.0, 0.5, 0.25, 0.75, 0, 0.125, 1])
        if opacity == "alike":
            mesh.CreateDisplayOpacityPrimvar(interpolation).Set(alpha[: rows.max() + 1].tolist())
        elif opacity == "constant":
            mesh.CreateDisplayOpacityPrimvar("constant").Set([0.5])
        colours = saved(stage).surface.colours
        assert colours is not None
        expected = {"none": np.ones(7), "alike": alpha[rows], "constant": np.full(7, 0.5)}[opacity]
        np.testing.assert_array_equal(colours.at_corners, np.column_stack([COLOURS[rows], expected]))

    def test_colours_of_prims_above(self, stage: Usd.Stage, make: Make) -> None:
        make("/asset/mesh")
        above = UsdGeom.PrimvarsAPI(stage.DefinePrim("/asset"))
        above.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "constant").Set([(1, 0, 0.5)])
        colours = saved(stage).surface.colours
        assert colours is not None
        assert colours.at_corners.tolist() == [[1, 0, 0.5, 1]] * 7

    def test_the_first_set_of_colours(self, stage: Usd.Stage, make: Make) -> None:
        mesh = make("/mesh")
        paint = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("paint", Sdf.ValueTypeNames.Color4fArray, "vertex")
        paint.Set([(0, 0, 1, 0.5)] * 5)
        colours = saved(stage).surface.colours
        assert colours is not None
        assert colours.at_corners.tolist() == [[0, 0, 1, 0.5]] * 7
        mesh.CreateDisplayColorPrimvar("constant").Set([(1, 0, 0)])
        with pytest.warns(MixseqWarning, match="sets of colours only 'displayColor' is kept: /mesh"):
            colours = saved(stage).surface.colours
        assert colours is not None
        assert colours.at_corners.tolist() == [[1, 0, 0, 1]] * 7

    def test_colours_that_change_or_do_not_fit(self, stage: Usd.Stage, make: Make) -> None:
        mesh = make("/mesh")
        primvar = mesh.CreateDisplayColorPrimvar("vertex")
        primvar.Set([(1, 0, 0)] * 5, 1)
        primvar.Set([(0, 1, 0)] * 5, 2)
        with pytest.warns(MixseqWarning, match="colours that change over time stay as they are in the first"):
            colours = saved(stage).surface.colours
        assert colours is not None and colours.at_corners[0].tolist() == [1, 0, 0, 1]
        primvar.GetAttr().Clear()
        primvar.Set([(1, 0, 0)] * 4)
        with pytest.warns(MixseqWarning, match="colours 'displayColor' do not fit the faces and are left out"):
            assert saved(stage).surface.colours is None
        primvar.Set([(1, 0, 0)] * 5)
        mesh.CreateDisplayOpacityPrimvar("vertex").Set([0.5])
        with pytest.warns(MixseqWarning, match="opacities 'displayOpacity' do not fit"):
            colours = saved(stage).surface.colours
        assert colours is not None and colours.at_corners[0].tolist() == [1, 0, 0, 1]

    @pytest.mark.parametrize("interpolation", ["vertex", "faceVarying", "uniform", "constant"])
    def test_what_is_on_a_mesh_without_faces(self, stage: Usd.Stage, make: Make, interpolation: str) -> None:
        """As exporters write a mesh from which all faces were taken: primvars, and no corner that has one."""
        body, empty = make("/body"), make("/empty")
        body.CreateDisplayColorPrimvar("constant").Set([(1, 0, 0.5)])
        empty.GetFaceVertexCountsAttr().Set([])
        empty.GetFaceVertexIndicesAttr().Set([])
        empty.CreateDisplayColorPrimvar(interpolation).Set([])
        empty.CreateDisplayOpacityPrimvar(interpolation).Set([])
        give_uvs(empty, UVS[:0], interpolation)
        both = saved(stage)
        assert (both.vertex_count, len(both.polygons.counts)) == (10, 2)
        assert both.surface.uvs is None
        assert both.surface.colours is not None
        assert both.surface.colours.at_corners.tolist() == [[1, 0, 0.5, 1]] * 7

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
    def test_texture_coordinates_that_do_not_fit(self, stage: Usd.Stage, make: Make, indices: list[int] | None) -> None:
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
            primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, "uniform")
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
            ("skin", [0], "/looks/skin"),  # subsets come before the mesh
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
        assert sets == [("wool", [0], "/wool"), ("part", [1], "/silk")]

    @pytest.mark.filterwarnings("ignore:.*glTF")
    def test_a_material_on_a_mesh_of_which_subsets_bind_every_face(
        self, stage: Usd.Stage, make: Make, tmp_path: Path
    ) -> None:
        """As Blender writes meshes of several materials: the first one is on the mesh, too."""
        mesh, bind = make("/mesh"), UsdShade.MaterialBindingAPI.Apply
        for face, name in enumerate(("skin", "cloth")):
            material = UsdShade.Material.Define(stage, f"/{name}")
            part = UsdGeom.Subset.CreateGeomSubset(mesh, name, "face", Vt.IntArray([face]), "materialBind")
            bind(part.GetPrim()).Bind(material)
        bind(mesh.GetPrim()).Bind(UsdShade.Material.Get(stage, "/skin"))
        sequence = saved(stage)
        sets = [("skin", [0], "/skin"), ("cloth", [1], "/cloth")]
        assert [plain(each) for each in sequence.surface.face_sets] == sets
        mixseq.write(tmp_path / "mesh.glb", sequence)
        both = mixseq.read(tmp_path / "mesh.glb").surface.face_sets
        assert [plain(each) for each in both] == [("skin", [0, 1], "skin"), ("cloth", [2], "cloth")]

    def test_a_subset_of_another_family_leaves_the_mesh_its_material(self, stage: Usd.Stage, make: Make) -> None:
        mesh, bind = make("/mesh"), UsdShade.MaterialBindingAPI.Apply
        wool = UsdShade.Material.Define(stage, "/wool")
        bind(mesh.GetPrim()).Bind(wool)
        part = UsdGeom.Subset.CreateGeomSubset(mesh, "part", "face", Vt.IntArray([1]), "side")
        bind(part.GetPrim()).Bind(wool)
        assert plain(saved(stage).surface.face_sets[0]) == ("wool", [0, 1], "/wool")

    def test_subsets_that_change(self, stage: Usd.Stage, make: Make) -> None:
        subset = UsdGeom.Subset.CreateGeomSubset(make("/mesh", 1, 2), "part", "face", Vt.IntArray())
        for code in (1, 2):
            subset.GetIndicesAttr().Set(Vt.IntArray([code - 1]), code)
        with pytest.warns(MixseqWarning, match="subsets that change over time stay .* first frame: /mesh/part"):
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
        with pytest.warns(MixseqWarning, match="left out: /one: face 1 uses vertex 5, but vertices are 0 to 4"):
            assert paths(saved(stage)) == ["/two"]
