"""What PC2 and MDD have in common: the mesh beside the cache, read and written, and sizes that do not fit."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io import open_sequence, read, write, write_blocks

Files = Callable[[], dict[str, bytes]]

KINDS = pytest.mark.parametrize("kind", ["pc2", "mdd"])
POLYGONS = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 3, 2, 4]))


def wave(frames: int = 3) -> FloatArray:
    return np.random.default_rng(4).normal(size=(frames, 5, 3)).astype(np.float32)


def sequence(frames: int = 3) -> MeshSequence:
    return MeshSequence.from_arrays(wave(frames), POLYGONS, name="fox")


def contents(kind: str, points: FloatArray) -> bytes:
    frames, count, _ = points.shape
    if kind == "pc2":
        start = struct.pack("<12siiffi", b"POINTCACHE2", 1, count, 0.0, 1.0, frames)
        return start + points.astype("<f4").tobytes()
    times = (np.arange(frames) / 24).astype(">f4")
    return struct.pack(">ii", frames, count) + times.tobytes() + points.astype(">f4").tobytes()


@KINDS
def test_what_is_written_is_read(tmp_path: Path, kind: str) -> None:
    written = sequence()
    write(tmp_path / f"fox run.{kind}", written)
    assert {file.name for file in tmp_path.iterdir()} == {"fox run.obj", f"fox run.{kind}"}
    assert (tmp_path / f"fox run.{kind}").read_bytes() == contents(kind, written.points)
    got = read(tmp_path / f"fox run.{kind}")
    np.testing.assert_array_equal(got.points, written.points)
    np.testing.assert_allclose(got.times, written.times, rtol=0, atol=1e-8)
    assert (got.name, got.fps, got.up_axis) == ("fox", 24, "Y")
    assert got.polygons.same_as(POLYGONS)
    np.testing.assert_array_equal(read(tmp_path / "fox run.obj").points, written.points[:1])


@KINDS
def test_what_is_on_the_mesh_goes_with_it(tmp_path: Path, kind: str) -> None:
    surface = Surface(
        uvs=CornerValues(np.random.default_rng(6).normal(size=(7, 2)), np.arange(7)),
        face_sets=(FaceSet("red", np.array([1]), "red"),),
    )
    write(tmp_path / f"a.{kind}", replace(sequence(), surface=surface))
    got = read(tmp_path / f"a.{kind}").surface
    assert got.uvs is not None and surface.uvs is not None
    np.testing.assert_array_equal(got.uvs.at_corners, surface.uvs.at_corners)
    assert [(each.name, each.polygons.tolist()) for each in got.face_sets] == [("red", [1])]


@KINDS
@pytest.mark.parametrize("mesh", ["obj", "ply", "npz", "h5", "usdc"])
def test_meshes_beside_it(tmp_path: Path, kind: str, mesh: str) -> None:
    write(tmp_path / f"run.{mesh}", sequence(1))
    points = wave(4)
    (tmp_path / f"run.{kind}").write_bytes(contents(kind, points))
    got = read(tmp_path / f"run.{kind}")
    np.testing.assert_array_equal(got.points, points)
    assert got.polygons.same_as(POLYGONS)


@KINDS
def test_a_mesh_by_name(tmp_path: Path, kind: str) -> None:
    rest = MeshSequence.from_arrays(wave(2), POLYGONS, up_axis="Z", metres_per_unit=0.01)
    write(tmp_path / "rest.npz", rest)
    (tmp_path / f"run.{kind}").write_bytes(contents(kind, wave(4)))
    got = read(tmp_path / f"run.{kind}", mesh=tmp_path / "rest.npz")
    assert (got.frame_count, got.up_axis, got.metres_per_unit) == (4, "Z", 0.01)


@KINDS
def test_no_mesh(tmp_path: Path, kind: str) -> None:
    (tmp_path / f"run.{kind}").write_bytes(contents(kind, wave()))
    write(tmp_path / "runs.obj", sequence(1))
    (tmp_path / "run.mtl").touch()
    with pytest.raises(
        FormatError, match=rf"run\.{kind}: .* no mesh beside it: none of run\.obj, \.ply.*; name .*--mesh"
    ):
        read(tmp_path / f"run.{kind}")
    with pytest.raises(FormatError, match=r"gone\.obj does not exist"):
        read(tmp_path / f"run.{kind}", mesh=tmp_path / "gone.obj")


@KINDS
def test_a_mesh_with_other_vertices(tmp_path: Path, kind: str) -> None:
    (tmp_path / f"run.{kind}").write_bytes(contents(kind, wave()[:, :4]))
    write(tmp_path / "run.obj", sequence(1))
    with pytest.raises(FormatError, match=rf"run\.{kind} has 4 points, but its mesh .*run\.obj has 5 vertices"):
        read(tmp_path / f"run.{kind}")


@KINDS
def test_through_a_link(tmp_path: Path, kind: str) -> None:
    (tmp_path / "store").mkdir()
    write(tmp_path / "store" / f"run.{kind}", sequence())
    (tmp_path / f"link.{kind}").symlink_to(tmp_path / "store" / f"run.{kind}")
    moved = sequence().with_points(wave() + 1)
    write(tmp_path / f"link.{kind}", moved)
    for path in (tmp_path / f"link.{kind}", tmp_path / "store" / f"run.{kind}"):
        np.testing.assert_array_equal(read(path).points, moved.points)


@KINDS
def test_another_mesh_of_that_name_is_not_replaced(tmp_path: Path, kind: str, files: Files) -> None:
    write(tmp_path / "run.obj", MeshSequence.from_arrays(wave(1), [[0, 1, 2]]))
    before = files()
    with pytest.raises(OutputError, match=rf"run\.obj has the name of the mesh of run\.{kind}, but is another"):
        write(tmp_path / f"run.{kind}", sequence())
    (tmp_path / "run.obj").write_text("notes")
    with pytest.raises(OutputError, match="is another mesh; remove it, or choose another name"):
        write(tmp_path / f"run.{kind}", sequence())
    assert files().keys() == before.keys()
    write(tmp_path / "walk.obj", sequence(1))
    write(tmp_path / f"walk.{kind}", sequence().with_points(wave() + 1))
    np.testing.assert_array_equal(read(tmp_path / "walk.obj").points, wave()[:1] + 1)


@KINDS
def test_both_files_or_none(tmp_path: Path, kind: str, files: Files) -> None:
    with pytest.raises(InvalidSequenceError, match="2 frames of points for 3 times"):
        write_blocks(tmp_path / f"run.{kind}", sequence().header, [wave()[:2]])
    assert files() == {}
    (tmp_path / "walk.obj").mkdir()
    with pytest.raises(OutputError, match=r"walk\.obj is a folder"):
        write(tmp_path / f"walk.{kind}", sequence())
    assert files() == {}


@KINDS
def test_too_large_for_single_precision(tmp_path: Path, kind: str, files: Files) -> None:
    points = wave().astype(np.float64)
    points[1, 2, 0] = 1e300
    with pytest.raises(InvalidSequenceError, match=f"frame 1: vertex 2 is .*, too large for {kind.upper()}"):
        write(tmp_path / f"run.{kind}", MeshSequence.from_arrays(points, POLYGONS))
    assert files() == {}


@KINDS
def test_what_caches_cannot_hold(tmp_path: Path, kind: str) -> None:
    objects = (MeshObject("a", "", 5, 2),)
    rich = MeshSequence.from_arrays(wave(), POLYGONS, up_axis="Z", metres_per_unit=0.01)
    rich = replace(rich, velocities=wave(), surface=Surface(objects=objects, subdivision="loop"))
    lost = "Z up, 0.01 metres per unit, velocities, loop subdivision"
    with pytest.warns(MixseqWarning, match=f"{kind.upper()} files cannot hold {lost}; "):
        write(tmp_path / f"run.{kind}", rich)


@KINDS
def test_sizes_that_do_not_fit(tmp_path: Path, kind: str) -> None:
    write(tmp_path / "run.obj", sequence(1))
    file = tmp_path / f"run.{kind}"
    whole = contents(kind, wave())
    for content in (*(whole[:end] for end in range(0, len(whole), 5)), whole[:-1], whole + b"\0"):
        file.write_bytes(content)
        with pytest.raises(FormatError, match=f"run.{kind} cannot be read as an? {kind.upper()} file"):
            read(file)


@KINDS
@pytest.mark.parametrize(("frames", "points"), [(0, 5), (-1, 5), (3, 0), (3, -5), (2**31 - 1, 2**31 - 1), (-3, -5)])
def test_absurd_counts(tmp_path: Path, kind: str, frames: int, points: int) -> None:
    write(tmp_path / "run.obj", sequence(1))
    content = bytearray(contents(kind, wave()))
    if kind == "pc2":
        struct.pack_into("<i", content, 16, points)
        struct.pack_into("<i", content, 28, frames)
    else:
        struct.pack_into(">ii", content, 0, frames, points)
    (tmp_path / f"run.{kind}").write_bytes(content)
    with pytest.raises(FormatError, match=rf"{frames} frames of {points} points"):
        read(tmp_path / f"run.{kind}")


@KINDS
def test_points_that_are_not_finite(tmp_path: Path, kind: str) -> None:
    write(tmp_path / "run.obj", sequence(1))
    points = wave()
    points[2, 4, 1] = np.nan
    (tmp_path / f"run.{kind}").write_bytes(contents(kind, points))
    with pytest.raises(InvalidSequenceError, match=rf"run\.{kind}: frame 2: vertex 4 is"):
        read(tmp_path / f"run.{kind}")


@KINDS
def test_a_file_that_shrinks_while_it_is_read(tmp_path: Path, kind: str) -> None:
    write(tmp_path / f"run.{kind}", sequence(400))
    with open_sequence(tmp_path / f"run.{kind}") as reader:
        (tmp_path / f"run.{kind}").write_bytes(b"short")
        with pytest.raises(FormatError, match="cannot be read as a point cache"):
            list(reader.blocks())


# MDD files: times in single precision, and the frame rate that they tell


def moving(times: np.ndarray, fps: float = 24) -> MeshSequence:
    points = np.eye(3, dtype=np.float32) + np.arange(len(times), dtype=np.float32)[:, None, None]
    return MeshSequence.from_arrays(points, [[0, 1, 2]], times=times, fps=fps)


@pytest.mark.parametrize("fps", [12, 23.976, 24, 24000 / 1001, 25, 29.97, 30, 59.94, 120, 14.7])
@pytest.mark.parametrize("start", [0, 40])
def test_times_and_rate(tmp_path: Path, fps: float, start: float) -> None:
    written = moving(start + np.arange(50) / fps, fps)
    write(tmp_path / "a.mdd", written)
    got = read(tmp_path / "a.mdd")
    np.testing.assert_allclose(got.times, written.times, rtol=4e-7, atol=6e-7)
    assert got.fps == pytest.approx(fps, rel=2e-4)
    if fps == int(fps):
        assert got.fps == fps
        np.testing.assert_array_equal(got.times, np.rint(written.times * fps) / fps)


def test_uneven_times_are_kept_in_single_precision_and_others_exactly(tmp_path: Path) -> None:
    times = np.array([-1.0, 0.1, 0.1 + 1 / 24, 0.1 + 2 / 24, 7 / 3])
    write(tmp_path / "a.mdd", moving(times))
    got = read(tmp_path / "a.mdd")
    assert got.fps == 24
    assert got.times.tolist() == [*times[:-1].astype(np.float32), 56 / 24]


def test_rates_that_times_do_not_tell(tmp_path: Path) -> None:
    with pytest.warns(MixseqWarning, match="MDD files cannot hold 24 frames per second"):
        write(tmp_path / "a.mdd", moving(np.arange(4) / 12))
    assert read(tmp_path / "a.mdd").fps == 12


def test_one_frame(tmp_path: Path) -> None:
    write(tmp_path / "a.mdd", moving(np.array([0.5])))
    got = read(tmp_path / "a.mdd")
    assert (got.times.tolist(), got.fps) == ([0.5], 24)


@pytest.mark.parametrize("last", [0.0, -1.0, float("inf"), float("nan")])
def test_a_last_time_that_is_not_after_the_first(tmp_path: Path, last: float) -> None:
    """Between them times increase, so that there is a rate to be looked for."""
    write(tmp_path / "a.mdd", moving(np.arange(5) / 24))
    content = bytearray((tmp_path / "a.mdd").read_bytes())
    content[8 + 4 * 4 : 8 + 5 * 4] = struct.pack(">f", last)
    (tmp_path / "a.mdd").write_bytes(content)
    with pytest.raises(InvalidSequenceError, match=r"a.mdd: frame 4(: its time is not finite| is at .* s, not after)"):
        read(tmp_path / "a.mdd")


def test_times_too_close_for_single_precision(tmp_path: Path) -> None:
    with pytest.raises(InvalidSequenceError, match=r"frames 1 and 2 are both at 1000 s in float32, which MDD stores"):
        write(tmp_path / "a.mdd", moving(np.array([999.0, 1000.0, 1000.00001])))


@pytest.mark.parametrize("last", [0.0, -1.0, float("nan"), float("inf")])
def test_times_that_do_not_increase(tmp_path: Path, last: float) -> None:
    write(tmp_path / "a.mdd", moving(np.arange(2) / 24))
    content = bytearray((tmp_path / "a.mdd").read_bytes())
    struct.pack_into(">f", content, 12, last)
    (tmp_path / "a.mdd").write_bytes(content)
    with pytest.raises(InvalidSequenceError, match=r"a\.mdd: frame 1.* time"):
        read(tmp_path / "a.mdd")


# PC2 files: the header and the times that follow from it

POINTS = np.eye(3, dtype=np.float32)[None] + np.arange(4, dtype=np.float32)[:, None, None]


def save(folder: Path, start: float = 0, rate: float = 1, version: int = 1, magic: bytes = b"POINTCACHE2\0") -> Path:
    write(folder / "a.obj", MeshSequence.from_arrays(POINTS[:1], [[0, 1, 2]]))
    header = struct.pack("<12siiffi", magic, version, 3, start, rate, 4)
    (folder / "a.pc2").write_bytes(header + POINTS.tobytes())
    return folder / "a.pc2"


def test_times_are_frames_over_the_rate(tmp_path: Path) -> None:
    path = save(tmp_path, start=10, rate=0.5)
    for fps in (24.0, 30.0):
        got = read(path, fps=fps)
        np.testing.assert_allclose(got.times, np.array([10, 10.5, 11, 11.5]) / fps, rtol=1e-15)
        assert got.fps == fps
    np.testing.assert_array_equal(read(path).points, POINTS)
    with pytest.raises(SettingsError, match="fps is 0"):
        read(path, fps=0)


@pytest.mark.parametrize(("start", "rate"), [(0, 0), (0, -1), (float("nan"), 1), (0, float("inf"))])
def test_times_of_pc2_that_do_not_increase(tmp_path: Path, start: float, rate: float) -> None:
    with pytest.raises(InvalidSequenceError, match=r"a\.pc2: frame \d.* time"):
        read(save(tmp_path, start, rate))


def test_other_versions_and_files(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"a\.pc2 cannot be read as a PC2 file.*its version is 2, not 1"):
        read(save(tmp_path, version=2))
    with pytest.raises(FormatError, match="does not begin with POINTCACHE2"):
        read(save(tmp_path, magic=b"POINTCACHE1\0"))


@pytest.mark.parametrize("times", [[0.0, 0.5, 1.0, 1.5], [-1.0, 0.0, 1.0, 2.0], [100.0, 101.0, 102.0, 103.0]])
def test_even_times_are_kept(tmp_path: Path, times: list[float]) -> None:
    write(tmp_path / "a.pc2", MeshSequence.from_arrays(POINTS, [[0, 1, 2]], times=times))
    np.testing.assert_allclose(read(tmp_path / "a.pc2").times, times, rtol=1e-12)


def test_one_frame_of_pc2(tmp_path: Path) -> None:
    write(tmp_path / "a.pc2", MeshSequence.from_arrays(POINTS[:1], [[0, 1, 2]], times=[2.5], fps=30))
    assert read(tmp_path / "a.pc2", fps=30).times.tolist() == [2.5]


def test_uneven_times_and_other_rates_are_lost(tmp_path: Path) -> None:
    uneven = MeshSequence.from_arrays(POINTS, [[0, 1, 2]], times=[0, 1, 2, 4])
    with pytest.warns(MixseqWarning, match="PC2 files cannot hold uneven times"):
        write(tmp_path / "a.pc2", uneven)
    np.testing.assert_allclose(read(tmp_path / "a.pc2").times, [0, 4 / 3, 8 / 3, 4], rtol=1e-6)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write(tmp_path / "b.pc2", MeshSequence.from_arrays(POINTS, [[0, 1, 2]], fps=29.97))
    (warning,) = caught
    assert "29.97 frames per second (read it with fps=29.97)" in str(warning.message)
    assert warning.filename == __file__
    np.testing.assert_allclose(read(tmp_path / "b.pc2", fps=29.97).times, np.arange(4) * 1001 / 30000, rtol=1e-7)
