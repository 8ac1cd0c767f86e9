"""``mixseq resample``, and velocities on the command line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom

import mixseq
from mixseq.operations import resample
from mixseq.runtime.parallel import serial_executor
from mixseq.sequence.sequence import MeshSequence
from tests.cli.conftest import Contents, Run, succeed
from tests.formats.gltf_maker import JOINTS, skinned
from tests.motions import MESH, moving


@pytest.mark.parametrize(
    ("options", "times", "sources"),
    [
        ("", np.arange(4) / 10, np.arange(4) / 10),
        ("--fps 20", np.arange(7) / 20, np.arange(7) / 20),
        ("--speed 0.5", np.arange(7) / 10, np.arange(7) / 20),
        ("--reverse", np.arange(4) / 10, 0.3 - np.arange(4) / 10),
        ("--start 0.1 --end 0.2 --fps 40", 0.1 + np.arange(5) / 40, 0.1 + np.arange(5) / 40),
        ("--retime ramp.csv", np.arange(3) / 10, [0, 0.05, 0.3]),
        ("--retime ramp.csv --linear --fps 20", np.arange(5) / 20, [0, 0.025, 0.05, 0.175, 0.3]),
        ("--retime ramp.toml", [1, 1.1], [0.3, 0]),
    ],
)
def test_times(run: Run, folder: Path, options: str, times: np.ndarray, sources: np.ndarray) -> None:
    (folder / "ramp.csv").write_text("output,source\n0,0\n0.1,0.05\n0.2,0.3\n")
    (folder / "ramp.toml").write_text("output = [1, 1.1]\nsource = [0.3, 0]")
    text = succeed(run("resample", "model.h5", "new.npz", *options.split()))
    assert f"frames   {len(times)} (" in text
    assert text.splitlines()[-1].startswith("wrote new.npz (")
    new, model = mixseq.read("new.npz"), mixseq.load("model.h5")
    assert new.times == pytest.approx(np.asarray(times), abs=1e-12)
    np.testing.assert_allclose(new.points, [model(time) for time in sources], atol=1e-9)
    assert new.velocities is None


@pytest.mark.parametrize("name", ["bar.npz", "bar.usdc", "bar_sequence.h5"])
def test_sequences_are_fitted_exactly(run: Run, name: str, bent_bar: MeshSequence) -> None:
    succeed(run("resample", name, "new.npz"))
    new = mixseq.read("new.npz")
    assert mixseq.compare(mixseq.read(name), new).max_error < 1e-10
    succeed(run("resample", name, "new.npz", "--exact", "--reverse"))
    np.testing.assert_allclose(mixseq.read("new.npz").points, new.points[::-1], atol=1e-9)


def test_sequences_stream_and_are_fitted_by_those_who_work(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    fit, given = mixseq.fit, []

    def noting(frames: Any, *, workers: Any, **settings: Any) -> Any:
        given.append((frames, workers))
        return fit(frames, workers=workers, **settings)

    monkeypatch.setattr(mixseq, "fit", noting)
    succeed(run("resample", "bar.npz", "new.npz", "--threads", "1"))
    ((frames, workers),) = given
    assert not isinstance(frames, MeshSequence)
    assert workers is serial_executor


@pytest.fixture
def arm(run: Run) -> Any:
    """A triangle on a joint that turns by a quarter in a second, keyed only then and at the start."""
    return skinned([[1, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 1, 0, 0]], JOINTS).glb(Path("arm.glb"))


def test_rigs_are_evaluated(run: Run, arm: Any) -> None:
    table = succeed(run("resample", "arm.glb", "new.npz", "--fps", "50", "--velocities", "--speed", "0.5"))
    assert "rig      evaluated at these times; --exact fits its frames instead" in table.splitlines()
    new = mixseq.read("new.npz")
    assert (new.frame_count, new.fps) == (101, 50)
    angle = np.pi / 2 * np.arange(101) / 100
    turned = np.stack([1 + np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_allclose(new.points[:, 0, :2], turned, atol=2e-7)
    assert new.velocities is not None
    speed = np.pi / 4 * np.stack([-np.sin(angle), np.cos(angle)], axis=1)[1:-1]
    np.testing.assert_allclose(new.velocities[1:-1, 0, :2], speed, atol=1e-5)
    same = resample(arm, fps=50, speed=0.5, velocities=True)
    np.testing.assert_array_equal(same.points, new.points)
    np.testing.assert_array_equal(same.velocities, new.velocities)
    with mixseq.open_sequence(arm) as reader:
        np.testing.assert_array_equal(resample(reader, fps=50, speed=0.5).points, new.points)


@pytest.mark.parametrize("options", [("--exact",), ("--tolerance", "1e-9")])
def test_rigs_are_baked_by_choice(run: Run, arm: Any, options: tuple[str, ...]) -> None:
    assert "rig " not in succeed(run("resample", "arm.glb", "new.npz", "--fps", "50", *options))
    baked, evaluated = mixseq.read("new.npz").points, resample(arm, fps=50).points
    assert 1e-7 < np.abs(baked - evaluated).max() < 1e-2
    frames = resample(mixseq.read(arm), fps=50).points  # points of frames, too
    np.testing.assert_allclose(baked, frames, atol=1e-8)


def test_rigs_in_a_worker_are_evaluated(run: Run) -> None:
    stage = Usd.Stage.CreateNew("spin.usdc")
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    turn = mesh.AddRotateZOp()
    turn.Set(0.0, 0)
    turn.Set(90.0, 6)
    stage.Save()
    succeed(run("resample", "spin.usdc", "new.usdc", "--fps", "96", "--flatten"))
    new = mixseq.read("new.usdc")
    angle = np.pi / 2 * np.arange(25) / 24
    np.testing.assert_allclose(new.points[:, 1, :2], np.stack([np.cos(angle), np.sin(angle)], 1), atol=1e-6)


def test_numbered_files(run: Run, folder: Path, bent_bar: MeshSequence) -> None:
    (folder / "obj").mkdir()
    assert run("convert", "bar.npz", "obj/bar_####.obj").exit_code == 0
    succeed(run("resample", "obj", "new.npz", "--input-fps", "10", "--fps", "20"))
    new = mixseq.read("new.npz")
    assert (new.fps, new.frame_count) == (20, 7)
    np.testing.assert_allclose(new.points[::2], bent_bar.points, atol=1e-9)


def test_a_tolerance(run: Run, bent_bar: MeshSequence) -> None:
    succeed(run("resample", "bar.npz", "new.npz", "--tolerance", "0.01"))
    assert 1e-6 < mixseq.compare(bent_bar, mixseq.read("new.npz")).max_error <= 0.01


def test_the_table_tells_of_the_end(run: Run) -> None:
    table = succeed(run("resample", "model.h5", "new.npz", "--fps", "8"))
    assert table.splitlines()[:5] == [
        "frames     3 (0 to 2)",
        "time       0 to 0.25 s at 8 frames per second",
        "history    an edit of what is 1e-8 from bar",
        "source     0 to 0.25 s (frames 0 to 2.5)",
        "left over  0.05 s after the last frame; the next one would be after the end",
    ]
    table = succeed(run("resample", "model.h5", "new.npz", "--start", "0.05", "--reverse"))
    assert table.splitlines()[:5] == [
        "frames     3 (0.5 to 2.5)",
        "time       0.05 to 0.25 s at 10 frames per second",
        "history    an edit of what is 1e-8 from bar",
        "source     0.3 to 0.1 s (frames 3 to 1)",
        "left over  0.05 s after the last frame; the next one would be after the end",
    ]
    table = succeed(run("resample", "model.h5", "new.npz", "--fps", "9.9"))
    assert "end      the last frame is 0.003 s after it, and shows the pose there" in table
    assert "left over" not in succeed(run("resample", "model.h5", "new.npz", "--fps", "30"))


def test_rates_are_fractions(run: Run) -> None:
    for arguments in (("--fps", "24000/1001"), ("--conform", "24000/1001")):
        assert "at 24000/1001 (23.976) frames per second" in succeed(run("resample", "bar.npz", "new.npz", *arguments))
        assert mixseq.read("new.npz").fps == 24000 / 1001
    for text in ("24/0", "a/b", "1/2/3", "-24/1", "0"):
        result = run("resample", "bar.npz", "other.npz", "--fps", text)
        assert result.exit_code == 2
        assert re.search("is not a frame rate such as 25, 23.976 or 24000/1001|is not in the range", result.stderr)


def test_frames_are_conformed(run: Run) -> None:
    table = succeed(run("resample", "bar.npz", "new.npz", "--conform", "25"))
    assert "source   the same frames at 10" in table
    np.testing.assert_array_equal(mixseq.read("new.npz").points, mixseq.read("bar.npz").points)
    assert mixseq.read("new.npz").times == pytest.approx(np.arange(4) / 25)
    succeed(run("resample", "model.h5", "new.npz", "--conform", "25", "-q"))
    np.testing.assert_array_equal(mixseq.read("new.npz").points, mixseq.load("model.h5").sample().points)
    for option in ("--reverse", "--hold", "--start=0.1", "--between=linear"):
        refused = run("resample", "bar.npz", "other.npz", "--conform", "25", option)
        assert refused.exit_code == 2
        assert f"{option.partition('=')[0]} changes or fits frames" in refused.stderr


def test_shutters_and_held_ends(run: Run) -> None:
    options = ("--shutter", "180", "--hold", "--end", "0.4")
    succeed(run("resample", "model.h5", "new.npz", *options))
    numbers = np.array([-0.25, 0, 0.25, 0.75, 1, 1.25, 1.75, 2, 2.25, 2.75, 3, 3.25, 3.75, 4, 4.25])
    new, model = mixseq.read("new.npz"), mixseq.load("model.h5")
    assert new.times * 10 == pytest.approx(numbers)
    np.testing.assert_allclose(new.points, [model(time) for time in np.clip(numbers / 10, 0, 0.3)], atol=1e-12)
    assert "'180,a' is no angle" in run("resample", "model.h5", "other.npz", "--shutter", "180,a").stderr


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "0,0\n1,0.5\n", "a.csv, line 2: source time 0.5 s, but the last is 0.3 s; change it, or hold"),
        ("b.csv", 'unit="frames"\n# x\n0,0\n9,50', "b.csv, line 4: source frame 50, but the last is 3; change it"),
        ("c.toml", "output=[0,1]\nsource=[-0.2,0]", "c.toml, key 1: source time -0.2 s, but the first is 0 s; ch"),
    ],
)
def test_places_of_retimes_beyond_the_source(run: Run, name: str, text: str, message: str) -> None:
    Path(name).write_text(text)
    refused = run("resample", "model.h5", "other.npz", "--retime", name)
    assert (refused.exit_code, message in refused.stderr) == (2, True), refused.stderr
    succeed(run("resample", "model.h5", "new.npz", "--retime", name, "--hold"))


def test_frames_are_a_section(run: Run) -> None:
    succeed(run("resample", "model.h5", "by_frames.npz", "--frames", "1:2", "--speed", "0.5"))
    succeed(run("resample", "model.h5", "by_seconds.npz", "--start", "0.1", "--end", "0.2", "--speed", "0.5"))
    assert Path("by_frames.npz").read_bytes() == Path("by_seconds.npz").read_bytes()


def test_retiming_in_frames_of_the_output_and_of_the_source(run: Run) -> None:
    Path("frames.csv").write_text('unit = "frames"\n0,0\n8,2\n')
    table = succeed(run("resample", "model.h5", "new.npz", "--retime", "frames.csv", "--fps", "20"))
    assert table.splitlines()[:4] == [
        "frames   9 (0 to 8)",
        "time     0 to 0.4 s at 20 frames per second",
        "history  an edit of what is 1e-8 from bar",
        "source   0 to 0.2 s (frames 0 to 2)",
    ]


def test_quiet(run: Run) -> None:
    assert succeed(run("resample", "model.h5", "new.npz", "--quiet")).count("\n") == 1


# Velocities -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["new.npz", "new.h5", "new.usdc"])
def test_velocities(run: Run, name: str) -> None:
    model = mixseq.load("model.h5")
    for line, sources, slope in (
        ("decode model.h5", np.arange(4) / 10, 1.0),
        ("resample model.h5 --speed 0.5 --reverse", 0.3 - np.arange(7) / 20, -0.5),
    ):
        command, source, *options = line.split()
        succeed(run(command, source, name, "--velocities", *options))
        got = mixseq.read(name)
        assert got.velocities is not None
        expected = np.stack([slope * model.velocity(time) for time in sources])
        np.testing.assert_allclose(got.velocities, expected, atol=1e-5 * np.abs(expected).max())
        np.testing.assert_allclose(got.points, [model(time) for time in sources], atol=1e-5)


def test_velocities_are_converted(run: Run) -> None:
    succeed(run("decode", "model.h5", "new.npz", "--velocities"))
    for before, after in (("new.npz", "new.h5"), ("new.h5", "new.usdc"), ("new.usdc", "newer.npz")):
        succeed(run("convert", before, after))
    velocities, expected = mixseq.read("newer.npz").velocities, mixseq.read("new.npz").velocities
    assert velocities is not None and expected is not None
    np.testing.assert_array_equal(velocities, expected.astype(np.float32))


@pytest.mark.parametrize("command", ["decode", "resample"])
def test_velocities_that_cannot_be_held(run: Run, command: str) -> None:
    result = run(command, "model.h5", "new_#.obj", "--velocities")
    assert result.exit_code == 0
    assert re.fullmatch(
        r"mixseq: warning: new_#.obj: OBJ files cannot hold 10 frames per second, velocities; .*\n", result.stderr
    )
    assert len(list(Path().glob("new_?.obj"))) == 4


# Failures -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("none.npz old.npz", "none.npz.* does not exist"),
        ("none.h5 old.npz", "none.h5 does not exist"),
        ("notes.npz old.npz", "notes.npz"),
        ("cut_model.h5 old.npz", "cut_model.h5"),
        ("cut_bar.usdc old.npz", "cut_bar.usdc"),
        ("model.h5 model.h5", "model.h5 is the source itself"),
        ("model.h5 folder.usdc", "folder.usdc is a folder"),
        ("model.h5 nowhere/new.usdc", "nowhere does not exist; make it first"),
        ("model.h5 new.fbx", "'.fbx' is not known; write one of"),
        ("bar.npz", "Missing argument 'TARGET'.*see mixseq resample --help"),
        ("model.h5 old.npz --fps 0", "--fps.*0.* is not in the range"),
        ("model.h5 old.npz --fps nan", "fps is nan"),
        ("model.h5 old.npz --speed 0", "--speed.*0.* is not in the range"),
        ("model.h5 old.npz --speed inf", "speed is inf"),
        ("model.h5 old.npz --speed 1e-300", "are 3e.* frames, more than"),
        (
            "model.h5 old.npz --start -1",
            r"time -1 s is outside the sequence, 0 to 0.3 s \(frames 0 to 3\); motions are not extrapolated$",
        ),
        ("model.h5 old.npz --end 2", r"motions are not extrapolated; frame 2 is at 0\.2 s"),
        ("model.h5 old.npz --frames 2-5", "there is no frame 5; frames are 0 to 3"),
        ("model.h5 old.npz --frames 0,2-3", "--frames is one range here"),
        ("model.h5 old.npz --frames 3-2", "'3-2' is not a range of frames"),
        ("model.h5 old.npz --frames 1-2 --start 0", "leave out --start"),
        ("model.h5 old.npz --end 1e300", "is outside the sequence, 0 to 0.3 s"),
        ("model.h5 old.npz --start nan", "time nan s is outside"),
        ("model.h5 old.npz --start 0.2 --end 0.1", "no time between the start, 0.2 s, and the end, 0.1 s"),
        ("model.h5 old.npz --retime none.csv", "none.csv does not exist"),
        ("model.h5 old.npz --retime notes.txt", "notes.txt, line 1: 'no mesh' is not a point of a retiming"),
        ("model.h5 old.npz --retime far.csv", "far.csv, line 2: source time 0.5 s, but the last is 0.3 s"),
        ("model.h5 old.npz --retime good.csv --speed 2", "a retiming sets the range.*; leave out"),
        ("model.h5 old.npz --retime good.csv --reverse", "a retiming sets the range.*; leave out"),
        ("model.h5 old.npz --linear", "--linear is about the points of --retime"),
        ("bar.npz old.npz --exact --tolerance 0.1", "leave out one of them"),
        ("bar.npz old.npz --tolerance 0", "--tolerance.*0.* is not a length above 0"),
        ("model.h5 old.npz --tolerance 0.1", "model.h5 is a model already; leave out --tolerance"),
        ("model.h5 old.npz --input-fps 10", "model.h5 is a model already; leave out the options for reading"),
        ("bar.npz old.npz --prim /bar", "npz has no option 'prim'"),
    ],
)
def test_failures(run: Run, folder: Path, contents: Contents, line: str, message: str) -> None:
    (folder / "good.csv").write_text("0,0\n0.1,0.1\n")
    (folder / "far.csv").write_text("0,0\n1,0.5\n")
    before = contents()
    result = run("resample", *line.split())
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert result.stderr.startswith("mixseq: error: ")
    assert result.stderr.count("\n") == 1
    assert re.search(message, result.stderr), result.stderr
    assert contents() == before


def test_the_rest_of_a_scene(run: Run, scene: Path) -> None:
    slow = run("resample", "scene.usda", "new.usdc", "--speed", "0.5", "--velocities")
    assert slow.exit_code == 0
    assert re.search(r"is not retimed: /camera; whole_stage=True \(--whole-stage\)", slow.stderr)
    new = mixseq.read("new.usdc")
    assert new.times == pytest.approx(np.arange(7) / 10)
    assert new.velocities is not None
    succeed(run("resample", "scene.usda", "all.usdc", "--speed", "0.5", "--whole-stage"))
    stage = Usd.Stage.Open("all.usdc")
    camera = UsdGeom.Xformable(stage.GetPrimAtPath("/camera"))
    assert camera.ComputeLocalToWorldTransform(5).ExtractTranslation()[0] == pytest.approx(2.5)
    succeed(run("resample", "scene.usda", "part.usdc", "--start", "0.1", "--end", "0.2"))
    assert Usd.Stage.Open("part.usdc").GetEndTimeCode() == 2


def test_other_formats_have_no_stage(run: Run) -> None:
    result = run("resample", "model.h5", "new.npz", "--whole-stage")
    assert result.exit_code == 2
    assert "npz has no option 'whole_stage'" in result.stderr


def test_cuts_and_twos_are_found_and_named(run: Run) -> None:
    points = moving(np.arange(16.0))
    points[9:] += 50
    times = (1001 + np.arange(16)) / 24
    mixseq.write("shot.npz", MeshSequence.from_arrays(points, MESH[1], times=times))
    mixseq.write("twos.npz", MeshSequence.from_arrays(moving(np.floor(np.arange(20) / 2) * 2), MESH[1]))
    assert "cut between 1009 and 1010" in succeed(run("resample", "shot.npz", "fast.npz", "--fps", "48"))
    fast = mixseq.read("fast.npz")
    steps = np.linalg.norm(np.diff(fast.points, axis=0), axis=2).min(axis=1)
    assert np.flatnonzero(steps > 50).tolist() == [16]  # half-way from 1009 to 1010
    assert "cut between 1003 and 1004; 1009" in succeed(run("encode", "shot.npz", "shot.h5", "--cuts", "1004,1010"))
    assert "cut between 1003 and 1004; 1009" in succeed(run("info", "shot.h5"))
    assert "motion" not in succeed(run("resample", "shot.npz", "smooth.npz", "--fps", "48", "--cuts", "none"))
    steps = np.linalg.norm(np.diff(mixseq.read("smooth.npz").points, axis=0), axis=2).min(axis=1)
    assert steps.max() < 45  # of 86.6, in two steps
    kept = succeed(run("resample", "twos.npz", "kept.npz"))
    assert "on twos: --between smooth makes ones" in kept
    succeed(run("resample", "twos.npz", "ones.npz", "--between", "smooth"))
    ones = mixseq.read("ones.npz").points[4:14]
    np.testing.assert_allclose(ones, moving(np.arange(4.0, 14)), atol=0.01)


def test_vertices_alone_between_the_frames_of_a_model(run: Run) -> None:
    model = mixseq.load("model.h5")
    expected = resample(model, fps=48, between="vertices").points
    assert np.abs(model.sample(fps=48).points - expected).max() > 1e-3
    for command in ("resample", "decode"):
        succeed(run(command, "model.h5", "new.npz", "--fps", "48", "--between", "vertices", "--overwrite"))
        np.testing.assert_allclose(mixseq.read("new.npz").points, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("model.h5 new.npz --between vertices --cuts none", "model.h5 is a model already; leave out --between"),
        ("model.h5 new.npz --between hold", "model.h5 is a model already; leave out --between"),
        ("model.h5 new.npz --cuts none", "model.h5 is a model already; leave out --cuts"),
        ("walk.npz new.npz --cuts some", "'some' is not auto, none, or frame numbers such as 1013,1050"),
        ("walk.npz new.npz --cuts 99", "there is no frame 99; frames are"),
    ],
)
def test_wrong_cuts_are_refused(run: Run, arguments: str, message: str) -> None:
    mixseq.write("walk.npz", MeshSequence.from_arrays(moving(np.arange(4.0)), MESH[1]))
    result = run("resample", *arguments.split())
    assert result.exit_code == 2
    assert message in result.stderr
