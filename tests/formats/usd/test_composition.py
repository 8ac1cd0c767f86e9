"""USD, reading: composed stages, their frames and velocities, and how they are read in blocks."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from mixseq.errors import FormatError, MixseqWarning
from mixseq_io.usd.reader import open_usd
from tests.formats.usd.stage_maker import INDICES, Make, paths, raised, saved


@pytest.mark.parametrize("arc", ["subLayers = [@./pipe.usda@]", "references"])
def test_a_pipe_is_no_layer(tmp_path: Path, arc: str) -> None:
    os.mkfifo(tmp_path / "pipe.usda")
    layer, prim = (arc, "") if arc != "references" else ("", "references = @./pipe.usda@")
    (tmp_path / "scene.usda").write_text(f'#usda 1.0\n(\n{layer}\n)\ndef "a" ({prim}) {{}}\n')
    with pytest.raises(FormatError, match=r"pipe\.usda is a pipe, a socket or a device, not a layer for .*scene\.usda"):
        open_usd(tmp_path / "scene.usda")


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
        with pytest.warns(MixseqWarning, match=r"velocities lack the motion .* left out: /mesh"):
            assert saved(stage).velocities is None


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
