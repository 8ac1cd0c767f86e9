"""Models in all shape spaces on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mixseq
from mixseq.choices import SPACES
from mixseq.cli.encode import command
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.edge import EdgeSpace
from tests.cli.conftest import Run, succeed

pytestmark = pytest.mark.slow


NEW = ("gradient", "lri", "edge")


def test_choices_are_the_spaces_of_the_code() -> None:
    (option,) = (each for each in command.params if each.name == "space")
    assert tuple(option.type.choices) == SPACES  # type: ignore[attr-defined]


@pytest.mark.parametrize("space", NEW)
def test_from_a_sequence_to_a_model_and_back(run: Run, space: str, bent_bar: MeshSequence) -> None:
    text = succeed(run("encode", "bar.npz", "new.h5", "--exact", "--space", space, "--check"))
    assert f"space       {space}\n" in text
    succeed(run("decode", "new.h5", "new.npz"))
    assert mixseq.compare(bent_bar, mixseq.read("new.npz")).max_error < 1e-9
    succeed(run("resample", "new.h5", "slow.npz", "--speed", "0.5", "--velocities"))
    assert mixseq.read("slow.npz").frame_count == 2 * bent_bar.frame_count - 1
    facts = json.loads(succeed(run("info", "new.h5", "--json")))
    assert facts["space"] == space
    assert facts["dim"] == mixseq.load("new.h5").space.dim
    assert "placement" not in facts


@pytest.mark.parametrize("space", NEW)
def test_pictures_of_parts_need_parts(run: Run, folder: Path, space: str) -> None:
    succeed(run("encode", "bar.npz", "new.h5", "--rank", "1", "--space", space, "--quiet"))
    if space == "edge":
        succeed(run("plot", "new.h5", "new.png"))
    result = run("plot", "new.h5", "parts.png", "--kind", "parts")
    assert result.exit_code == 2
    assert f"the {space} space has no parts; fit a model with space='mixed'" in result.stderr
    assert not (folder / "parts.png").exists()


def test_settings_of_the_edge_space(run: Run) -> None:
    succeed(run("encode", "bar.npz", "new.h5", "--space", "edge", "--projection", "dso", "--volume", "2"))
    space = mixseq.load("new.h5").space
    assert isinstance(space, EdgeSpace)
    assert (space.settings.projection, space.settings.volume) == ("dso", 2.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--space vertex --parts 2", "the vertex space has no use for parts; leave it out, or choose space='mixed'"),
        ("--space lri --placement free", "the lri space has no use for placement"),
        ("--projection dso", "the mixed space has no use for projection; leave it out, or choose space='edge'"),
        ("--space edge --volume 2", "projection 'steps' has no use for volume; leave it out, or choose 'dso'"),
    ],
)
def test_settings_for_nothing_are_refused(run: Run, folder: Path, options: str, message: str) -> None:
    result = run("encode", "bar.npz", "new.h5", *options.split())
    assert (result.exit_code, message in result.stderr) == (2, True), result.stderr
    assert not (folder / "new.h5").exists()


def test_a_batch_remembers_settings_of_the_edge_space(run: Run) -> None:
    arguments = [
        "batch",
        "encode",
        "bar.npz",
        "--out",
        "models",
        "--space",
        "edge",
        "--projection",
        "dso",
        "--volume",
        "1",
    ]
    assert run(*arguments).exit_code == 0
    made = Path("models/bar.h5").stat().st_mtime_ns
    settings = json.loads(Path("models/report.json").read_text())["assets"][0]["settings"]["options"]
    assert (settings["projection"], settings["volume"]) == (["--projection=dso"], ["--volume=1"])
    assert run(*arguments).exit_code == 0
    assert Path("models/bar.h5").stat().st_mtime_ns == made
    assert run(*arguments, "--volume", "2").exit_code == 0
    assert Path("models/bar.h5").stat().st_mtime_ns > made
