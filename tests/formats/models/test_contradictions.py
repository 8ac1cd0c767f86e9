"""Models in HDF5: signals, spaces and settings that contradict each other are refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError
from mixseq_io.hdf5.datasets import write_text
from tests.formats.models.model_cases import replace, scaled, with_more, with_zeros


def without_one(values: Any) -> Any:
    """One part, or relation, has no rotation in any key shape."""
    values[:, 1] = 0.0
    return values


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("pose/offset", scaled(1.1), r"signals/pose: .*not add up to one .*offset adds up to 1\.1 "),
        ("pose/offset", lambda _: np.zeros(0), r"signals/pose/matrix .*floats of shape \(any, 0\)"),
        ("pose/offset", lambda values: values[:-1], r"signals/pose/matrix .*floats of shape \(any, 2\)"),
        ("pose/matrix", lambda values: values + 0.01, r"signals/pose: .*not add up .*rows of matrix to 0\.03"),
        ("pose/matrix", lambda values: values[:-1], r"signals/time/values .*floats of shape \(5, 1\)"),
        ("pose/matrix", lambda values: values.astype(int), r"signals/pose/matrix is int64 .*floats"),
        ("time/times", lambda values: values[::-1], r"signals/time/times does not increase in row 1: .* s after"),
        ("time/times", lambda values: values[[0, 1, 1, 1, 4]], r"signals/time/times does not increase in row 2"),
        ("time/times", lambda values: values[:-1], r"signals/time/values .*floats of shape \(4, 2\)"),
        ("time/times", scaled(0.9), r"signals/time/frames .*0 to 0\.6 s, .*signals/time/times .*0 to 0\.54 s"),
        ("time/times", lambda values: values + 0.1, r"signals/time/times are only from 0\.1 to 0\.7 s"),
        ("time/values", lambda values: values[1:], r"signals/time/values .*floats of shape \(5, 2\)"),
        ("time/frames", lambda values: values[::-1], r"signals/time/frames does not increase in row 1"),
        ("time/frames", lambda _: np.zeros(0), r"signals/time/frames is empty"),
        ("time/frames", lambda values: values - 0.1, r"signals/time/frames has times from -0\.1 to 0\.5 s"),
        ("placement/times", scaled(0.5), r"signals/placement/times are only from 0 to 0\.3 s"),
        ("placement/times", lambda values: values[::-1], r"signals/placement/times does not increase in row 1"),
        ("placement/times", lambda _: np.zeros(0), r"signals/placement/times is empty"),
        ("placement/rotations", lambda values: values[1:], r"placement/rotations .*of shape \(5, 1, 4\)"),
        ("placement/rotations", lambda values: values[..., 1:], r"placement/rotations .*of shape \(5, 1, 4\)"),
        ("placement/rotations", scaled(0.4), r"placement/rotations has quaternions that are nearly zero"),
        ("placement/rotations", with_zeros, r"placement/rotations has quaternions that are nearly zero"),
        ("placement/translations", lambda values: values[:, :0], r"placement/translations .*\(5, 1, 3\)"),
        ("correction/times", scaled(0.5), r"signals/correction/times are only from 0 to 0\.3 s"),
        ("correction/times", lambda values: values + 0.1, r"correction/times are only from 0\.1 to 0\.7 s"),
        ("correction/times", lambda values: values[::-1], r"signals/correction/times does not increase in row 1"),
        ("correction/times", lambda _: np.zeros(0), r"signals/correction/times is empty"),
        ("correction/rotations", lambda values: values[1:], r"correction/rotations .*shape \(5, 2, 3\)"),
        (
            "correction/rotations",
            lambda values: np.zeros((5, 2, 4)),
            r"signals/correction/rotations .*shape \(5, 2, 3\)",
        ),
        (
            "correction/translations",
            lambda values: values[:, :1],
            r"signals/correction/translations .*shape \(5, 2, 3\)",
        ),
        ("shape/lengths", lambda values: values[1:], r"signals/shape/lengths .*floats of shape \(3, "),
        ("shape/angles", lambda values: values[:, 1:], r"signals/shape/angles .*floats of shape \(3, "),
        ("shape/part_rotations", lambda values: values[:, :1], r"part_rotations .*shape \(3, 2, 4\)"),
        ("shape/part_rotations", without_one, "signals/shape/part_rotations has quaternions that are always zero"),
        ("shape/part_centres", lambda values: values[:2], r"part_centres .*shape \(3, 2, 3\)"),
        ("shape/relation_rotations", lambda values: values[:, :1], r"relation_rotations .*\(3, 2, 4\)"),
        (
            "shape/relation_rotations",
            without_one,
            "signals/shape/relation_rotations has quaternions that are always zero",
        ),
        ("shape/relation_points", lambda values: values[..., :2], r"relation_points .*\(3, 2, 3\)"),
        ("shape/unposed", lambda values: values[:, 1:], r"signals/shape/unposed .*floats of shape \(3, 67, 3\)"),
        ("shape/unposed", lambda values: values.reshape(3, -1), r"signals/shape/unposed .*floats of shape \(3, "),
    ],
)
def test_signals_that_contradict_each_other_are_refused(
    copy: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(copy, f"signals/{name}", change)
    with pytest.raises(FormatError, match=rf"bar\.h5: .*{message}"):
        mixseq.load(copy)


def test_quaternions_of_one_key_shape_may_be_zero(copy: Path) -> None:
    """They are blended: the mean of a part that turns twice about itself is zero."""

    def change(values: Any) -> Any:
        values[0, 1] = 0.0
        return values

    replace(copy, "signals/shape/part_rotations", change)
    model = mixseq.load(copy)
    assert not model.mixed.split_poses(model.shapes[:, -model.mixed.pose_dim :]).rotations[0, 1].any()


def with_two_signs(values: Any) -> Any:
    """Two weights of a vertex still add up to one."""
    values[np.flatnonzero(values < 1.0)[:2]] = [1.5, -0.5]
    return values


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("weights", scaled(0.9), "must be positive and add up to one for every vertex"),
        ("weights", scaled(-1.0), "must be positive and add up to one for every vertex"),
        ("weights", with_more, "must be positive and add up to one for every vertex"),
        ("weights", with_two_signs, "must be positive and add up to one for every vertex"),
        ("weights", lambda values: values[1:], r"is float64 .*floats of shape \(89\) are expected"),
        ("weights", lambda values: values.astype(int), "is int64 .*floats of shape"),
        ("parts", lambda values: values + 1, "has values outside 0 to 1"),
        ("parts", lambda values: values[1:], r"is int32 .*integers of shape \(89\) are expected"),
        ("sizes", lambda values: values * 0, "has values outside 1"),
    ],
)
def test_skinning_weights_that_do_not_fit_are_refused(
    copy: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(copy, f"space/skinning/{name}", change)
    with pytest.raises(FormatError, match=rf"bar\.h5: space/skinning/{name} {message}"):
        mixseq.load(copy)


def test_skinning_weights_of_another_number_of_vertices_are_refused(copy: Path) -> None:
    replace(copy, "space/skinning/sizes", lambda sizes: np.append(sizes, 1))
    replace(copy, "space/skinning/parts", lambda parts: np.append(parts, 0))
    replace(copy, "space/skinning/weights", lambda weights: np.append(weights, 1.0))
    with pytest.raises(FormatError, match=r"bar\.h5: space/skinning has 68 rows for 67 vertices"):
        mixseq.load(copy)


def test_joint_faces_that_key_shapes_are_not_of_are_refused(copy: Path) -> None:
    """They say which lengths and angles there are."""
    replace(copy, "space/joint_faces", lambda values: values[3:])
    with pytest.raises(FormatError, match=r"bar\.h5: signals/shape/lengths is .*; floats of shape \(3, "):
        mixseq.load(copy)


@pytest.mark.parametrize("value", [-1, 130])
def test_joint_faces_out_of_range_are_refused(copy: Path, value: int) -> None:
    replace(copy, "space/joint_faces", lambda values: np.append(values, value))
    with pytest.raises(FormatError, match=r"bar\.h5: space/joint_faces has values outside 0 to 129"):
        mixseq.load(copy)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda values: values[1:], "does not fit the segmentation"),
        (lambda values: np.append(values, 1.0), "does not fit the segmentation"),
        (lambda values: values[:, None], r"is float64 of shape \(2, 1\); floats of shape \(any\) are expected"),
        (lambda values: values.astype(int), r"is int64 of shape \(2,\); floats of shape"),
        (scaled(0.0), "has numbers outside 1e-08 to 10000"),
        (scaled(-1.0), "has numbers outside 1e-08 to 10000"),
        (scaled(1e9), "has numbers outside 1e-08 to 10000"),
    ],
)
@pytest.mark.parametrize("name", ["turns", "centres", "relation_turns", "relation_points"])
def test_steadiness_that_does_not_fit_is_refused(
    copy: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(copy, f"space/steadiness/{name}", change)
    with pytest.raises(FormatError, match=rf"bar\.h5: space/steadiness/{name} {message}"):
        mixseq.load(copy)


@pytest.mark.parametrize("name", ["mixed", "free"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"placement": "loose"}, "the placement 'loose' is not known"),
        ({"placement": ["free"]}, r"the placement \['free'\] is not known"),
        ({"glue": 1}, "the setting 'glue' is missing or not known"),
        ({"share": 1.5}, r"share is 1\.5; a number from 0 to 1 is expected"),
        ({"share": float("nan")}, "share is nan; a number from 0 to 1"),
        ({"share": "half"}, "share is 'half'; a number from 0 to 1"),
        ({"share": None}, "share is None; a number from 0 to 1"),
        ({"hold": 0.0}, r"hold is 0\.0; a positive weight from 1e-06 to 1e\+06"),
        ({"hold": 1e300}, r"hold is 1e\+300; a positive weight"),
        ({"relations": -1.0}, r"relations is -1\.0; a positive weight"),
        ({"relations": float("inf")}, "relations is inf; a positive weight"),
        ({"relations": [1.0]}, r"relations is \[1\.0\]; a positive weight"),
        ({"steps": -1}, "steps is -1; a whole number of 0 or more"),
        ({"steps": 1.5}, r"steps is 1\.5; a whole number of 0 or more"),
    ],
    ids=str,
)
def test_settings_of_projections_are_checked(
    files: Path, tmp_path: Path, name: str, change: dict[str, Any], message: str
) -> None:
    copy = shutil.copy(files / f"{name}.h5", tmp_path / "bar.h5")
    change_settings(copy, {"projection": change})
    with pytest.raises(FormatError, match=rf"bar\.h5: .*{message}"):
        mixseq.load(copy)


def test_settings_of_projections_that_are_missing_are_refused(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        settings = json.loads(file.attrs["settings"])
        del settings["projection"]["hold"]
        write_text(file, "settings", json.dumps(settings))
    with pytest.raises(FormatError, match=r"bar\.h5: the setting 'hold' is missing or not known"):
        mixseq.load(copy)


def change_settings(path: Path | str, change: dict[str, Any]) -> None:
    """Store other settings, by what they are about."""
    with h5py.File(path, "r+") as file:
        settings = json.loads(file.attrs["settings"])
        settings = {about: given | change.get(about, {}) for about, given in settings.items()}
        write_text(file, "settings", json.dumps(settings))


@pytest.mark.parametrize(
    ("space", "change", "message"),
    [
        ("edge", {"edge": {"projection": "glue"}}, "projection is 'glue'"),
        ("edge", {"edge": {"glue": 1}}, "the setting 'glue' is missing or not known"),
        ("edge", {"shell": {"glue": 1}}, "the setting 'glue' is missing or not known"),
        ("edge", {"shell": {"iterations": "many"}}, "iterations is 'many'; a whole number of 0 or more"),
        ("edge", {"shell": {"bending": -1.0}}, r"bending is -1\.0; a number of 0 or more"),
        ("edge", {"edge": {"projection": "dso", "volume": 1.0}}, r"signals/shape/volumes .*shape \(3, 1\)"),
    ],
)
def test_settings_of_edge_spaces_are_checked(
    files: Path, tmp_path: Path, space: str, change: dict[str, Any], message: str
) -> None:
    copy = shutil.copy(files / f"{space}.h5", tmp_path / "bar.h5")
    change_settings(copy, change)
    with pytest.raises(FormatError, match=rf"bar\.h5: .*{message}"):
        mixseq.load(copy)


def test_lengths_below_zero_are_refused(files: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(files / "edge.h5", tmp_path / "bar.h5"))
    replace(copy, "space/reference_lengths", scaled(-1.0))
    with pytest.raises(FormatError, match=r"bar\.h5: space/reference_lengths has negative lengths"):
        mixseq.load(copy)
