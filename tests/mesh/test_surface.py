"""What lies on a mesh must fit it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence

QUAD_TRIANGLE = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 4, 5, 6]))


def header(**surface: Any) -> SequenceHeader:
    return SequenceHeader(polygons=QUAD_TRIANGLE, vertex_count=7, times=np.arange(2.0), surface=Surface(**surface))


def uvs(corners: int = 7, values: int = 2) -> CornerValues:
    return CornerValues(np.eye(2, dtype=np.float32)[:values], np.arange(corners) % 2)


def test_values_at_corners() -> None:
    assert uvs(3).at_corners.tolist() == [[1, 0], [0, 1], [1, 0]]


def test_equal_values_at_a_vertex_are_one_row() -> None:
    """A square of two triangles with a row per corner, as Blender writes; one corner of vertex 2 is on a seam."""
    vertices = np.array([0, 1, 2, 2, 1, 3])
    values = np.array([[0, 0], [1, 0], [0, 1], [0, 1], [1, 0], [1, 1]], dtype=np.float32)
    apart = CornerValues(values, np.arange(6))
    assert apart.weld(vertices).indices.tolist() == [0, 1, 2, 2, 1, 3]
    assert apart.weld(vertices).values.tolist() == [[0, 0], [1, 0], [0, 1], [1, 1]]
    values[3, 0] = -0.0  # bits differ: corners keep theirs
    assert CornerValues(values, np.arange(6)).weld(vertices).indices.tolist() == [0, 1, 2, 3, 1, 4]


def test_rows_that_vertices_share_stay_shared() -> None:
    """Every face has the whole texture: four rows are enough, and stay four."""
    shared = CornerValues(np.eye(2), np.array([0, 1, 0, 1]))
    assert shared.weld(np.array([0, 1, 2, 3])) is shared
    # Rows 0 and 2 agree at vertex 0, rows 2 and 3 at vertex 1: all three are one, also where they are used alone.
    rows = np.array([[1, 2], [3, 4], [1, 2], [1, 2]])
    chain = CornerValues(rows, np.array([0, 2, 2, 3, 0, 1, 3]))
    welded = chain.weld(np.array([0, 0, 1, 1, 2, 3, 4]))
    assert welded.indices.tolist() == [0, 0, 0, 0, 0, 1, 0]
    assert welded.values.tolist() == [[1, 2], [3, 4]]


def test_values_of_vertices_are_those_of_their_first_corners() -> None:
    vertices = np.array([0, 1, 2, 2, 1, 4])
    whole = CornerValues(np.array([[1.0, 2], [3, 4], [5, 6], [7, 8]]), np.array([0, 1, 2, 2, 1, 3]))
    assert whole.one_per_vertex(vertices)
    assert whole.at_vertices(vertices, 6, (0, 9)).tolist() == [[1, 2], [3, 4], [5, 6], [0, 9], [7, 8], [0, 9]]
    seam = CornerValues(whole.values, np.array([0, 1, 2, 3, 1, 3]))
    assert not seam.one_per_vertex(vertices)
    assert seam.at_vertices(vertices, 5, (0, 9)).tolist() == [[1, 2], [3, 4], [5, 6], [0, 9], [7, 8]]
    assert CornerValues(np.zeros((0, 2)), np.zeros(0, int)).one_per_vertex(np.zeros(0, int))


@given(st.integers(0, 2**32), st.integers(1, 4))
def test_corner_values_are_the_same_in_other_rows(seed: int, width: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 3, (20, width)).astype(np.float32)
    found = CornerValues.from_corners(values)
    np.testing.assert_array_equal(found.at_corners, values)
    assert len(np.unique(found.values, axis=0)) == len(found.values)
    order = rng.permutation(20)[:12]
    np.testing.assert_array_equal(found.select(order).at_corners, values[order])
    # A vertex for each colour, in any order: they have one each, and corners have that of their vertex.
    vertices = rng.permutation(len(found.values))[found.indices]
    assert found.one_per_vertex(vertices)
    np.testing.assert_array_equal(found.at_vertices(vertices, 20, [7] * width)[vertices], values)


def test_everything_is_read_only() -> None:
    surface = header(uvs=uvs(), hard_edges=np.arange(7), face_sets=[FaceSet("a", np.array([1, 0]))]).surface
    assert surface.uvs is not None and surface.hard_edges is not None
    for array in (surface.uvs.values, surface.uvs.indices, surface.hard_edges, surface.face_sets[0].polygons):
        assert not array.flags.writeable


def test_face_sets_are_sorted_and_without_doubles() -> None:
    assert FaceSet("a", np.array([3, 1, 3])).polygons.tolist() == [1, 3]


def test_a_mesh_is_its_own_object() -> None:
    assert header().objects == (MeshObject("mesh", "", 7, 2),)
    two = (MeshObject("a", "/a", 4, 1), MeshObject("b", "/b", 3, 1))
    assert header(objects=two).objects == two


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        ({"uvs": uvs(6)}, "6 texture coordinates for 7 corners"),
        ({"uvs": uvs(values=1)}, "texture coordinates of a corner are number 0 to 1 of 1"),
        ({"uvs": CornerValues(np.zeros((2, 3)), np.zeros(7, int))}, r"shape \(2, 3\), not \(n, 2\)"),
        ({"colours": CornerValues(np.zeros((2, 3)), np.zeros(7, int))}, r"colours have shape \(2, 3\), not \(n, 4\)"),
        ({"colours": CornerValues(np.zeros((2, 4)), np.zeros(6, int))}, "6 colours for 7 corners"),
        ({"hard_edges": np.zeros(8, int)}, "8 hard edges for 7 corners"),
        ({"hard_edges": -np.arange(7)}, "hard edges of a corner are number -6 to 0"),
        ({"face_sets": [FaceSet("head", np.array([0, 2]))]}, "'head' has polygon 2, but polygons are 0 to 1"),
        ({"objects": [MeshObject("a", "", 7, 1)]}, "7 vertices and 1 polygons, the mesh 7 and 2"),
        (
            {"objects": [MeshObject("a", "", 3, 1), MeshObject("b", "", 4, 1)]},
            "a polygon of the object 'a' uses vertices of another",
        ),
        ({"hard_edges": np.zeros(7)}, "hard edges have type float64; integers are expected"),
        ({"subdivision": "butterfly"}, "subdivision is 'butterfly'; one of none, catmullClark"),
        (
            {"objects": [MeshObject("a", "", 7, 2, subdivision="butterfly")]},
            "subdivision is 'butterfly'; one of none, catmullClark",
        ),
    ],
    ids=[
        "few",
        "range",
        "three",
        "no alpha",
        "few colours",
        "hard",
        "negative",
        "polygon",
        "count",
        "astray",
        "floats",
        "scheme",
        "own",
    ],
)
def test_refusals(surface: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSequenceError, match=message):
        header(**surface)


def test_the_surface_stays_with_the_sequence() -> None:
    surface = Surface(uvs=uvs(), origin=Origin("USD", "/walk.usd"))
    points = np.random.default_rng(0).normal(size=(2, 7, 3))
    sequence = replace(MeshSequence.from_arrays(points, QUAD_TRIANGLE), surface=surface)
    assert sequence.header.with_times([0.0, 1.0, 2.0]).surface is surface
    assert sequence.with_points(points + 1).surface is surface
