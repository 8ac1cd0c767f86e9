"""USD, reading: which meshes of a stage are meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from mixseq.errors import AmbiguousError, FormatError, MixseqWarning
from tests.formats.usd.stage_maker import INDICES, Make, paths, read, saved


class TestChoosing:
    def test_meshes_that_move_are_joined(self, stage: Usd.Stage, make: Make) -> None:
        make("/set/hero/body", 1, 3)
        make("/set/hero/hat", 2, 3)
        joined = saved(stage)
        assert paths(joined) == ["/set/hero/body", "/set/hero/hat"]
        assert joined.name == "hero"
        assert (joined.times * 24).tolist() == [1, 2, 3]
        assert joined.polygons.indices.tolist() == [*INDICES, *(index + 5 for index in INDICES)]
        assert joined.points[:, [0, 5], 2].tolist() == [[1, 2], [2, 2], [3, 3]]  # held before the first sample
        assert joined.surface.origin is not None
        assert (joined.surface.origin.format, Path(joined.surface.origin.path).name) == ("USD", "scene.usda")

    def test_meshes_that_stand_still_are_left_out_and_named(self, stage: Usd.Stage, make: Make) -> None:
        make("/floor")
        make("/hero/body", 1, 2)
        with pytest.warns(MixseqWarning, match=r"stand still are left out; prim='/' .* takes them, too: '/floor'"):
            assert paths(saved(stage)) == ["/hero/body"]
        assert paths(saved(stage, "/")) == ["/floor", "/hero/body"]
        assert paths(saved(stage, "/floor")) == ["/floor"]
        assert read(Path(stage.GetRootLayer().realPath), "/").name == "scene"

    def test_a_name_stands_for_the_prim(self, stage: Usd.Stage, make: Make) -> None:
        for path in ("/a/walker/walker", "/a/walker/hat", "/b/shoe", "/c/shoe"):
            make(path)
        assert paths(saved(stage, "walker")) == ["/a/walker/walker", "/a/walker/hat"]
        with pytest.raises(AmbiguousError, match=r"'shoe' is in several places, '/b/shoe', '/c/shoe'; give its path"):
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

    @pytest.mark.parametrize("prim", ["/hero/shoe", "hero hat", "/hero/bod", "body.points", "/hero/body1.points"])
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
        with pytest.warns(MixseqWarning, match=r"animated visibility is left out.* always visible: /ghost"):
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
        monkeypatch.setattr("mixseq_io.usd.stage._MAX_PRIMS", 1000)
        make("/level0/mesh")
        for level in range(1, 40):
            for number in range(2):
                prim = stage.DefinePrim(f"/level{level}/copy{number}")
                prim.GetReferences().AddInternalReference(f"/level{level - 1}")
                prim.SetInstanceable(True)
        with pytest.raises(FormatError, match="more than 1000 prims"):
            saved(stage)
