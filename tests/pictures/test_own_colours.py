"""Colours that meshes bring along: exact where a palette can hold them, near where it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.pictures.colours import ENTRIES, colouring_of, own_colours
from mixseq.pictures.film import FilmSettings, film
from mixseq.pictures.scene import SceneItem
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from tests.meshes import bar, tetrahedron


def painted(sequence: MeshSequence, values: FloatArray) -> MeshSequence:
    """The sequence with linear colours ``(V, 4)`` of its vertices."""
    return replace(
        sequence, surface=Surface(colours=CornerValues(values, np.asarray(sequence.polygons.indices)))
    )


def by_place(sequence: MeshSequence) -> MeshSequence:
    """The sequence painted by where its vertices are in the first frame."""
    low, size = sequence.points[0].min(axis=0), np.ptp(sequence.points[0], axis=0)
    return painted(
        sequence, np.hstack([(sequence.points[0] - low) / size, np.ones((sequence.vertex_count, 1))])
    )


def shown(sequence: MeshSequence) -> NDArray[np.uint8]:
    palette, entries = own_colours(sequence.header)
    assert len(palette) <= ENTRIES
    return palette[entries]


def srgb(linear: FloatArray) -> FloatArray:
    return np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )


def test_linear_colours_are_shown_in_srgb() -> None:
    points, faces = tetrahedron()
    values = np.array([[1, 0, 0, 1], [0.5, 0.5, 0.5, 0.1], [-1, 2, np.nan, 1], [0.2159, 0.002, 1, 1]])
    sequence = painted(MeshSequence.from_arrays(points[None], faces), values)
    assert shown(sequence).tolist() == [[255, 0, 0], [188, 188, 188], [0, 255, 0], [128, 7, 255]]


def test_up_to_256_colours_are_exact() -> None:
    sequence = bar(sides=16, rings=40, frames=1)
    values = np.ones((sequence.vertex_count, 4))
    values[:, 0] = (np.arange(sequence.vertex_count) % 256) / 255
    expected = np.rint(255 * srgb(values[:, :3]))
    np.testing.assert_array_equal(shown(painted(sequence, values)), expected)


def test_more_colours_are_near() -> None:
    """Of a bar that is painted by place, thousands of colours, as 256."""
    sequence = by_place(bar(sides=30, rings=200, frames=1))
    assert sequence.surface.colours is not None
    exact = 255 * srgb(sequence.surface.colours.values[:, :3].astype(np.float64))
    assert len(np.unique(np.rint(exact), axis=0)) > 1000
    apart = np.linalg.norm(shown(sequence) - exact, axis=1)
    assert np.sqrt(np.square(apart).mean()) < 12
    np.testing.assert_array_equal(shown(sequence), shown(sequence))


def test_vertices_have_the_colour_of_their_first_corner_and_white_without_one() -> None:
    points, _ = tetrahedron()
    sequence = MeshSequence.from_arrays(np.vstack([points, [[9, 9, 9]]])[None], [[0, 1, 2], [2, 1, 3]])
    values = np.array([[1, 0, 0, 1], [0, 0, 1, 1]], np.float32)
    two = replace(sequence, surface=Surface(colours=CornerValues(values, np.array([0, 0, 0, 1, 1, 1]))))
    red, blue, white = [255, 0, 0], [0, 0, 255], [255, 255, 255]
    assert shown(two).tolist() == [red, red, red, blue, white]


def test_faces_of_films_have_the_mean_of_their_vertices() -> None:
    points, faces = tetrahedron()
    values = np.ones((4, 4))
    values[0, 1:3] = 0
    sequence = painted(MeshSequence.from_arrays(points[None], faces), values)
    colouring = colouring_of("own", sequence.header, points)
    expected = np.where((sequence.faces == 0).any(axis=1)[:, None], [1, 2 / 3, 2 / 3], [1.0, 1, 1])
    np.testing.assert_allclose(np.asarray(colouring.of_faces), expected, atol=1e-6)
    assert colouring.constant


def test_films_of_meshes_without_colours_are_refused(tmp_path: object) -> None:
    sequence = bar(sides=5, rings=5, frames=2)
    with pytest.raises(SettingsError, match="bar has no colours of its own; choose another colour"):
        film(f"{tmp_path}/a.gif", [SceneItem("bar", sequence)], FilmSettings(colour="own"))
