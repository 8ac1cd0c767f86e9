"""USD, reading: faulty files of other exporters, of which everything else is read."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from mixseq.errors import InvalidSequenceError, MixseqWarning, NoMeshError
from mixseq_io.usd.stage import clips_folder, find_clips
from tests.formats.usd.stage_maker import INDICES, raised, read

KEYS = ("metersPerUnit", "timeCodesPerSecond", "framesPerSecond", "startTimeCode", "endTimeCode")
VALUES = {key: float(np.float32(value)) for key, value in zip(KEYS, (0.3048, 48.7, 12.3, 0.7, 2.9), strict=True)}
TYPES: dict[str, tuple[int, Any]] = {
    "float": (8, lambda value: struct.pack("<f", value)),
    "half": (7, lambda value: np.float16(value).tobytes() + bytes(2)),
    "int": (3, lambda value: struct.pack("<i", round(value + 1))),
    "int64": (5, lambda value: struct.pack("<i", round(value + 1))),
    "token": (11, lambda value: struct.pack("<I", 1)),  # a name in the file: no number
}


def write_stage(path: Path, key: str, kind: str) -> None:
    """Write a mesh that rises, with one metadatum whose type in the binary file is replaced by another."""
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr([4, 3])
    mesh.CreateFaceVertexIndicesAttr(INDICES)
    for code in range(3):
        mesh.CreatePointsAttr().Set(raised(code), code)
    stage.SetDefaultPrim(mesh.GetPrim())
    stage.GetRootLayer().pseudoRoot.SetInfo(key, VALUES[key])
    stage.Save()
    content, number = path.read_bytes(), struct.pack("<f", VALUES[key])
    stored, (code_of_type, pack) = number + bytes([0, 0, 9, 0x40]), TYPES[kind]  # inlined double
    assert content.count(stored) == 1
    path.write_bytes(content.replace(stored, pack(VALUES[key]) + bytes([0, 0, code_of_type, 0x40])))


@pytest.mark.parametrize("key", VALUES)
@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("referred", [False, True])
def test_stage_metadata_of_any_type(tmp_path: Path, key: str, kind: str, referred: bool, recwarn: Any) -> None:
    path = tmp_path / "stage.usdc"
    write_stage(path, key, kind)
    if referred:  # its units do not count in the stage that refers to it, its rate does
        path = tmp_path / "shot.usda"
        path.write_text('#usda 1.0\ndef "shot" (references = @./stage.usdc@) {}')
    got = read(path)
    np.testing.assert_array_equal(got.points, [raised(code) for code in range(3)])
    told = [str(warning.message) for warning in recwarn]
    if kind == "token":
        assert [key in each for each in told] == [True] * (not referred or key.endswith("PerSecond"))
    else:
        value: Any = {"float": np.float32, "half": np.float16}.get(kind, lambda value: round(value + 1))(VALUES[key])
        assert not told
        assert got.metres_per_unit == (value if key == "metersPerUnit" and not referred else 0.01)
        rate = (
            float(value) if key in ("timeCodesPerSecond", "framesPerSecond") else 24.0
        )  # the second stands for the first
        np.testing.assert_allclose(got.times, np.arange(3) / rate, rtol=1e-12)


PLAIN_MESH = """
def Mesh "mesh" {
    point3f[] points = [(0,0,0), (1,0,0), (0,1,0)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
}"""


@pytest.mark.parametrize(
    ("metadata", "told"),
    [
        ("upAxis = 'W'", "upAxis is 'W'"),
        ("metersPerUnit = 0", r"metersPerUnit is 0\.0.* 0\.01 is taken"),
        ("timeCodesPerSecond = -1", r"timeCodesPerSecond is -1\.0.* 24 is taken"),
        ("endTimeCode = nan", "endTimeCode is nan"),
    ],
)
def test_stage_metadata_that_cannot_be(tmp_path: Path, metadata: str, told: str) -> None:
    path = tmp_path / "stage.usda"
    path.write_text(f"#usda 1.0\n({metadata})\n{PLAIN_MESH}")
    with pytest.warns(MixseqWarning, match=told):
        got = read(path)
    assert (got.up_axis, got.metres_per_unit, got.fps) == ("Y", 0.01, 24)
    path.write_text(f"#usda 1.0\n(upAxis = 'z')\n{PLAIN_MESH}")
    assert read(path).up_axis == "Z"


def refer(stage: Usd.Stage, kind: str, asset: str) -> None:
    prim = stage.DefinePrim(f"/{kind}")
    if kind == "reference":
        prim.GetReferences().AddReference(asset)
    elif kind == "payload":
        prim.GetPayloads().AddPayload(asset, "/there")
    elif kind == "sublayer":
        stage.GetRootLayer().subLayerPaths.append(asset)
    elif kind == "clip":
        Usd.ClipsAPI(prim).SetClipAssetPaths([Sdf.AssetPath(asset)])
    else:  # in a file that exists, or a prim that does not
        Usd.Stage.CreateNew(str(Path(stage.GetRootLayer().realPath).with_name("between.usda"))).Save()
        between = Usd.Stage.Open(str(Path(stage.GetRootLayer().realPath).with_name("between.usda")))
        between.DefinePrim("/there").GetReferences().AddReference(asset)
        between.Save()
        prim.GetReferences().AddReference("./between.usda", "/there" if kind == "nested" else "/gone")


@pytest.mark.parametrize("kind", ["reference", "payload", "sublayer", "clip", "nested", "prim"])
@pytest.mark.parametrize("has_mesh", [False, True])
def test_missing_files_are_named(tmp_path: Path, kind: str, has_mesh: bool) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    refer(stage, kind, "./props/lamp.usdc")
    if has_mesh:
        mesh = UsdGeom.Mesh.Define(stage, "/mesh")
        mesh.CreatePointsAttr(raised(0))
        mesh.CreateFaceVertexCountsAttr([4, 3])
        mesh.CreateFaceVertexIndicesAttr(INDICES)
    stage.Save()
    named = r"do not exist: /gone in between\.usda" if kind == "prim" else r"missing .*: (\./)?props/lamp\.usdc"
    if has_mesh:
        with pytest.warns(MixseqWarning, match=named) as caught:
            read(tmp_path / "shot.usda")
        assert len(caught) == 1
    else:
        with pytest.raises(NoMeshError, match=named):
            read(tmp_path / "shot.usda")


@pytest.mark.filterwarnings("ignore:.*USD finds 1 problems")
@pytest.mark.parametrize("clips", ["int default = 3", "dictionary default = { int[] assetPaths = [1, 2] }"])
def test_value_clips_that_are_none_name_no_files(tmp_path: Path, clips: str) -> None:
    path = tmp_path / "stage.usda"
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr([4, 3])
    mesh.CreateFaceVertexIndicesAttr(INDICES)
    mesh.CreatePointsAttr().Set(raised(0))
    stage.Save()
    path.write_text(path.read_text().replace('def Mesh "mesh"', f'def Mesh "mesh" (clips = {{ {clips} }})'))
    clips_folder(path).mkdir()
    np.testing.assert_array_equal(read(path).points, [raised(0)])
    assert find_clips(path) == []


@pytest.mark.parametrize(
    ("codes_per_second", "frames_per_second", "codes", "fps", "numbers"),
    [
        (1000, 25, (0, 40, 80), 25, [0, 1, 2]),
        (4800, 24, (0, 200, 300), 24, [0, 1, 1.5]),
        (1, 30, (0, 0.0333333, 0.0666667), 30, [0, 1, 2]),
        (24, 24, (1001, 1002, 1003), 24, [1001, 1002, 1003]),
        (30, 24, (0, 1, 2), 30, [0, 1, 2]),  # frames of the time codes only
        (6000, None, (0, 240, 480), 25, [0, 1, 2]),
        (float(np.float32(24000 / 1001)), None, (0, 1, 2), 24000 / 1001, [0, 1, 2]),
    ],
)
def test_frame_rate(
    tmp_path: Path, codes_per_second: float, frames_per_second: float | None, codes: Any, fps: float, numbers: Any
) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "stage.usda"))
    stage.SetTimeCodesPerSecond(codes_per_second)
    if frames_per_second:
        stage.SetFramesPerSecond(frames_per_second)
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr([4, 3])
    mesh.CreateFaceVertexIndicesAttr(INDICES)
    for code in codes:
        mesh.CreatePointsAttr().Set(raised(code), code)
    stage.Save()
    got = read(tmp_path / "stage.usda")
    assert got.fps == fps
    np.testing.assert_allclose(got.times * fps, numbers, atol=2e-6)
    np.testing.assert_array_equal(got.points, [raised(code) for code in codes])


GOOD = """
def Mesh "good" {
    point3f[] points.timeSamples = {0: [(0,0,0), (1,0,0), (0,1,0)], 1: [(0,0,1), (1,0,1), (0,1,1)]}
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
}"""
BAD = {
    "points that are added": (
        "point3f[] points.timeSamples = {0: [(0,0,0), (1,0,0), (0,1,0)], 1: [(0,0,0), (1,0,0), (0,1,0), (1,1,0)]}",
        r"frame 1 \(time code 1\): /bad has 4 points, the first frame 3",
    ),
    "points that vanish": (
        "point3f[] points.timeSamples = {0: [(0,0,0), (1,0,0), (0,1,0)], 1: []}",
        r"frame 1 \(time code 1\): /bad has 0 points",
    ),
    "blocked points": (
        "point3f[] points.timeSamples = {0: [(0,0,0), (1,0,0), (0,1,0)], 1: None}",
        r"frame 1 \(time code 1\): /bad has no points",
    ),
    "a transform that mirrors": (
        "point3f[] points = [(0,0,0), (1,0,0), (0,1,0)]\nuniform token[] xformOpOrder = ['xformOp:scale']\n"
        "double3 xformOp:scale.timeSamples = {0: (1,1,1), 1: (-1,1,1)}",
        r"frame 1 \(time code 1\): the transform of /bad mirrors it",
    ),
}


@pytest.mark.parametrize(("points", "problem"), BAD.values(), ids=BAD)
def test_meshes_whose_later_frames_cannot_be_read_are_left_out(tmp_path: Path, points: str, problem: str) -> None:
    """If there is no other mesh, the file is refused; the frame is named."""
    bad = f"""
def Mesh "bad" {{
    {points}
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
}}"""
    path = tmp_path / "two.usda"
    path.write_text(f"#usda 1.0\n{bad}{GOOD}")
    with pytest.warns(MixseqWarning, match=f"cannot be read are left out: {problem}"):
        got = read(path)
    assert [each.name for each in got.objects] == ["good"]
    assert got.points[:, 0].tolist() == [[0, 0, 0], [0, 0, 1]]
    path.write_text(f"#usda 1.0\n{bad}")
    with pytest.raises(InvalidSequenceError, match=problem):
        read(path)


def test_a_vertex_that_is_not_finite_is_named_with_its_mesh(tmp_path: Path) -> None:
    path = tmp_path / "two.usda"
    path.write_text(f"#usda 1.0\n{GOOD}{GOOD.replace('good', 'bad').replace('(0,1,1)', '(0,nan,1)')}")
    with pytest.raises(InvalidSequenceError, match=r"frame 1: vertex 5 \(vertex 2 of /bad\) is \[0.0, nan, 1.0\]"):
        read(path)
