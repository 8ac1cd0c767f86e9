"""What commands do when all is well."""

from __future__ import annotations

import inspect
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import Result

import mixseq
from mixseq.cli import main
from mixseq.mesh.surface import MeshObject, Surface
from mixseq.sequence.sequence import MeshSequence
from tests.cli.conftest import Run, succeed
from tests.meshes import COARSE_CELL_METRES, bent, tube

pytestmark = pytest.mark.slow


COMMANDS = main.list_commands(click.Context(main))


def rows(text: str) -> dict[str, str]:
    """The lines of a table by their first column."""
    return dict(line.split("  ", 1) for line in text.splitlines() if "  " in line)


# Help -----------------------------------------------------------------------------------------------------


def test_without_arguments_there_is_help(run: Run) -> None:
    text = succeed(run())
    assert text == succeed(run("--help")) == succeed(run("-h"))
    for name in COMMANDS:
        assert f"\n  {name} " in text


def test_version(run: Run) -> None:
    assert succeed(run("--version")) == f"mixseq {mixseq.__version__}\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_examples_that_parse(run: Run, name: str) -> None:
    text = succeed(run(name, "--help"))
    assert succeed(run(name, "-h")) == text
    lines = [line.strip() for line in text.split("Examples:")[1].splitlines() if line.strip()]
    assert lines
    for line in lines:
        program, command_name, *arguments = shlex.split(line)
        assert (program, command_name) == ("mixseq", name)
        command = main.get_command(click.Context(main), name)
        assert command is not None
        command.make_context(name, arguments)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_lists_what_its_examples_use(run: Run, name: str) -> None:
    listed, _, lines = succeed(run(name, "--help")).partition("Options:")[2].partition("Examples:")
    options, _, settings = listed.partition("Settings (--set NAME=VALUE):")
    assert set(re.findall(r" (--[a-z-]+)", lines)) <= set(re.findall(r"^  .*?(--[a-z-]+)", options, re.MULTILINE))
    used = set(re.findall(r"--set ([a-z_]+)=", lines))
    assert used <= set(re.findall(r"^  ([a-z_]+)=", settings, re.MULTILINE))


def test_defaults_are_those_in_python() -> None:
    python = inspect.signature(mixseq.fit).parameters
    command = main.get_command(click.Context(main), "encode")
    assert command is not None
    shown = {
        str(each.name): each.default for each in command.params if each.name in ("space", "placement", "joint_width")
    }
    assert shown == {name: python[name].default for name in shown}
    assert len(shown) == 3


# info -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bar.npz", "bar.usdc", "bar_sequence.h5"])
def test_info_of_a_sequence(run: Run, name: str, bent_bar: MeshSequence) -> None:
    table = rows(succeed(run("info", name)))
    assert table["vertices"].strip() == "77"
    assert table["time"].strip() == "0 to 0.3 s"
    assert "parts" not in table
    facts = json.loads(succeed(run("info", name, "--json")))
    assert facts["kind"] == "sequence"
    assert (facts["vertices"], facts["triangles"], facts["frames"], facts["fps"]) == (77, 150, 4, 10)
    assert facts["diagonal"] == pytest.approx(bent_bar.diagonal)
    assert facts["bytes"] == {"total": Path(name).stat().st_size}
    assert facts["topology"]["closed"] is True


