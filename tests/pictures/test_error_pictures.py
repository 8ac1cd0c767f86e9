"""Errors of a model: distances that are known, and what is drawn of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixseq.compression.numbering import walk_numbering
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.pictures.models import (
    MIN_DRAWN_ERROR,
    VertexErrors,
    _is_hidden,
    add_error_bar,
    draw_frame_errors,
    draw_vertex_errors,
    drawn_frames,
    vertex_errors,
)
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from tests.meshes import bar

FRAMES = 20  # more than one block


@pytest.fixture(scope="module")
def original() -> MeshSequence:
    return bar(sides=5, rings=4, frames=FRAMES)


@pytest.fixture(scope="module")
def model(original: MeshSequence) -> Model:
    """A model whose vertex 3 is off by 0.2 diagonals in frame 11, and by 0.1 in frame 17."""
    points = original.points.astype(np.float64)
    points[11, 3] += 0.2 * original.diagonal * np.array([0.6, 0, 0.8])
    points[17, 3] += 0.1 * original.diagonal * np.array([0, -1, 0])
    return fit(original.with_points(points), exact=True, space="vertex")


def test_errors_that_are_known(model: Model, original: MeshSequence) -> None:
    errors = vertex_errors(model, original, frames=[2, 17])
    largest = np.zeros(FRAMES)
    largest[[11, 17]] = 0.2, 0.1
    np.testing.assert_allclose(errors.largest, largest, atol=1e-10)
    np.testing.assert_allclose(errors.rms, largest / np.sqrt(original.vertex_count), atol=1e-10)
    by_vertex = np.zeros(original.vertex_count)
    by_vertex[3] = 0.2
    np.testing.assert_allclose(errors.by_vertex, by_vertex, atol=1e-10)
    assert errors.worst == 11
    assert sorted(errors.by_frame) == [2, 11, 17]
    np.testing.assert_allclose(errors.by_frame[17], by_vertex / 2, atol=1e-10)


def test_errors_tell_how_far_they_are(model: Model, original: MeshSequence) -> None:
    told = []
    vertex_errors(model, original, progress=lambda done, total, what: told.append((done, total)))
    assert told == [(8, FRAMES), (16, FRAMES), (FRAMES, FRAMES)]


def test_another_mesh_is_refused(model: Model, original: MeshSequence) -> None:
    turned = MeshSequence.from_arrays(original.points, original.faces[:, ::-1], fps=10)
    with pytest.raises(SettingsError, match="or other faces; errors need the same topology"):
        vertex_errors(model, turned)


def test_an_original_may_have_the_numbers_of_a_compressed_file(model: Model, original: MeshSequence) -> None:
    """Errors are in the order of the original, which is drawn."""
    free = walk_numbering(original.polygons, [original.vertex_count], vertices=True)
    assert free.order == "free"
    with pytest.warns(MixseqWarning, match="^vertices of .* have other numbers in"):
        errors = vertex_errors(model, free.renumber_frames(original))
    np.testing.assert_array_equal(errors.by_vertex, vertex_errors(model, original).by_vertex[free.vertices])


def test_times_outside_the_model_are_refused(model: Model, original: MeshSequence) -> None:
    late = MeshSequence.from_arrays(original.points, original.faces, times=original.times + 1, fps=10)
    with pytest.raises(SettingsError, match="outside the sequence"):
        vertex_errors(model, late)


def test_chart_of_frames(model: Model, original: MeshSequence, ax: Any) -> None:
    pytest.importorskip("matplotlib")
    errors = vertex_errors(model, original)
    draw_frame_errors(ax, errors, original.times, tolerance=0.05)
    largest, rms, tolerance, worst = ax.get_lines()
    np.testing.assert_allclose(largest.get_ydata(), np.maximum(errors.largest, MIN_DRAWN_ERROR))
    np.testing.assert_allclose(rms.get_ydata(), np.maximum(errors.rms, MIN_DRAWN_ERROR))
    assert set(tolerance.get_ydata()) == {0.05}
    np.testing.assert_allclose(worst.get_xydata(), [[1.1, 0.2]])
    assert ax.get_yscale() == "log"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time (s)", "vertex error (diagonals)")
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["largest", "root mean square", "tolerance, 0.05", "worst frame, 11"]


def test_no_error_at_all_is_drawn(original: MeshSequence, ax: Any) -> None:
    pytest.importorskip("matplotlib")
    errors = vertex_errors(fit(original, exact=True, space="vertex"), original)
    zero = type(errors)(0 * errors.largest, 0 * errors.rms, 0 * errors.by_vertex, 0, errors.by_frame)
    draw_frame_errors(ax, zero, original.times)
    assert ax.get_ylim()[0] <= MIN_DRAWN_ERROR


def test_pictures_of_vertices() -> None:
    figure = pytest.importorskip("matplotlib.figure").Figure()
    original = bar(sides=5, rings=4, frames=3)
    off = np.arange(3.0)[:, None] * (np.arange(original.vertex_count) == 3)  # in frame 2, twice that of frame 1
    errors = VertexErrors(off.max(axis=1), off.mean(axis=1), off.max(axis=0), 2, {1: off[1], 2: off[2]})
    panels = figure.subplots(3, 2)
    heat = draw_vertex_errors(panels.tolist(), errors, original, [1, 2])
    assert heat.get_clim() == (0, 2)
    assert [panel.get_title() for panel in panels[:, 0]] == [
        "Error per vertex: largest of all frames\nmost at vertex 3",
        "Error per vertex: frame 1 at 0.100 s\nmost at vertex 3",
        "Error per vertex: worst frame, 2 at 0.200 s\nmost at vertex 3",
    ]
    limits = np.array([[*panel.get_xlim(), *panel.get_ylim()] for panel in panels.ravel()])
    sizes = np.ptp(limits.reshape(6, 2, 2), axis=2)
    np.testing.assert_allclose(sizes, sizes[:1].repeat(6, axis=0))
    add_error_bar(figure, panels.ravel().tolist(), heat)
    assert figure.axes[-1].get_ylabel() == "vertex error (diagonals)"


def test_rows_are_all_frames_and_single_ones() -> None:
    errors = VertexErrors(np.zeros(9), np.zeros(9), np.zeros(4), 5, {})
    assert drawn_frames(errors, None) == [0, 5]
    assert drawn_frames(errors, [2, 7]) == [0, 2, 7]


TRIANGLE = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("vertex", "hidden"), [((0, 0, -1), True), ((0, 0, 1), False), ((2, 0, -1), False), ((0, -0.99, -0.1), True)]
)
@pytest.mark.parametrize("face", [[0, 1, 2], [2, 1, 0]])
def test_what_hides_a_vertex(vertex: tuple[float, ...], hidden: bool, face: list[int]) -> None:
    screen = np.concatenate([TRIANGLE, [vertex]])
    assert _is_hidden(3, screen, np.array([face], dtype=np.int32)) is hidden


def test_a_face_does_not_hide_its_own_corner() -> None:
    assert not _is_hidden(0, TRIANGLE, np.array([[0, 1, 2]], dtype=np.int32))
