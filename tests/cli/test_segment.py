"""``mixseq segment``, and parts from labels in ``mixseq encode``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom

import mixseq
from mixseq.choices import SEGMENTATIONS
from mixseq.cli.segment import numbered
from mixseq.segmentation.methods import METHODS
from mixseq_io import read_labels
from tests.cli.conftest import Contents, Run, succeed
from tests.formats.gltf_maker import Maker


def test_a_usd_file_gets_subsets_and_keeps_its_points(run: Run, folder: Path) -> None:
    text = succeed(run("segment", "bar.usdc", "out.usda", "--parts", "2"))
    lines = text.splitlines()
    assert lines[0].split() == ["part", "faces", "area", "near-rigid", "error"]
    assert [line.split()[0] for line in lines[1:3]] == ["part_00", "part_01"]
    assert lines[3].startswith("2 parts")
    assert lines[4].startswith("wrote out.usda (")
    assert lines[4].endswith("a layer over ./bar.usdc")
    assert lines[5].startswith("wrote out-parts.png (")
    assert (folder / "out-parts.png").read_bytes().startswith(b"\x89PNG")
    old, new = mixseq.read("bar.usdc"), mixseq.read("out.usda")
    assert np.array_equal(old.points.view(np.int32), new.points.view(np.int32))
    stage = Usd.Stage.Open("out.usda")
    (prim,) = (each for each in stage.Traverse() if UsdGeom.Mesh(each))
    valid: Any = UsdGeom.Subset.ValidateFamily(UsdGeom.Mesh(prim), "face", "mixseq")  # a pair
    assert valid[0], valid[1]
    succeed(run("segment", "bar.npz", "out.npz", "--parts", "2", "--no-picture"))
    one, other = read_labels("out.usda", old), read_labels("out.npz", old)
    np.testing.assert_array_equal(one.part_of_face, other.part_of_face)
    assert one.names == other.names == ("part_00", "part_01")


def test_the_same_parts_as_in_a_model(run: Run) -> None:
    succeed(run("segment", "bar.npz", "out.npz", "--quiet", "--no-picture"))
    succeed(run("encode", "bar.npz", "ours.h5"))
    succeed(run("encode", "bar.npz", "given.h5", "--labels", "out.npz"))
    ours, given = (mixseq.load(name).decomposition for name in ("ours.h5", "given.h5"))
    np.testing.assert_array_equal(ours.part_of_face, given.part_of_face)
    labels = read_labels("out.npz", mixseq.read("bar.npz"))
    assert len(labels.names) == int(ours.part_of_face.max()) + 1


def test_labels_become_connected_parts(run: Run, folder: Path) -> None:
    bar = mixseq.read("bar.npz")
    height = bar.points[0][bar.faces].mean(axis=1)
    along = height[:, int(np.ptp(height, axis=0).argmax())]
    thirds = np.digitize(along, np.quantile(along, [1 / 3, 2 / 3]))
    np.savez(folder / "thirds.npz", labels=np.array(["end", "middle", "end"])[thirds])
    told = json.loads(succeed(run("segment", "bar.npz", "out.npz", "--labels", "thirds.npz", "--json", "--no-picture")))
    assert [each["name"] for each in told["parts"]] == ["end", "end_1", "middle"]
    assert told["method"] == "labels"
    assert sum(each["faces"] for each in told["parts"]) == len(bar.faces)
    assert sum(each["area"] for each in told["parts"]) == pytest.approx(1)
    found = read_labels("out.npz", bar)
    assert found.names == ("end", "end_1", "middle")
    assert len(np.unique(np.stack([found.part_of_face, thirds]), axis=1).T) == 3


@pytest.fixture
def skin(folder: Path) -> Path:
    """A strip of 8 quads, of which the second half follows the second joint, which turns."""
    x = np.arange(9.0)
    points = np.concatenate([np.stack([x, 0 * x + y, 0 * x], axis=1) for y in (0.0, 1.0)])
    faces = [[(i, i + 1, i + 10), (i, i + 10, i + 9)] for i in range(8)]
    second = np.tile(x > 4, 2)
    maker = Maker()
    joints = np.zeros((18, 4), dtype=np.uint8)
    joints[:, 0] = second
    on = {"JOINTS_0": maker.add(joints, "u1"), "WEIGHTS_0": maker.add(np.tile([1.0, 0, 0, 0], (18, 1)))}
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 0, 3] = -4
    lower = maker.node("lower", translation=[4, 0, 0])
    upper = maker.node("upper", children=[lower])
    maker.node("arm", mesh=maker.mesh(points, faces, on=on), skin=0)
    inverse = maker.add(binds.transpose(0, 2, 1).reshape(2, 16))
    maker.json["skins"] = [{"joints": [upper, lower], "inverseBindMatrices": inverse}]
    maker.animate(lower, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)]])
    return maker.glb(folder / "arm.glb")


def test_a_skeleton_and_how_motion_agrees_with_it(run: Run, skin: Path) -> None:
    text = succeed(run("segment", "arm.glb", "out.usdc", "--method", "skeleton", "--against", "skeleton"))
    assert [line.split()[0] for line in text.splitlines()[1:3]] == ["upper", "lower"]
    assert "adjusted Rand index against skeleton (2 labels): 1.000 by faces, 1.000 by area" in text
    assert read_labels("out.usdc", mixseq.read("out.usdc")).names == ("upper", "lower")
    options = ("--parts", "2", "--against", "skeleton", "--json", "--no-picture")
    told = json.loads(succeed(run("segment", "arm.glb", "out.npz", *options)))
    assert told["agreement"]["by_area"] > 0.5
    succeed(run("encode", "arm.glb", "model.h5", "--source", "skeleton"))
    assert len(mixseq.load("model.h5").decomposition.parts) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("bar.npz out.ply", "has no place for parts; write one of"),
        ("bar.npz bar.npz", "is the source itself"),
        ("bar.npz out.npz --picture bar.npz", "is the source itself"),
        ("bar.npz out.npz --labels out.npz", "is the source itself"),
        ("bar.npz out.npz --labels old.npz --method motion", "are no settings of the method motion"),
        ("bar.npz out.npz --labels old.npz --parts 3", "leave out --parts"),
        ("bar.npz out.npz --method skeleton --source colours", "takes labels from the skeleton"),
        ("bar.npz out.npz --seed 3", "the method motion has no random numbers"),
        ("bar.npz out.npz --picture a.png --no-picture", "exclude each other"),
        ("bar.npz out.npz --picture out.npz", "written twice"),
        ("bar.npz out.npz --picture out.svg", "end the name in .png"),
        ("bar.npz out.npz --method labels", "has no labels of faces"),
        ("bar.npz out.npz --method skeleton", "has no 'skeleton' to label faces by"),
        ("bar.npz out.npz --against skeleton", "has no 'skeleton' to label faces by"),
        ("bar.npz out.npz --labels other.npz", "labels need a file of the same mesh"),
        ("bar.npz out.npz --labels notes.txt", "is not known"),
    ],
)
def test_refusals_leave_everything_as_it_was(run: Run, contents: Contents, arguments: str, message: str) -> None:
    if "--labels out.npz" in arguments:
        Path("out.npz").write_bytes(b"somebody's work")
    before = contents()
    result = run("segment", *arguments.split())
    assert result.exit_code == 2
    assert message in result.stderr
    assert contents() == before


def test_encode_takes_parts_or_labels(run: Run, contents: Contents) -> None:
    before = contents()
    result = run("encode", "bar.npz", "out.h5", "--parts", "2", "--labels", "old.npz")
    assert (result.exit_code, "leave out --parts" in result.stderr) == (2, True)
    assert contents() == before


@pytest.mark.parametrize("options", ["silhouettes --seed 3", "spanning-tree", "motion"])
def test_methods(run: Run, options: str) -> None:
    succeed(run("segment", "bar.npz", "out.npz", "--no-picture", "--parts", "2", "--method", *options.split()))
    assert len(read_labels("out.npz", mixseq.read("bar.npz")).names) == 2


def test_pictures_of_numbered_files_have_no_number(run: Run, folder: Path) -> None:
    result = run("segment", "bar.npz", "walk_####.obj", "--parts", "2", "--quiet")
    assert result.exit_code == 0
    assert (folder / "walk-parts.png").exists()
    assert set(read_labels(folder / "walk_####.obj", mixseq.read("bar.npz")).names) == {"part_00", "part_01"}


def test_names_of_many_pieces() -> None:
    """A label that is called like the second piece of another keeps its name."""
    assert numbered(["arm", "arm", "arm_1", "arm", "leg"]) == ("arm", "arm_2", "arm_1", "arm_3", "leg")
    many = numbered(["hair"] * 30_000)  # in a moment
    assert (many[0], many[-1], len(set(many))) == ("hair", "hair_29999", 30_000)


def test_methods_are_those_of_the_code() -> None:
    assert tuple(METHODS) == SEGMENTATIONS


def test_parts_of_a_model_are_its_own(run: Run) -> None:
    sequence = mixseq.read("bar.npz")
    along = sequence.points[0][sequence.faces].mean(axis=1)[:, np.ptp(sequence.points[0], axis=0).argmax()]
    labels = (along > np.quantile(along, 0.2)).astype(np.int64)
    mixseq.save("halves.h5", mixseq.fit(sequence, exact=True, parts=labels))
    text = succeed(run("segment", "halves.h5", "parts.npz", "--no-picture", "--json"))
    assert json.loads(text)["method"] == "model"
    np.testing.assert_array_equal(read_labels("parts.npz", sequence).part_of_face, labels)