def test_info_of_a_model(run: Run) -> None:
    table = rows(succeed(run("info", "model.h5")))
    assert table["model"].strip() == "bar"
    assert table["parts"].strip() == "2 with 31, 31 vertices"
    assert table["placements"].strip() == "1"
    facts = json.loads(succeed(run("info", "model.h5", "--json")))
    assert facts["kind"] == "model"
    assert facts["placement"] == "anchored"
    assert (facts["part_vertices"], facts["placements"]) == ([31, 31], 1)
    assert (facts["time_knots"], facts["placement_knots"], facts["correction_knots"]) == (7, 13, 13)
    model = mixseq.load("model.h5").mixed
    assert (facts["dim"], facts["dim_edges"]) == (model.dim, 2 * 225 + 6)
    assert facts["edges_per_dim"] == facts["dim_edges"] / facts["dim"]
    assert (facts["joint_faces"], facts["share"]) == (model.joint_faces.sum(), model.projection.share)
    assert facts["bytes"] == {"total": Path("model.h5").stat().st_size, "frames": 4 * 77 * 12}
    shorter = f"{facts['edges_per_dim']:.2f} times shorter than all lengths and angles"
    assert table["vector"].strip() == f"{facts['dim']} numbers, {shorter}"
    assert table["knots"].strip() == "7 of the time signal, 13 of the placement, 13 of corrections"
    assert table["size"].strip().endswith(" times the frames in single precision")
    assert (
        succeed(run("info", "model.hdf5", "--json")).replace("model.hdf5", "model.h5").splitlines()[2:]
        == (succeed(run("info", "model.h5", "--json")).splitlines()[2:])
    )


def test_info_finds_moments(run: Run, folder: Path) -> None:
    swing = np.sin(2 * np.pi * np.arange(25) / 12)
    points = np.stack([bent(tube(6, 9)[0], angle) for angle in 0.5 * swing])
    cycle = mixseq.MeshSequence.from_arrays(points, tube(6, 9)[1], fps=24)
    mixseq.write("cycle.npz", cycle)
    mixseq.write("later.npz", replace(cycle[3:], times=cycle.times[3:] + 10.0))
    [best, *_] = json.loads(succeed(run("info", "cycle.npz", "--set", "moments=cycle.npz", "--json")))["moments"]
    assert best["leave_frame"] - best["enter_frame"] == 12
    assert best["leave"] - best["enter"] == pytest.approx(0.5)
    [best, *_] = json.loads(succeed(run("info", "cycle.npz", "--set", "moments=later.npz", "--json")))["moments"]
    assert (best["enter_frame"] - 240 - best["leave_frame"]) % 12 == 0
    assert best["distance"] < 1e-3
    table = rows(succeed(run("info", "cycle.npz", "--set", "moments=later.npz")))
    assert table["moment 1"].strip().startswith("leave at frame ")
    mixseq.write("cycle_##.obj", cycle)
    slow = ("info", "cycle_##.obj", "--json", "--input-fps", "12", "--set", "start_frame=5")
    for other in ("cycle_##.obj", "later.npz"):
        [best, *_] = json.loads(succeed(run(*slow, "--set", f"moments={other}")))["moments"]
        assert best["leave_frame"] == pytest.approx(12 * best["leave"])
        assert best["leave_frame"] >= 5
    mixseq.write("short.npz", cycle[:10])
    assert rows(succeed(run("info", "short.npz", "--set", "moments=short.npz")))["moments"].strip().startswith("none")


def test_info_of_numbered_files(run: Run, folder: Path) -> None:
    (folder / "obj").mkdir()
    succeed_with_warning(run("convert", "bar.npz", "obj/bar_####.obj"))
    for name in ("obj", "obj/bar_####.obj", "obj/bar_*.obj"):
        facts = json.loads(succeed(run("info", name, "--json", "--input-fps", "10")))
        assert (facts["frames"], facts["fps"], facts["bytes"]) == (4, 10, {"total": None})


def test_info_of_meshes_that_are_subdivided_differently(run: Run, bent_bar: MeshSequence) -> None:
    halves = MeshObject("body", "/body", 77, 150, "loop"), MeshObject("sword", "/sword", 0, 0)
    mixseq.write("halves.npz", replace(bent_bar, surface=Surface(objects=halves)))
    assert rows(succeed(run("info", "halves.npz")))["subdivision"].strip() == "loop of 1, none of 1"
    surface = json.loads(succeed(run("info", "halves.npz", "--json")))["surface"]
    assert [each["subdivision"] for each in surface["objects"]] == ["loop", "none"]


