"""Charts of signals show what the model holds: closed forms where there are some."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import OutputError, SettingsError
from mixseq.pictures.charts import (
    Format,
    chart_style,
    check_frames,
    draw_coefficients,
    draw_embedding,
    draw_singular_values,
    embedding_limits,
    log_axis,
    new_page,
    picture_format,
    round_frames,
    save_page,
    singular_values,
    time_axis,
)
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model

pytest.importorskip("matplotlib")

FRAMES = 8


@pytest.fixture(scope="module")
def ellipse() -> MeshSequence:
    """A triangle whose corners move apart and up: two orthogonal motions, of sizes 3 and 1 diagonals."""
    phase = 2 * np.pi * np.arange(FRAMES) / FRAMES
    apart, up = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 0.0]]), np.array([[0, 0, 1], [0, 0, 1], [0, 0, 1.0]])
    points = np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0.0]]) + 7 * apart  # the first frame has a diagonal
    swing = 7 * (np.cos(phase) - 1)[:, None, None] * apart + 2 * np.sin(phase)[:, None, None] * up
    return MeshSequence.from_arrays(points + swing, [[0, 1, 2]], fps=10)


@pytest.fixture(scope="module")
def model(ellipse: MeshSequence) -> Model:
    return fit(ellipse, exact=True, space="vertex")


@pytest.fixture(scope="module")
def still(ellipse: MeshSequence) -> Model:
    return fit(ellipse.with_points(np.repeat(ellipse.points[:1], FRAMES, axis=0)), exact=True, space="vertex")


def sizes_of(ellipse: MeshSequence) -> list[float]:
    """Norms over all frames and vertices of both motions: mean squares of cosine and sine are one half."""
    root = np.sqrt(FRAMES / 2)
    return [7 * np.sqrt(2) * root / ellipse.diagonal, 2 * np.sqrt(3) * root / ellipse.diagonal]


def test_singular_values_of_two_motions(ellipse: MeshSequence) -> None:
    model = fit(ellipse, exact=True, space="vertex")
    np.testing.assert_allclose(singular_values(model), sizes_of(ellipse), rtol=1e-9)


def test_singular_values_whatever_the_coordinates(model: Model) -> None:
    from dataclasses import replace

    from mixseq.signals.curve import Curve
    from mixseq.signals.pose import PoseMap

    skew = np.array([[2.0, 0.3], [-0.5, 0.1]])
    other = replace(
        model,
        time=Curve(model.time.times, model.time.values @ np.linalg.inv(skew)),
        pose=PoseMap(model.pose.offset, skew @ model.pose.matrix),
    )
    np.testing.assert_allclose(singular_values(other), singular_values(model), rtol=1e-9)


def test_chart_of_singular_values(ellipse: MeshSequence, model: Model, ax: Any) -> None:
    draw_singular_values(ax, model)
    first, second = sizes_of(ellipse)
    modes, rest = ax.get_lines()
    np.testing.assert_allclose(modes.get_xydata(), [[1, first], [2, second]], rtol=1e-9)
    np.testing.assert_allclose(rest.get_xydata(), [[1, second]], rtol=1e-9)
    assert ax.get_yscale() == "log"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("mode", "size (diagonals)")
    (share,) = ax.child_axes
    ax.figure.draw_without_rendering()
    low, high = np.array(ax.get_ylim()) * 100 / np.hypot(first, second)
    np.testing.assert_allclose(share.get_ylim(), (low, high))
    assert share.get_ylabel() == "share of the whole (%)"


def test_layout_shows_curve_and_frames(model: Model, ax: Any) -> None:
    draw_embedding(ax, model)
    curve, start, end = (line.get_xydata() for line in ax.get_lines())
    frames = np.asarray(ax.collections[0].get_offsets())
    np.testing.assert_allclose(frames, model.embedding(model.times))
    np.testing.assert_allclose([start[0], end[0]], frames[[0, -1]])
    for frame in frames:
        assert np.linalg.norm(curve - frame, axis=1).min() < 0.02
    np.testing.assert_allclose(ax.collections[0].get_array(), model.times)
    left, right, bottom, top = embedding_limits(model)
    assert (*ax.get_xlim(), *ax.get_ylim()) == (left, right, bottom, top)
    assert ((curve > [left, bottom]) & (curve < [right, top])).all()
    assert ax.get_aspect() == 1
    assert "(diagonals)" in ax.get_xlabel() and "(diagonals)" in ax.get_ylabel()
    (bar,) = ax.child_axes
    assert bar.get_ylabel() == "time (s)"


def test_layout_numbers_frames(model: Model, ax: Any) -> None:
    draw_embedding(ax, model)
    assert [text.get_text() for text in ax.texts] == ["0 start", *map(str, range(1, FRAMES - 1)), "7 end"]


def test_layout_numbers_the_frames_that_are_chosen(model: Model, ax: Any) -> None:
    draw_embedding(ax, model, [5, 2, 5, 0])
    assert [text.get_text() for text in ax.texts] == ["0 start", "2", "5"]


def test_layout_refuses_frames_that_are_not_there(model: Model, ax: Any) -> None:
    with pytest.raises(SettingsError, match="there is no frame 8; choose frames from 0 to 7"):
        draw_embedding(ax, model, [0, 8])
    with pytest.raises(SettingsError, match="there is no frame -1"):
        check_frames([-1], FRAMES)


def test_coefficients_with_knots(model: Model, ax: Any) -> None:
    draw_coefficients(ax, model)
    _, *lines = ax.get_lines()
    assert len(lines) == 4
    for number, (line, knots) in enumerate(zip(lines[::2], lines[1::2], strict=True)):
        times = line.get_xdata()
        np.testing.assert_allclose(line.get_ydata(), model.time(times)[:, number])
        np.testing.assert_allclose(knots.get_xdata(), model.time.times)
        np.testing.assert_allclose(knots.get_ydata(), model.time.values[:, number])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time (s), frames 0 to 7", "coordinate (diagonals)")
    legend = ax.get_legend()
    assert legend.get_title().get_text() == "15 knots"  # 8 frames, and the middles between them
    assert [text.get_text() for text in legend.get_texts()] == ["coordinate 1", "coordinate 2"]


def test_coefficients_are_the_largest(bar_model: Model, bent_bar: MeshSequence, ax: Any) -> None:
    many = fit(
        bent_bar.with_points(bent_bar.points + 0.1 * np.random.default_rng(0).normal(size=bent_bar.points.shape)),
        exact=True,
        space="vertex",
    )
    assert many.time.dim == 3
    draw_coefficients(ax, many)
    assert len(ax.get_legend().get_texts()) == 3


def test_charts_of_what_stands_still(still: Model, ax: Any) -> None:
    assert singular_values(still).tolist() == []
    draw_coefficients(ax, still)
    draw_singular_values(ax, still)
    assert {text.get_text() for text in ax.texts} == {"the model has no shape modes"}
    left, right, bottom, top = embedding_limits(still)
    assert left < right and bottom < top


# What charts share: formats and their files, axes, frames to be numbered, a style of our own


@pytest.mark.parametrize(
    ("target", "expected"),
    [("a.png", "png"), ("a.PNG", "png"), (Path("b.d/a.svg"), "svg"), ("a.b.Svg", "svg"), (io.BytesIO(), "png")],
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


def test_numbered_frames() -> None:
    for count in range(1, 250, 7):
        frames = round_frames(count, 10)
        assert frames[0] == 0
        assert frames[-1] == count - 1
        assert 1 <= len(frames) <= 11
        assert frames == sorted(set(frames))
        assert len(set(np.diff(frames[:-1]))) <= 1
