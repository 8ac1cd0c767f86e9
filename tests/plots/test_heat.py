"""Errors as colours: what is on which panel, and which vertices can be seen."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.plots.errors import VertexErrors
from mixseq.plots.heat import _hidden, add_error_bar, draw_vertex_errors, drawn_frames
from tests.meshes import bar


def test_pictures_of_vertices() -> None:
    figure = pytest.importorskip("matplotlib.figure").Figure()
    original = bar(sides=5, rings=4, frames=3)
    off = np.arange(3.0)[:, None] * (
        np.arange(original.vertex_count) == 3
    )  # in frame 2, twice that of frame 1
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
    ("vertex", "hidden"),
    [((0, 0, -1), True), ((0, 0, 1), False), ((2, 0, -1), False), ((0, -0.99, -0.1), True)],
)
@pytest.mark.parametrize("face", [[0, 1, 2], [2, 1, 0]])
def test_what_hides_a_vertex(vertex: tuple[float, ...], hidden: bool, face: list[int]) -> None:
    screen = np.concatenate([TRIANGLE, [vertex]])
    assert _hidden(3, screen, np.array([face], dtype=np.int32)) is hidden


def test_a_face_does_not_hide_its_own_corner() -> None:
    assert not _hidden(0, TRIANGLE, np.array([[0, 1, 2]], dtype=np.int32))