def test_quiet_info(run: Run) -> None:
    assert succeed(run("info", "bar.npz", "--quiet")) == ""


# convert --------------------------------------------------------------------------------------------------


def succeed_with_warning(result: Result) -> str:
    """As `succeed`, but for one warning on one line."""
    assert result.exit_code == 0
    assert result.stderr.startswith("mixseq: warning: ")
    assert result.stderr.count("\n") == 1
    return result.stdout


@pytest.mark.parametrize("name", ["new.npz", "new.h5", "old.npz", "old.h5"])
def test_convert_without_loss(run: Run, name: str, bent_bar: MeshSequence) -> None:
    assert succeed(run("convert", "bar.npz", name)).startswith(f"wrote {name} (")
    back = mixseq.read(name)
    assert np.array_equal(back.points, bent_bar.points)
    assert np.array_equal(back.times, bent_bar.times)
    assert back.name == "bar"


def test_convert_to_usd(run: Run, bent_bar: MeshSequence) -> None:
    result = run("convert", "bar.npz", "new.usdc")
    assert result.exit_code == 0
    assert result.stdout.startswith("wrote new.usdc (")
    assert np.array_equal(mixseq.read("new.usdc").points, bent_bar.points.astype(np.float32))


def test_convert_to_obj_and_back(run: Run, bent_bar: MeshSequence, folder: Path) -> None:
    (folder / "obj").mkdir()
    text = succeed_with_warning(run("convert", "bar.npz", "obj/bar_####.obj"))
    assert text == f"wrote {Path('obj/bar_####.obj')}\n"
    assert sorted(path.name for path in Path("obj").iterdir()) == [f"bar_{number:04d}.obj" for number in range(4)]
    succeed(run("convert", "obj", "back.npz", "--input-fps", "10"))
    back = mixseq.read("back.npz")
    assert np.array_equal(back.points, bent_bar.points)
    assert back.fps == 10
    Path("obj/bar_0001.obj").unlink()
    assert run("convert", "obj", "gaps.npz").exit_code == 2
    succeed(run("convert", "obj", "gaps.npz", "--allow-gaps", "--input-fps", "10"))
    assert mixseq.read("gaps.npz").times == pytest.approx([0, 0.2, 0.3])


def test_frames_have_numbers(run: Run, folder: Path) -> None:
    assert rows(succeed(run("info", "bar.npz")))["frames"].strip() == "4 (0 to 3)"
    succeed(run("convert", "bar.npz", "shot.npz", "--start-frame", "1001"))
    assert rows(succeed(run("info", "shot.npz")))["frames"].strip() == "4 (1001 to 1004)"
    facts = json.loads(succeed(run("info", "shot.npz", "--json")))
    assert (facts["first_frame"], facts["last_frame"]) == (1001, 1004)
    found = run("compare", "shot.npz", "bar.npz")
    assert found.exit_code == 2
    assert "frame 1001 (index 0) is at 100.1 s" in found.stderr


@pytest.mark.parametrize(("chosen", "indices"), [("1002-1003", [1, 2]), ("1001", [0]), ("1004,1001-1002", [0, 1, 3])])
def test_frames_are_converted_and_decoded_by_their_numbers(
    run: Run, bent_bar: MeshSequence, folder: Path, chosen: str, indices: list[int]
) -> None:
    shot = MeshSequence.from_header(bent_bar.header.numbered_from(1001), bent_bar.points, bent_bar.points)
    mixseq.write("shot.npz", shot)
    succeed(run("convert", "shot.npz", "part.npz", "--frames", chosen))
    part = mixseq.read("part.npz")
    assert part.velocities is not None
    np.testing.assert_array_equal(part.points, bent_bar.points[indices])
    np.testing.assert_array_equal(part.velocities, bent_bar.points[indices])
    np.testing.assert_array_equal(part.times, shot.times[indices])
    mixseq.save("shot.h5", mixseq.fit(shot.with_points(shot.points), exact=True, space="vertex"))
    succeed(run("decode", "shot.h5", "decoded.npz", "--frames", chosen))
    decoded = mixseq.read("decoded.npz")
    np.testing.assert_array_equal(decoded.times, part.times)
    np.testing.assert_allclose(decoded.points, part.points, atol=1e-7)


