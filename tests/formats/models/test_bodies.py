"""Models of several bodies in HDF5: nothing is lost, shared signals are stored once, and damage is told."""

from __future__ import annotations

import shutil
from dataclasses import replace as replace_fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError, MixseqWarning, OutputError
from mixseq.operations import reverse
from mixseq.signals.model import Model
from mixseq_io.hdf5.datasets import MAX_BODIES
from tests.formats.models.model_cases import GOLDEN, assert_equal, replace

HERD = GOLDEN / "model-v1-bodies.h5"


@pytest.fixture
def model() -> Model:
    return mixseq.load(HERD)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A file to be spoilt."""
    return Path(shutil.copy(HERD, tmp_path / "herd.h5"))


def test_nothing_is_lost(model: Model, tmp_path: Path) -> None:
    """Also with another body in front, and after an edit."""
    for number, herd in enumerate((model, model.body("finer"), reverse(model.body("shuffled")))):
        mixseq.save(tmp_path / f"{number}.h5", herd)
        again = mixseq.load(tmp_path / f"{number}.h5")
        assert again.body_names == herd.body_names
        for name in herd.body_names:
            assert_equal(again.body(name), herd.body(name))


def test_signals_are_stored_once(model: Model, tmp_path: Path) -> None:
    with h5py.File(HERD) as file:
        assert set(file["bodies"]) == {"0", "1"}
        for body in file["bodies"].values():
            assert set(body["signals"]) == {"shape"}


def test_a_file_without_bodies_has_no_group_of_them(model: Model, tmp_path: Path) -> None:
    mixseq.save(tmp_path / "one.h5", replace_fields(model, bodies=()))
    with h5py.File(tmp_path / "one.h5") as file:
        assert "bodies" not in file
    assert mixseq.load(tmp_path / "one.h5").bodies == ()


def test_frames_are_those_of_the_first_body(model: Model) -> None:
    with pytest.warns(MixseqWarning, match="'bar': further bodies, shuffled, finer, are left out"):
        frames = mixseq.read(HERD)
    np.testing.assert_array_equal(frames.points, model.sample().points)
    with pytest.warns(MixseqWarning, match="take them by Model.body"):
        mixseq.compare(model, frames)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("bodies/0/turn", lambda values: 0 * values, "the body 'shuffled' have quaternions that are nearly zero"),
        ("bodies/1/rotations", lambda values: 0 * values, "the body 'finer' have quaternions that are nearly zero"),
        ("bodies/1/rotations", lambda values: np.tile(values, (2, 1)), r"of shape \(2, 4\); floats of shape \(1, 4\)"),
        ("bodies/0/shifts", lambda values: values + np.nan, "is not finite"),
        ("bodies/1/part_turns", lambda values: 3 * values, "beyond 2; it is damaged"),
        ("bodies/0/signals/shape/unposed", lambda values: values[1:], "floats of shape"),
        ("bodies/0/space/reference", lambda values: values[1:], "floats of shape"),
    ],
)
def test_damage_is_told(copy: Path, name: str, change: Any, message: str) -> None:
    replace(copy, name, change)
    with pytest.raises(FormatError, match=message):
        mixseq.load(copy)


def test_missing_datasets_and_groups_are_told(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        del file["bodies/1/shifts"]
    with pytest.raises(FormatError, match="shifts is missing"):
        mixseq.load(copy)
    with h5py.File(copy, "r+") as file:
        del file["bodies/0"]
    with pytest.raises(FormatError, match="bodies/0"):
        mixseq.load(copy)


def test_names_are_unique(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file["bodies/1"].attrs["name"] = np.bytes_(b"shuffled")
    with pytest.raises(FormatError, match="two bodies have the same name"):
        mixseq.load(copy)


def test_what_files_cannot_hold_is_refused(model: Model, tmp_path: Path) -> None:
    crowd = tuple(
        replace_fields(model.bodies[0], header=replace_fields(model.bodies[0].header, name=f"{number}"))
        for number in range(MAX_BODIES + 1)
    )
    with pytest.raises(OutputError, match="has 101 further bodies; a file holds 100"):
        mixseq.save(tmp_path / "crowd.h5", replace_fields(model, bodies=crowd))
