"""What is kept: frames up to a limit, models until their files change."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mixseq.blender.motion import Frames, Models
from mixseq.errors import FormatError
from mixseq.signals.model import Model
from mixseq.types import Single

SIZE = 12
"""Bytes of a frame of one vertex."""


class Counted:
    """Frames that are made, and how often."""

    def __init__(self) -> None:
        self.made: list[int] = []

    def __call__(self, number: int) -> Callable[[], Single]:
        def make() -> Single:
            self.made.append(number)
            return np.full((1, 3), number, dtype=np.float32)

        return make


def test_frames_are_made_once() -> None:
    frames, counted = Frames(), Counted()
    for _ in range(2):
        np.testing.assert_array_equal(frames.get("here", counted(7)), [[7, 7, 7]])
    assert counted.made == [7]
    assert frames.size == SIZE


def test_those_used_last_are_kept() -> None:
    frames, counted = Frames(2 * SIZE), Counted()
    for number in (0, 1, 0, 2, 0, 1):
        frames.get(number, counted(number))
    assert counted.made == [0, 1, 2, 1]
    assert frames.size == 2 * SIZE


def test_one_frame_is_kept_however_large_it_is() -> None:
    frames, counted = Frames(1), Counted()
    for number in (0, 0, 1, 1):
        frames.get(number, counted(number))
    assert counted.made == [0, 1]


def test_a_frame_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Frames().get(0, Counted()(0))[0] = 1


def test_what_is_forgotten_is_made_again() -> None:
    frames, counted = Frames(), Counted()
    frames.get(0, counted(0))
    frames.clear()
    assert frames.size == 0
    frames.get(0, counted(0))
    assert counted.made == [0, 0]


def test_models_are_read_again_when_their_files_change(tmp_path: Path, bar_model: Model) -> None:
    path, read = tmp_path / "walk.h5", []

    def load(path: Path) -> Model:
        read.append(path.read_text())
        return bar_model

    models = Models(load)
    for text in ("one", "three"):
        path.write_text(text)
        assert models.get(path) is models.get(path) is bar_model
    assert read == ["one", "three"]


def test_damage_is_read_once_and_told_every_time(tmp_path: Path) -> None:
    path, tries = tmp_path / "walk.h5", []

    def load(path: Path) -> Model:
        tries.append(path)
        raise FormatError(f"{path} is damaged")

    models = Models(load)
    path.write_text("damage")
    for _ in range(2):
        with pytest.raises(FormatError, match="is damaged"):
            models.get(path)
    assert len(tries) == 1
    os.utime(path, ns=(1, 1))
    with pytest.raises(FormatError, match="is damaged"):
        models.get(path)
    assert len(tries) == 2


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"none\.h5: No such file or directory; choose the file again"):
        Models(lambda path: pytest.fail("nothing to read")).get(tmp_path / "none.h5")
