"""``mixseq interpolate``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.choices import SPACES
from mixseq.cli.interpolate import command
from mixseq.sequence.sequence import MeshSequence
from tests.cli.conftest import Contents, Run, succeed


def test_spaces_are_those_of_the_code() -> None:
    (option,) = (each for each in command.params if each.name == "space")
    assert tuple(option.type.choices) == SPACES  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["new.obj", "new.npz", "new.usdc"])
def test_one_blend(run: Run, name: str, bent_bar: MeshSequence) -> None:
    text = succeed(run("interpolate", "bar.npz", name, "--pose", "0=1/4", "--pose", "3=0.75"))
    assert "space   mixed, dim " in text
    assert "poses   0 = 0.25, 3 = 0.75\nframes  1\nwrote new." in text
    new = mixseq.read(name)
    assert new.frame_count == 1
    expected = mixseq.interpolate(bent_bar, [0.25, 0, 0, 0.75])
    np.testing.assert_allclose(new.points[0], expected, atol=1e-6)


@pytest.mark.parametrize("space", SPACES)
def test_all_spaces(run: Run, space: str, bent_bar: MeshSequence) -> None:
    succeed(run("interpolate", "bar.npz", "new.npz", "--pose", "2=1", "--space", space))
    np.testing.assert_allclose(mixseq.read("new.npz").points[0], bent_bar.points[2], atol=1e-6)


def test_from_one_pose_to_another(run: Run, bent_bar: MeshSequence) -> None:
    text = succeed(
        run("interpolate", "bar.npz", "new.npz", "--pose", "3", "--pose", "1", "--steps", "5", "--threads", "1")
    )
    assert "poses   1, 3\nframes  5\n" in text
    new = mixseq.read("new.npz")
    assert new.times == pytest.approx(np.arange(5) / bent_bar.fps)
    np.testing.assert_allclose(new.points[[0, -1]], bent_bar.points[[3, 1]], atol=1e-6)
    np.testing.assert_allclose(new.points[1], mixseq.interpolate(bent_bar, [0, 0.25, 0, 0.75]), atol=1e-6)


def test_two_poses_need_no_names(run: Run, bent_bar: MeshSequence) -> None:
    pair = MeshSequence.from_arrays(bent_bar.points[[0, 3]], bent_bar.faces)
    mixseq.write("pair.npz", pair)
    succeed(run("interpolate", "pair.npz", "new.npz", "--steps", "3", "--quiet", "--space", "vertex"))
    np.testing.assert_allclose(mixseq.read("new.npz").points[1], pair.points.mean(axis=0), atol=1e-6)


def test_settings_are_used(run: Run, bent_bar: MeshSequence) -> None:
    arguments = ["--pose", "0=0.5", "--pose", "3=0.5", "--placement", "anchored", "--parts", "2"]
    succeed(run("interpolate", "bar.npz", "new.npz", *arguments, "--joint-width", "2"))
    expected = mixseq.interpolate(bent_bar, [0.5, 0, 0, 0.5], placement="anchored", parts=2, joint_width=2)
    np.testing.assert_allclose(mixseq.read("new.npz").points[0], expected, atol=1e-6)
    edge = ["--space", "edge", "--projection", "dso", "--volume", "1", "--pose", "0=1"]
    succeed(run("interpolate", "bar.npz", "new.npz", *edge))


def test_given_labels(run: Run, folder: Path, bent_bar: MeshSequence) -> None:
    labels = np.arange(len(bent_bar.faces)) // 50
    np.savez(folder / "parts.npz", labels=labels)
    arguments = ["--pose", "0=0.5", "--pose", "3=0.5", "--labels", "parts.npz"]
    succeed(run("interpolate", "bar.npz", "new.npz", *arguments))
    expected = mixseq.interpolate(bent_bar, [0.5, 0, 0, 0.5], parts=labels)
    np.testing.assert_allclose(mixseq.read("new.npz").points[0], expected, atol=1e-6)
    result = run("interpolate", "bar.npz", "new.npz", *arguments, "--parts", "2")
    assert (result.exit_code, "leave out --parts" in result.stderr) == (2, True)


HALVES = "--pose 0=1/2 --pose 1=1/2"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("bar.npz new.npz", "there are no poses to blend; give some as --pose FRAME=WEIGHT, or --steps"),
        ("bar.npz new.npz --pose 1", "--pose 1 has no weight; give --pose 1=WEIGHT, or --steps"),
        ("bar.npz new.npz --pose x=1", "'x=1' is not FRAME=WEIGHT, for example 2=0.5 or 2=1/3"),
        ("bar.npz new.npz --pose 1=nan", "'1=nan' is not FRAME=WEIGHT"),
        ("bar.npz new.npz --pose 1=1/0", "'1=1/0' is not FRAME=WEIGHT"),
        ("bar.npz new.npz --pose 1=1e999", "is not FRAME=WEIGHT"),
        ("bar.npz new.npz --pose 1=1e999999999999", "is not FRAME=WEIGHT"),
        ("bar.npz new.npz --pose 1=0.5 --pose 1=0.5", "--pose 1 is given more than once"),
        ("bar.npz new.npz --pose 4=1", "there is no frame 4; frames are 0 to 3"),
        ("bar.npz new.npz --pose -1=1", "there is no frame -1; frames are 0 to 3"),
        ("bar.npz new.npz --pose 1=0.5", "weights add up to 0.5 and must add up to 1; divide them by"),
        ("bar.npz new.npz --steps 3", "there are 4 poses; name two of them by --pose FRAME --pose FRAME"),
        ("bar.npz new.npz --steps 3 --pose 1", "give --pose twice, not 1 times"),
        ("bar.npz new.npz --steps 3 --pose 1 --pose 2=1", "--steps chooses the weights; give --pose 2 without"),
        ("bar.npz new.npz --steps 1 --pose 1 --pose 2", "'--steps': 1 is not in the range x>=2"),
        (f"bar.npz new.npz {HALVES} --space vertex --parts 2", "the vertex space has no use for parts"),
        (
            f"bar.npz new.npz {HALVES} --volume 1",
            "the mixed space has no use for volume; leave it out, or choose space='edge'",
        ),
        (f"bar.npz new.npz {HALVES} --space edge --projection steps --volume 1", "has no use for volume"),
        (f"bar.npz bar.npz {HALVES}", "bar.npz is the source itself"),
        (f"notes.txt new.npz {HALVES}", "notes.txt"),
        (f"nowhere.npz new.npz {HALVES}", "nowhere.npz does not exist"),
    ],
)
def test_errors_take_one_line_and_write_nothing(run: Run, contents: Contents, arguments: str, message: str) -> None:
    before = contents()
    result = run("interpolate", *arguments.split())
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert contents() == before
