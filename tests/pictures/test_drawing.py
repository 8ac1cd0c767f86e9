"""A drawn mesh: which faces, in which order, in which light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixseq.pictures.page import draw_mesh
from mixseq.pictures.scene import View
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray, IntArray


def draw(ax: Any, points: FloatArray, faces: IntArray, **options: Any) -> Any:
    """Draw a mesh and return its polygons."""
    draw_mesh(ax, points, faces, **options)
    (collection,) = ax.collections
    return collection


@pytest.mark.parametrize("corners", [[0, 1, 2], [2, 1, 0]])
def test_back_faces_of_a_closed_mesh_are_left_out(ax: Any, gem: MeshSequence, corners: list[int]) -> None:
    polygons = draw(ax, gem.points[0], gem.faces[:, corners]).get_paths()
    assert 0 < len(polygons) < len(gem.faces)


def test_an_open_mesh_shows_both_sides(ax: Any, gem: MeshSequence) -> None:
    assert len(draw(ax, gem.points[0], gem.faces[:6]).get_paths()) == 6


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_near_faces_are_drawn_last(ax: Any, order: list[int]) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    faces, colours = np.array([[0, 1, 2], [3, 4, 5]])[order], np.array([[1, 0, 0], [0, 0, 1.0]])[order]
    last = draw(ax, points, faces, colours=colours, view=View(0, 0), contrast=0).get_facecolor()[-1]
    assert np.allclose(last[:3], [0, 0, 1])


def test_flat_colours_stay_as_given(ax: Any, gem: MeshSequence) -> None:
    collection = draw(ax, gem.points[0], gem.faces, colours=(0.2, 0.4, 0.6), contrast=0)
    assert np.allclose(collection.get_facecolor()[:, :3], [0.2, 0.4, 0.6])


def test_faces_above_are_brighter_than_below(ax: Any, gem: MeshSequence) -> None:
    collection = draw(ax, gem.points[0] * [1, 0.2, 1], gem.faces, view=View(0, 0))
    heights = np.array([path.vertices[:3, 1].mean() for path in collection.get_paths()])
    light = collection.get_facecolor()[:, :3].sum(axis=1)
    assert light[heights > 0].min() > light[heights < 0].max()


def test_degenerate_triangles_are_survived(ax: Any) -> None:
    draw(ax, np.zeros((3, 3)), np.array([[0, 1, 2]]))


def test_a_flat_mesh_seen_from_its_edge_is_survived(ax: Any) -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1.0]])
    draw(ax, square, np.array([[0, 2, 1], [0, 3, 2]]), view=View(0, 0))
