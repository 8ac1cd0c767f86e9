"""What charts share: formats and their files, axes, frames to be numbered, a style of our own."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import OutputError
from mixseq.pictures.charts import (
    Format,
    chart_style,
    log_axis,
    new_page,
    picture_format,
    round_frames,
    save_page,
    time_axis,
)

pytest.importorskip("matplotlib")


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("a.png", "png"),
        ("a.PNG", "png"),
        (Path("b.d/a.svg"), "svg"),
        ("a.b.Svg", "svg"),
        (io.BytesIO(), "png"),
    ],
)
def test_format_by_extension(target: Any, expected: Format) -> None:
    assert picture_format(target) == expected


def test_chosen_format_comes_first() -> None:
    assert picture_format(io.BytesIO(), "svg") == picture_format("a.png", "svg") == "svg"


@pytest.mark.parametrize("target", ["a.pdf", "a", "png", Path("a.jpeg")])
def test_other_formats_are_refused(target: Any) -> None:
    with pytest.raises(OutputError, match=f"{target}: pictures are PNG or SVG files; end the name in"):
        picture_format(target)


def picture(file_format: Format, title: str = "page") -> bytes:
    file = io.BytesIO()
    with chart_style():
        page = new_page(3, 2, title)
        page.subplots().plot([0, 1], [0, 1], clip_on=True)
        save_page(page, file, file_format)
    return file.getvalue()


@pytest.mark.parametrize("file_format", ["png", "svg"])
def test_equal_pages_are_equal_files(file_format: Format) -> None:
    first = picture(file_format)
    assert first == picture(file_format)
    assert first.startswith({"png": b"\x89PNG", "svg": b"<?xml"}[file_format])
    assert b"dc:date" not in first
    assert b"dc:creator" not in first
    assert b"Software" not in first


def test_style_of_the_user_changes_nothing() -> None:
    import matplotlib

    plain = picture("png")
    with matplotlib.rc_context({"axes.facecolor": "black", "font.size": 20, "text.usetex": False}):
        assert picture("png") == plain
        assert matplotlib.rcParams["font.size"] == 20


@pytest.mark.parametrize("title", ["$ 3 $ x_", "\u72fc", "_"])
def test_titles_are_not_formulas(title: str) -> None:
    assert picture("png", title) == picture("png", title)


def test_log_axis_has_whole_decades(ax: Any) -> None:
    log_axis(ax, np.array([0.02, 0.3]))
    assert (ax.get_yscale(), ax.get_ylim()) == ("log", (0.01, 1.0))
    log_axis(ax, np.array([5.0, 6.0]))
    np.testing.assert_allclose(ax.get_ylim(), (0.1, 10.0))


def test_time_axis_leaves_space_for_dots(ax: Any) -> None:
    time_axis(ax, 1.0, 2.0)
    np.testing.assert_allclose(ax.get_xlim(), (0.99, 2.01))
    time_axis(ax, 1.0, 1.0)  # of a single frame
    assert ax.get_xlabel() == "time (s)"


@pytest.mark.parametrize("count", range(1, 250, 7))
def test_numbered_frames(count: int) -> None:
    frames = round_frames(count, 10)
    assert frames[0] == 0
    assert frames[-1] == count - 1
    assert 1 <= len(frames) <= 11
    assert frames == sorted(set(frames))
    assert len(set(np.diff(frames[:-1]))) <= 1
