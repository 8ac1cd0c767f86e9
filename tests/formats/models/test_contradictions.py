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
from mixseq_io.hdf5.h5_writing import put_text
from tests.formats.models.model_cases import replace, scaled, with_more, with_zeros


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("pose/offset", scaled(1.1), r"signals/pose: .*not add up to one .*offset adds up to 1\.1 "),
        ("pose/offset", lambda _: np.zeros(0), r"signals/pose/matrix .*floats of shape \(any, 0\)"),
        ("pose/offset", lambda values: values[:-1], r"signals/pose/matrix .*floats of shape \(any, 2\)"),
        (
            "pose/matrix",
            lambda values: values + 0.01,
            r"signals/pose: .*not add up .*rows of matrix to 0\.03",
        ),
        ("pose/matrix", lambda values: values[:-1], r"signals/time/values .*floats of shape \(5, 1\)"),
        ("pose/matrix", lambda values: values.astype(int), r"signals/pose/matrix is int64 .*floats"),
        (
            "time/times",
            lambda values: values[::-1],
            r"signals/time/times does not increase in row 1: .* s after",
        ),
        (
            "time/times",
            lambda values: values[[0, 1, 1, 3, 4]],
            r"signals/time/times does not increase in row 2",
        ),
        ("time/times", lambda values: values[:-1], r"signals/time/values .*floats of shape \(4, 2\)"),
        (
            "time/times",
            scaled(0.9),
            r"signals/time/frames .*0 to 0\.6 s, .*signals/time/times .*0 to 0\.54 s",
        ),
        ("time/times", lambda values: values + 0.1, r"signals/time/times are only from 0\.1 to 0\.7 s"),
        ("time/values", lambda values: values[1:], r"signals/time/values .*floats of shape \(5, 2\)"),
        ("time/frames", lambda values: values[::-1], r"signals/time/frames does not increase in row 1"),
        ("time/frames", lambda _: np.zeros(0), r"signals/time/frames is empty"),
        ("time/frames", lambda values: values - 0.1, r"signals/time/frames has times from -0\.1 to 0\.5 s"),
        ("placement/times", scaled(0.5), r"signals/placement/times are only from 0 to 0\.3 s"),
        (
            "placement/times",
            lambda values: values[::-1],
            r"signals/placement/times does not increase in row 1",
        ),
        ("placement/times", lambda _: np.zeros(0), r"signals/placement/times is empty"),
        ("placement/rotations", lambda values: values[1:], r"placement/rotations .*of shape \(5, 2, 4\)"),
        (
            "placement/rotations",
            lambda values: values[..., 1:],
            r"placement/rotations .*of shape \(5, 2, 4\)",
        ),
        (
            "placement/rotations",
            scaled(0.4),
            r"placement/rotations has quaternions that are nearly zero, no rot",
        ),
        (
            "placement/rotations",
            with_zeros,
            r"placement/rotations has quaternions that are nearly zero, no rot",
        ),
        ("placement/translations", lambda values: values[:, :1], r"placement/translations .*\(5, 2, 3\)"),
        ("shape/lengths", lambda values: values[1:], r"signals/shape/lengths .*floats of shape \(3, "),
        ("shape/angles", lambda values: values[:, 1:], r"signals/shape/angles .*floats of shape \(3, "),
        (
            "shape/sides",
            lambda values: values[:, 1:],
            r"signals/shape/sides .*floats of shape \(3, .*, 2, 3\)",
        ),
        (
            "shape/unposed",
            lambda values: values[:, 1:],
            r"signals/shape/unposed .*floats of shape \(3, 67, 3\)",
        ),
        (
            "shape/unposed",
            lambda values: values.reshape(3, -1),
            r"signals/shape/unposed .*floats of shape \(3, ",
        ),
    ],
)
def test_signals_that_contradict_each_other_are_refused(
    copy: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(copy, f"signals/{name}", change)
    with pytest.raises(FormatError, match=rf"bar\.h5: .*{message}"):
        mixseq.load(copy)


def with_two_signs(values: Any) -> Any:
    """Two shares of a vertex still add up to one."""
    values[np.flatnonzero(values < 1.0)[:2]] = [1.5, -0.5]
    return values


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("weights", scaled(0.9), "must be positive and add up to one for every vertex"),
        ("weights", scaled(-1.0), "must be positive and add up to one for every vertex"),
        ("weights", with_more, "must be positive and add up to one for every vertex"),
        ("weights", with_two_signs, "must be positive and add up to one for every vertex"),
        ("weights", lambda values: values[1:], r"is float64 .*floats of shape \(90\) are expected"),
        ("weights", lambda values: values.astype(int), "is int64 .*floats of shape"),
        ("parts", lambda values: values + 1, "has values outside 0 to 1"),
        ("parts", lambda values: values[1:], r"is int32 .*integers of shape \(90\) are expected"),
        ("sizes", lambda values: values * 0, "has values outside 1"),
    ],
)
def test_shares_that_do_not_fit_are_refused(
    copy: Path, name: str, change: Callable[[Any], Any], message: str
) -> None:
    replace(copy, f"space/shares/{name}", change)
    with pytest.raises(FormatError, match=rf"bar\.h5: space/shares/{name} {message}"):
        mixseq.load(copy)


