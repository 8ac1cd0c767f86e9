"""``mixseq edit``: models in, models or sequences out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.operations import repeat, reverse, transition, travel_of
from mixseq.operations.script import OPERATIONS
from mixseq.signals.model import Model
from tests.cli.conftest import Contents, Run

pytestmark = pytest.mark.slow


REPEAT = """
[[edit]]
operation = "repeat"
start = 0.1
end = 0.3
times = 3

[[edit]]
operation = "reverse"
"""


@pytest.fixture
def script(folder: Path) -> Path:
    path = folder / "edits.toml"
    path.write_text(REPEAT)
    return path


@pytest.mark.parametrize("target", ["new.h5", "new.hdf5", "old.h5"])
def test_a_model_becomes_a_model(run: Run, script: Path, bar_model: Model, target: str) -> None:
    result = run("edit", "model.h5", target, "--script", "edits.toml")
    assert (result.exit_code, result.stderr) == (0, "")
    lines = [line.split("  ") for line in result.stdout.splitlines()]
    cells = [[cell.strip() for cell in line if cell.strip()] for line in lines]
    assert cells[:3] == [
        ["edit", "before", "after"],
        ["1", "repeat", "0 to 0.3 s, 4 frames (0 to 3)", "0 to 0.7 s, 8 frames (0 to 7)"],
        ["2", "reverse", "0 to 0.7 s, 8 frames (0 to 7)", "0 to 0.7 s, 8 frames (0 to 7)"],
    ]
    assert result.stdout.splitlines()[-1].startswith(f"wrote {target} (")
    expected = reverse(repeat(bar_model, 0.1, 0.3, times=3))
    found = mixseq.load(target)
    np.testing.assert_allclose(found.times, expected.times)
    np.testing.assert_allclose(found.sample().points, expected.sample().points, atol=1e-9)
    times = np.linspace(0, 0.7, 31)
    np.testing.assert_allclose(found.curve(times), expected.curve(times), atol=1e-10)


def test_a_model_becomes_a_sequence(run: Run, script: Path, bar_model: Model) -> None:
    expected = reverse(repeat(bar_model, 0.1, 0.3, times=3))
    assert run("edit", "model.h5", "new.npz", "--script", "edits.toml", "--quiet").stdout.startswith("wrote")
    np.testing.assert_allclose(mixseq.read("new.npz").points, expected.sample().points, atol=1e-9)
    run("edit", "model.h5", "new.npz", "--script", "edits.toml", "--fps", "20")
    found = mixseq.read("new.npz")
    assert (found.fps, found.frame_count) == (20, 15)
    np.testing.assert_allclose(found.points, expected.sample(fps=20).points, atol=1e-9)
    run("edit", "model.h5", "new.npz", "--script", "edits.toml", "--velocities")
    moving = expected.sample(velocities=True).velocities
    written = mixseq.read("new.npz").velocities
    assert moving is not None
    assert written is not None
    np.testing.assert_allclose(written, moving, atol=1e-9)


def test_what_else_moves_in_a_scene_is_told_where_edits_retime(run: Run, script: Path, scene: Path) -> None:
    assert run("encode", str(scene), "scene.h5", "--exact").exit_code == 0
    result = run("edit", "scene.h5", "new.usdc", "--script", "edits.toml")
    assert result.stderr.endswith("scene.usda is not retimed: /camera\n")
    script.write_text('[[edit]]\noperation = "cut"\nstart = 0.1\nend = 0.2\n')
    assert run("edit", "scene.h5", "new.usdc", "--script", "edits.toml").stderr == ""


def test_files_are_found_from_the_script(run: Run, folder: Path, bar_model: Model) -> None:
    (folder / "scripts").mkdir()
    (folder / "scripts" / "over.toml").write_text(
        '[[edit]]\noperation = "transition"\nb = "../model.hdf5"\nat = 0.1\nduration = 0.2\n'
    )
    refused = run("edit", "model.h5", "new.h5", "--script", "scripts/over.toml")
    assert refused.exit_code == 2
    assert "'../model.hdf5' is not in the script's folder" in refused.stderr
    allowed = run("edit", "model.h5", "new.h5", "--script", "scripts/over.toml", "--set", "files_from=.")
    assert allowed.exit_code == 0
    expected = transition(bar_model, bar_model, 0.1, 0.2)
    np.testing.assert_allclose(mixseq.load("new.h5").times, expected.times)


def test_a_sculpted_mesh_is_read(run: Run, folder: Path, bar_model: Model) -> None:
    points = bar_model(0.1)
    mixseq.write("one.npz", bar_model.sample([0.1]).with_points(points[None]))
    (folder / "edits.toml").write_text('[[edit]]\noperation = "sculpt"\ntime = 0.1\nmesh = "one.npz"\n')
    assert run("edit", "model.h5", "new.npz", "--script", "edits.toml").exit_code == 0
    np.testing.assert_allclose(mixseq.read("new.npz").points, bar_model.sample().points, atol=1e-8)


def test_a_sequence_is_edited_as_its_exact_model(run: Run, folder: Path, bar_model: Model) -> None:
    (folder / "edits.toml").write_text('[[edit]]\noperation = "reverse"\n')
    assert run("edit", "bar.npz", "new.npz", "--script", "edits.toml").exit_code == 0
    np.testing.assert_allclose(mixseq.read("new.npz").points, mixseq.read("bar.npz").points[::-1], atol=1e-6)


def test_the_help_knows_all_operations(run: Run) -> None:
    words = run("edit", "--help").stdout.replace(",", " ").replace(";", " ").split()
    assert set(OPERATIONS) <= set(words)


@pytest.mark.parametrize(
    ("arguments", "text", "message"),
    [
        ("model.h5 new.h5", REPEAT, "Missing option '--script'"),
        ("model.h5 new.h5 --script none.toml", REPEAT, "none.toml does not exist"),
        ("none.h5 new.h5 --script edits.toml", REPEAT, "none.h5 does not exist"),
        ("model.h5 new.h5 --script edits.toml --fps 24", REPEAT, "--fps is for sequences"),
        ("model.h5 new.h5 --script edits.toml --velocities", REPEAT, "--velocities is for sequences"),
        ("model.h5 new.fbx --script edits.toml", REPEAT, "'.fbx' is not known; write one of"),
        ("model.h5 model.h5 --script edits.toml", REPEAT, "is the source itself and would be lost"),
        ("model.h5 edits.toml --script edits.toml", REPEAT, "is the source itself and would be lost"),
        ("model.h5 nowhere/new.h5 --script edits.toml", REPEAT, "nowhere does not exist; make it first"),
        (
            "model.h5 model.hdf5 --script edits.toml",
            '[[edit]]\noperation = "concatenate"\nb = "model.hdf5"',
            "edit 1 (concatenate): b: model.hdf5 is the source itself and would be lost",
        ),
        (
            "model.h5 old.h5 --script edits.toml",
            '[[edit]]\noperation = "cut"\nstart = 0\nend = 3',
            "edit 1 (cut): end is 3 s; the model is from 0 to 0.3 s (frames 0 to 3), give a time within; frame 3",
        ),
        (
            "model.h5 old.h5 --script edits.toml",
            '[[edit]]\noperation = "lop"',
            "edit 1: unknown operation 'lop'; use one of cut, repeat, loop",
        ),
        (
            "model.h5 old.h5 --script edits.toml",
            '[[edit]]\noperation = "concatenate"\nb = "none.h5"',
            "edit 1 (concatenate): b: none.h5 does not exist",
        ),
    ],
)
def test_what_goes_wrong_is_one_line_and_nothing_changes(
    run: Run, folder: Path, contents: Contents, arguments: str, text: str, message: str
) -> None:
    (folder / "edits.toml").write_text(text)
    before = contents()
    result = run("edit", *arguments.split())
    assert result.exit_code == 2
    assert result.stdout == ""
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert contents() == before


IN_PLACE = '[[edit]]\noperation = "in_place"\neven = true\n'


def test_what_is_taken_away_is_written(run: Run, folder: Path, bar_model: Model) -> None:
    (folder / "spot.toml").write_text(IN_PLACE)
    result = run("edit", "model.h5", "spot.npz", "--script", "spot.toml", "--set", "travel=travel.csv")
    assert (result.exit_code, result.stderr) == (0, "")
    header, *rows = (folder / "travel.csv").read_text().splitlines()
    assert header == "seconds,x,y,z"
    table = np.array([row.split(",") for row in rows], dtype=np.float64)
    np.testing.assert_allclose(table[:, 0], bar_model.times, atol=1e-8)
    np.testing.assert_allclose(table[:, 1:], travel_of(bar_model, even=True)(bar_model.times), atol=1e-7)
    both = mixseq.read("spot.npz").points + table[:, None, 1:]
    np.testing.assert_allclose(both, bar_model.sample().points, atol=1e-6)


@pytest.mark.parametrize(("script", "times"), [(REPEAT, 0), (2 * IN_PLACE, 2)])
def test_travel_is_that_of_one_edit(run: Run, folder: Path, script: str, times: int) -> None:
    (folder / "spot.toml").write_text(script)
    result = run("edit", "model.h5", "spot.npz", "--script", "spot.toml", "--set", "travel=travel.csv")
    assert result.exit_code == 2
    assert f"the script has the operation in_place {times} times; travel is what it takes away" in result.stderr
    assert not (folder / "travel.csv").exists()