def test_frames_at_another_rate(run: Run, folder: Path) -> None:
    table = rows(succeed(run("decode", "model.h5", "more.npz", "--frames", "1-2", "--fps", "20")))
    assert table["frames"].strip() == "3 (2 to 4)"


# encode and decode ----------------------------------------------------------------------------------------


def test_encode(run: Run, bent_bar: MeshSequence) -> None:
    text = succeed(run("encode", "bar.npz", "new.h5", "--check"))
    table = rows(text)
    assert table["space"].strip() == "mixed, anchored placement"
    assert float(table["max error"].split()[0]) <= 5e-4  # the promise, lossless to the eye
    assert "KG error" in table
    assert text.splitlines()[-1].startswith("wrote new.h5 (")
    assert mixseq.compare(bent_bar, mixseq.load("new.h5").sample()).max_error <= 5e-4


def test_encode_with_settings(run: Run) -> None:
    arguments = ("--parts", "3", "--placement", "free", "--joint-width", "1")
    table = rows(succeed(run("encode", "bar.usdc", "old.h5", *arguments)))
    assert table["space"].strip() == "mixed, free placement"
    assert table["parts"].strip().startswith("3 with ")
    assert "max error" not in table
    model = mixseq.load("old.h5")
    assert model.mixed.placement == "free"
    assert len(model.decomposition.parts) == 3


def test_quiet_encode(run: Run) -> None:
    text = succeed(run("encode", "bar.npz", "new.HDF5", "-q", "--check"))
    assert text.startswith("wrote new.HDF5 (")
    assert text.count("\n") == 1


def test_decode_the_original_frames(run: Run, bent_bar: MeshSequence) -> None:
    table = rows(succeed(run("decode", "model.h5", "new.npz")))
    assert table["frames"].strip() == "4 (0 to 3)"
    assert table["time"].strip() == "0 to 0.3 s at 10 frames per second"
    assert mixseq.compare(bent_bar, mixseq.read("new.npz")).max_error < 1e-10


@pytest.mark.parametrize(
    ("options", "times", "fps"),
    [
        (["--fps", "20"], np.arange(7) / 20, 20),
        (["--fps", "4"], [0, 0.25], 4),
        (["--times", "0,0.125,0.3"], [0, 0.125, 0.3], 10),
        (["--times", "0.07"], [0.07], 10),
        (["--times", "0.1,0.2", "--fps", "30"], [0.1, 0.2], 30),
        (["--start", "0.1"], [0.1, 0.2, 0.3], 10),
        (["--end", "0.15"], [0, 0.1], 10),
        (["--start", "0.1", "--end", "0.2"], [0.1, 0.2], 10),
        (["--start", "0.05", "--end", "0.25", "--fps", "20"], [0.05, 0.1, 0.15, 0.2, 0.25], 20),
        (["--start", "0.2", "--end", "0.2", "--fps", "50"], [0.2], 50),
    ],
)
def test_decode_some_times(run: Run, options: list[str], times: list[float], fps: float) -> None:
    succeed(run("decode", "model.h5", "new.h5", *options))
    new = mixseq.read("new.h5")
    assert new.times == pytest.approx(np.asarray(times))
    assert new.fps == fps
    expected = mixseq.load("model.h5").sample(new.times).points
    assert new.points == pytest.approx(expected, abs=1e-9)


def test_quiet_decode(run: Run) -> None:
    assert succeed(run("decode", "model.h5", "new.npz", "--quiet")).count("\n") == 1