def test_shares_of_another_number_of_vertices_are_refused(copy: Path) -> None:
    replace(copy, "space/shares/sizes", lambda sizes: np.append(sizes, 1))
    replace(copy, "space/shares/parts", lambda parts: np.append(parts, 0))
    replace(copy, "space/shares/weights", lambda weights: np.append(weights, 1.0))
    with pytest.raises(FormatError, match=r"bar\.h5: space/shares has 68 rows for 67 vertices"):
        mixseq.load(copy)


def test_free_vertices_that_key_shapes_are_not_of_are_refused(copy: Path) -> None:
    """They say which lengths, angles and sides there are."""
    replace(copy, "space/free", lambda values: values[1:])
    with pytest.raises(FormatError, match=r"bar\.h5: signals/shape/lengths is .*; floats of shape \(3, "):
        mixseq.load(copy)


@pytest.mark.parametrize("name", ["mixed", "free"])
def test_other_placements_are_refused(files: Path, tmp_path: Path, name: str) -> None:
    copy = shutil.copy(files / f"{name}.h5", tmp_path / "bar.h5")
    with h5py.File(copy, "r+") as file:
        put_text(file["space"], "placement", "loose")
    with pytest.raises(FormatError, match=r"bar\.h5: the placement 'loose' is not known"):
        mixseq.load(copy)


def test_a_placement_that_the_datasets_are_not_of_is_refused(files: Path, tmp_path: Path) -> None:
    """Each lacks what the other has."""
    for name, other, missing in (
        ("mixed", "free", "space/reference_lengths"),
        ("free", "anchored", "space/shares/sizes"),
    ):
        copy = shutil.copy(files / f"{name}.h5", tmp_path / "bar.h5")
        with h5py.File(copy, "r+") as file:
            put_text(file["space"], "placement", other)
        with pytest.raises(FormatError, match=rf"bar\.h5: {missing} is missing"):
            mixseq.load(copy)


def test_reference_lengths_of_another_segmentation_are_refused(free: Path) -> None:
    replace(free, "space/reference_lengths", lambda values: values[1:])
    with pytest.raises(FormatError, match=r"bar\.h5: space/reference_lengths does not fit the segmentation"):
        mixseq.load(free)


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
    with h5py.File(copy, "r+") as file:
        settings = json.loads(file.attrs["settings"])
        settings = {about: given | change.get(about, {}) for about, given in settings.items()}
        put_text(file, "settings", json.dumps(settings))
    with pytest.raises(FormatError, match=rf"bar\.h5: .*{message}"):
        mixseq.load(copy)


def test_lengths_below_zero_are_refused(files: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(files / "edge.h5", tmp_path / "bar.h5"))
    replace(copy, "space/reference_lengths", scaled(-1.0))
    with pytest.raises(FormatError, match=r"bar\.h5: space/reference_lengths has lengths below zero"):
        mixseq.load(copy)
