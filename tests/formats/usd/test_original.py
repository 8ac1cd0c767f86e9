"""USD, writing: which file a sequence is laid over."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdUtils, Vt

import mixseq
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import Origin, Surface
from mixseq.sequence.header import header_fields
from mixseq.sequence.sequence import MeshSequence
from tests.formats.usd_maker import CORNERS, FACES, Asset, lift, load, mesh_at, paint, points_at, save, shot
from tests.meshes import grid


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out.usda"


def test_an_origin_that_is_gone_or_changed(asset: Asset, path: Path) -> None:
    before = asset.read()
    moved = asset.path.rename(asset.path.with_name("moved.usda"))
    with pytest.warns(MixseqWarning, match=r"out\.usda stands alone: .*asset\.usda does not exist; onto=\.\.\."):
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


@pytest.mark.parametrize("interpolation", ["uniform", "vertex", "faceVarying"])
@pytest.mark.parametrize("left_handed", [False, True])
def test_onto_a_file_with_its_faces_in_another_order(
    asset: Asset, path: Path, interpolation: str, left_handed: bool
) -> None:
    rows = [[4, 2, 1], [1, 2, 3, 0]]
    rows = [row[::-1] for row in rows] if left_handed else rows
    asset.mesh.GetFaceVertexCountsAttr().Set([3, 4])
    asset.mesh.GetFaceVertexIndicesAttr().Set([*rows[0], *rows[1]])
    asset.mesh.CreateOrientationAttr("leftHanded" if left_handed else "rightHanded")
    counts = {"uniform": 2, "vertex": 5, "faceVarying": 7}
    asset.mesh.CreateNormalsAttr([(0, 0, 1)] * counts[interpolation])
    asset.mesh.SetNormalsInterpolation(interpolation)
    asset.stage.Save()
    like = MeshSequence.from_arrays(lift(), FACES, up_axis="Z", metres_per_unit=0.01)
    sharp = replace(like, surface=Surface(hard_edges=np.arange(7)))
    stage = save(path, sharp, onto=str(asset.path))
    # The quad is flat; in the last frame the tip of the triangle is two higher.
    quad, triangle = np.array([0, 0, 1]), np.array([-2, 0, 1]) / np.sqrt(5)
    got = np.array(mesh_at(stage, "/set/walker").GetNormalsAttr().Get(12.5))
    if interpolation == "vertex":  # of the corners of a point, one counts
        np.testing.assert_allclose(got[[0, 3, 4]], [quad, quad, triangle], atol=1e-6)
    else:
        expected = [triangle, quad] if interpolation == "uniform" else [triangle] * 3 + [quad] * 4
        np.testing.assert_allclose(got, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"up_axis": "Y"}, "has Z up, the sequence Y"),
        ({"metres_per_unit": 1.0}, "has units of 0.01 m, the sequence of 1 m"),
        (
            {"polygons": Polygons(np.array([3]), np.array([0, 1, 2]))},
            r"no mesh with the faces of 'mesh': polygon 0 of the sequence \(vertices 0 1 2\) is not in /set/walker",
        ),
        ({"vertex_count": 6}, "faces of 'mesh': it has 5 points, the sequence 6 vertices"),
    ],
)
def test_onto_a_file_that_does_not_fit(asset: Asset, path: Path, change: dict[str, Any], message: str) -> None:
    asset.read()
    sound = MeshSequence.from_arrays(lift(), FACES, up_axis="Z", metres_per_unit=0.01)
    points = lift() if "vertex_count" not in change else np.zeros((3, 6, 3), np.float32)
    with pytest.raises(OutputError, match=message):
        save(path, MeshSequence(**{**header_fields(sound), **change, "points": points}), onto=asset.path)
    assert not path.exists()


@pytest.mark.parametrize("orientation", ["leftHanded", "rightHanded"])
def test_difference_from_a_mirrored_mesh(path: Path, orientation: str) -> None:
    """Of a mesh whose polygons are all reversed in the file, only the flipped polygon is a difference."""
    stage = Usd.Stage.CreateNew(str(path.with_name("strip.usda")))
    mesh = UsdGeom.Mesh.Define(stage, "/strip")
    mesh.AddScaleOp().Set(Gf.Vec3f(1 if orientation == "leftHanded" else -1, 1, 1))
    mesh.CreateOrientationAttr(orientation)
    points, faces = grid(3, 4)
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.reshape(-1))
    stage.Save()
    strip = mixseq.read(path.with_name("strip.usda"))
    changed = strip.faces.copy()
    changed[2] = changed[2, ::-1]
    flipped = replace(strip, polygons=Polygons.from_triangles(changed))
    with pytest.raises(OutputError, match=r"polygon 2 of the sequence \(.*\) is flipped in /strip"):
        save(path, flipped, onto=path.with_name("strip.usda"))


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
    with pytest.raises(OutputError, match=r"asset\.usda is the original, .* lost; write to another name$"):
        save(asset.path, before)
    save(path, before)
    with pytest.raises(OutputError, match="would be lost"):  # nor over what is below the file it is laid over
        save(asset.path, load(path))
    assert asset.path.read_bytes() == content
    save(asset.path, before, flatten=True)
    np.testing.assert_array_equal(load(asset.path).points, before.points)


@pytest.mark.parametrize("layers", [0, 1])
@pytest.mark.parametrize("linked", [False, True])
def test_a_package_cannot_replace_what_it_is_from(
    asset: Asset, path: Path, tmp_path: Path, layers: int, linked: bool
) -> None:
    asset.read()
    package = tmp_path / "asset.usdz"
    UsdUtils.CreateNewUsdzPackage(str(asset.path), str(package))
    content, before = package.read_bytes(), load(package)
    if layers:
        save(path, before)
        before = load(path)
    target = tmp_path / "link.usdz" if linked else package
    if linked:
        target.symlink_to(package)
    with pytest.raises(OutputError, match=r"usdz is the original, or a layer .* lost; write to another name$"):
        save(target, before)
    assert package.read_bytes() == content
    save(target, before, flatten=True)  # on explicit wish
    np.testing.assert_array_equal(load(package).points, before.points)


@pytest.mark.parametrize("file", ["out.usdz", "out.usda"])
@pytest.mark.parametrize("flatten", [False, True])
def test_an_origin_that_is_gone_is_told_once(
    asset: Asset, tmp_path: Path, file: str, flatten: bool, recwarn: pytest.WarningsRecorder
) -> None:
    paint(asset)
    before = asset.read()
    asset.path.unlink()
    save(tmp_path / file, before, flatten=flatten)
    (told,) = [str(each.message) for each in recwarn if issubclass(each.category, MixseqWarning)]
    assert re.search(r"asset\.usda.* (is gone|does not exist), and materials are written by name only", told)
    assert "kept of" not in told


@pytest.mark.parametrize(
    ("below", "fps", "expected"),
    [
        ((-1, 48), 30, (-1, 57)),
        ((-1, 48), 50, (-2, 96)),
        ((-1, 48), 25, (-1, 48)),
        ((-1.25, 48), 30, (-1.5, 57)),
        ((0, 3), 29.97 * 25, (0, 89)),
    ],
)
def test_a_range_at_another_rate_stays_whole(
    asset: Asset, path: Path, below: tuple[float, float], fps: float, expected: tuple[float, float]
) -> None:
    asset.stage.SetStartTimeCode(below[0])
    asset.stage.SetEndTimeCode(below[1])
    before = asset.read()
    stage = save(path, MeshSequence.from_header(before.header.with_times(before.times, fps), before.points))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == expected


@pytest.mark.parametrize(
    ("codes", "expected"),
    [
        ([10, 11, 12], (1, 48)),  # all of the motion: the range stays
        ([11, 12], (11, 48)),  # the body stood still after it, and does again
        ([10, 11], (1, 11)),
        ([11], (11, 11)),
        ([10, 60], (1, 60)),
        ([10.5, 11.5], (1, 48)),  # at whole frames of the new rate, less than one away from the ends
    ],
)
def test_a_section_has_a_range_of_its_own(
    asset: Asset, path: Path, codes: list[float], expected: tuple[float, float]
) -> None:
    asset.stage.SetStartTimeCode(1)
    asset.stage.SetEndTimeCode(48)
    points = asset.mesh.GetPointsAttr()
    points.Clear()
    for code in (10, 11, 12):
        points.Set(Vt.Vec3fArrayFromBuffer(lift()[code - 10]), code)
    before = asset.read()
    cut = before.header.with_times(np.array(codes) / 25)
    stage = save(path, MeshSequence.from_header(cut, lift(len(codes))))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == expected
    np.testing.assert_allclose(load(path).times, cut.times)


def test_a_mesh_that_stood_still_keeps_the_range(asset: Asset, path: Path) -> None:
    asset.stage.SetStartTimeCode(1)
    asset.stage.SetEndTimeCode(48)
    asset.mesh.GetPointsAttr().Clear()
    asset.mesh.GetPointsAttr().Set(Vt.Vec3fArrayFromBuffer(CORNERS))
    before = asset.read()
    stage = save(path, MeshSequence.from_header(before.header.with_times(np.array([0, 9, 10]) / 25), lift()))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 48)


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
def test_options_that_contradict_each_other(tmp_path: Path, file: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        save(tmp_path / file, shot(), **options)
