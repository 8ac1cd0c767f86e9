"""Charts of signals show what the model holds: closed forms where there are some."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.pictures.charts import (
    draw_coefficients,
    draw_embedding,
    draw_singular_values,
    embedding_limits,
    existing_frames,
    singular_values,
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


@pytest.mark.parametrize("pose", ["modes", "keys"])
def test_singular_values_of_two_motions(ellipse: MeshSequence, pose: Any) -> None:
    model = fit(ellipse, exact=True, space="vertex", pose=pose)
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
    with pytest.raises(SettingsError, match="there is no frame 8; frames are 0 to 7"):
        draw_embedding(ax, model, [0, 8])
    with pytest.raises(SettingsError, match="there is no frame -1"):
        existing_frames([-1], FRAMES)


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
        bent_bar.with_points(
            bent_bar.points + 0.1 * np.random.default_rng(0).normal(size=bent_bar.points.shape)
        ),
        exact=True,
        space="vertex",
        pose="keys",
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