# compare --------------------------------------------------------------------------------------------------


def test_compare(run: Run) -> None:
    table = rows(succeed(run("compare", "bar.npz", "model.h5")))
    assert table["compared"].strip() == "4 frames of 77 vertices"
    assert table["verdict"].strip() == "equal, but for rounding"
    for offset, verdict in ((1e-4, "no visible difference"), (1e-2, "visibly different, most in frame")):
        bar = mixseq.read("bar.npz")
        mixseq.write("moved.npz", bar.with_points(bar.points + offset * bar.diagonal))
        assert rows(succeed(run("compare", "bar.npz", "moved.npz")))["verdict"].strip().startswith(verdict)
    assert float(table["max error"].split()[0]) < 1e-10
    assert {"KG error", "rms error", "worst frame", "edge strain", "dihedral error", "volume error"} <= set(table)
    facts = json.loads(succeed(run("compare", "bar.npz", "bar.usdc", "--json")))
    assert (facts["reference"], facts["other"], facts["left_out"]) == ("bar.npz", "bar.usdc", 0)
    assert 0 < facts["max_error"] < 1e-6
    assert succeed(run("compare", "bar.npz", "bar.usdc", "--quiet")) == ""


def test_compare_tells_of_axes_and_units(run: Run) -> None:
    result = run("compare", "bar.npz", "bar.npz", "--quiet")
    assert (result.exit_code, result.stderr) == (0, "")
    succeed(run("convert", "bar.npz", "z.npz", "--up-axis", "Z", "--units", "0.01"))
    result = run("compare", "bar.npz", "z.npz", "--quiet")
    told = "bar.npz has Y up and units of 1 m, z.npz has Z up and units of 0.01 m; points are compared as they are"
    assert (result.exit_code, result.stderr) == (0, f"mixseq: warning: {told}\n")


def test_compare_at_shared_times(run: Run) -> None:
    succeed(run("decode", "model.h5", "new.npz", "--fps", "20"))
    text = succeed(run("compare", "bar.npz", "new.npz"))
    assert text.startswith("compared at the 4 times that new.npz shares, out of 7\n")
    assert float(rows(text)["max error"].split()[0]) < 1e-10
    facts = json.loads(succeed(run("compare", "bar.npz", "new.npz", "--json")))
    assert (facts["frames"], facts["left_out"]) == (4, 3)


def test_reader_options_go_to_the_file_that_knows_them(run: Run) -> None:
    mesh = json.loads(succeed(run("compare", "bar.npz", "bar.usdc", "--prim", "/bar", "--json")))
    assert mesh["frames"] == 4


# formats and demo -----------------------------------------------------------------------------------------


def test_formats(run: Run) -> None:
    text = succeed(run("formats"))
    assert max(map(len, text.splitlines())) <= 100
    assert text.split()[:3] == ["format", "reads", "writes"]
    for word in (".usdc", ".usdz", ".h5", ".npz", ".obj", "skins, morph targets,"):
        assert word in text
    markdown = succeed(run("formats", "--markdown"))
    assert markdown.startswith("| format | reads | writes | polygons |")


def test_demo(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mixseq.creature.CELL_METRES", COARSE_CELL_METRES)
    table = rows(succeed(run("demo", "--frames", "2", "--out", "demo/fox")))
    place = folder / "demo" / "fox"
    names = ["contact_sheet.png", "creature.usdc", "decoded.usdc", "model.h5"]
    assert sorted(path.name for path in place.iterdir()) == names
    assert (place / "contact_sheet.png").read_bytes().startswith(b"\x89PNG")
    assert table["frames"].strip() == "2 encoded, 3 decoded"
    assert float(table["max error"].split()[0]) < 1e-10
    assert mixseq.load(place / "model.h5").header.frame_count == 2
    assert mixseq.read(place / "decoded.usdc").frame_count == 3
