"""Finished pictures: their size and rows, and what happens without matplotlib."""

from __future__ import annotations

import io
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import MissingExtraError, SettingsError
from mixseq.pictures.sheets import common_frames, contact_sheet, draw_segmentation, frames_halfway
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Index
from tests.pictures.conftest import LOW_RESOLUTION, set_resolution

pytestmark = pytest.mark.slow

pytest.importorskip("matplotlib")

Draw = Callable[..., bytes]

PAGE_PIXELS = 12 * LOW_RESOLUTION


@pytest.fixture
def sheet(parts: Index, joints: Index) -> Draw:
    """Draw a contact sheet and return the file's content."""

    def draw(original: MeshSequence, decoded: MeshSequence, **options: Any) -> bytes:
        file = io.BytesIO()
        contact_sheet(file, original, decoded, parts, joints, **{"frames": 2, **options})
        return file.getvalue()

    return draw


def png_size(data: bytes) -> tuple[int, int]:
    assert data.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def test_sheet_is_1800_pixels_wide(gem: MeshSequence, sheet: Draw, monkeypatch: pytest.MonkeyPatch) -> None:
    set_resolution(monkeypatch, 150)
    assert png_size(sheet(gem, gem))[0] == 1800


def test_sheet_is_reproducible(gem: MeshSequence, sheet: Draw) -> None:
    assert sheet(gem, gem) == sheet(gem, gem)


def test_sheet_goes_to_a_path(gem: MeshSequence, parts: Index, joints: Index, tmp_path: Path) -> None:
    contact_sheet(tmp_path / "sheet.png", gem, gem, parts, joints, frames=2, title="two")
    assert png_size((tmp_path / "sheet.png").read_bytes())[0] == PAGE_PIXELS


def test_new_frames_get_their_own_row(gem: MeshSequence, sheet: Draw) -> None:
    twice = MeshSequence.from_arrays(gem.points[np.arange(17) // 2], gem.faces, fps=48)
    assert png_size(sheet(gem, twice))[1] > 1.15 * png_size(sheet(gem, gem))[1]


@pytest.mark.parametrize("count", [1, 2])
def test_sheet_of_fewer_frames_than_columns(gem: MeshSequence, sheet: Draw, count: int) -> None:
    short = MeshSequence.from_arrays(gem.points[:count], gem.faces)
    assert png_size(sheet(short, short, frames=6))[0] == PAGE_PIXELS


def test_sheet_refuses_another_mesh(gem: MeshSequence, sheet: Draw) -> None:
    with pytest.raises(SettingsError, match="different faces"):
        sheet(gem, MeshSequence.from_arrays(gem.points, gem.faces[:, ::-1]))


@pytest.mark.parametrize("up", ["X", "Y", "Z"])
def test_segmentation_picture(gem: MeshSequence, parts: Index, joints: Index, up: str) -> None:
    file = io.BytesIO()
    draw_segmentation(file, gem.points[0], gem.faces, parts, joints, up_axis=up, title="gem")
    assert png_size(file.getvalue())[0] == PAGE_PIXELS


def test_without_matplotlib_the_message_names_the_cure(
    gem: MeshSequence, sheet: Draw, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mixseq\[plot\]'"):
        sheet(gem, gem)


def halved(gem: MeshSequence, frames: int = 9) -> MeshSequence:
    """Put a frame between every two of the first few."""
    times = np.linspace(gem.times[0], gem.times[frames - 1], 2 * frames - 1)
    return MeshSequence.from_arrays(gem.points[np.arange(len(times)) // 2], gem.faces, times=times)


def test_frames_are_matched_by_time(gem: MeshSequence) -> None:
    assert common_frames(gem, halved(gem), 4) == ([0, 2, 4, 6], [0, 4, 8, 12])


def test_all_frames_if_there_are_few(gem: MeshSequence) -> None:
    assert common_frames(gem, halved(gem, frames=2), 6) == ([0, 1], [0, 2])


def test_times_must_meet(gem: MeshSequence) -> None:
    later = MeshSequence.from_arrays(gem.points, gem.faces, times=gem.times + 0.01)
    with pytest.raises(SettingsError, match="no frame at the same time"):
        common_frames(gem, later, 4)


def test_frames_between(gem: MeshSequence) -> None:
    assert frames_halfway(gem, gem, [0, 4, 8]) == {}
    assert frames_halfway(gem, halved(gem), [0, 4, 8]) == {0: 1, 1: 9}
    assert frames_halfway(gem, halved(gem, frames=3), [0, 4, 8]) == {0: 1}
