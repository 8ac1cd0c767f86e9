"""Polygons of one mesh among those of another."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.polygons import Polygons, count_common_polygons, describe_difference, match_polygons, match_triangles

NAMES = ("A", "B")


def of(*rows: list[int]) -> Polygons:
    return Polygons(np.array([len(row) for row in rows]), np.concatenate(rows))


OURS = of([0, 1, 2, 3], [3, 2, 4], [4, 2, 5], [5, 2, 1, 6, 7])
SHUFFLED = of([2, 5, 4], [6, 7, 5, 2, 1], [2, 3, 0, 1], [3, 2, 4])


def test_polygons_in_another_order() -> None:
    found = match_polygons(OURS, SHUFFLED)
    assert found is not None
    assert found.polygons.tolist() == [2, 3, 0, 1]
    np.testing.assert_array_equal(SHUFFLED.indices[found.corners], OURS.indices)
    of_corner = np.repeat(np.arange(4), SHUFFLED.counts)
    np.testing.assert_array_equal(of_corner[found.corners], np.repeat(found.polygons, OURS.counts))


def test_there_and_back() -> None:
    there, back = match_polygons(OURS, SHUFFLED), match_polygons(SHUFFLED, OURS)
    assert there is not None and back is not None
    assert there.corners[back.corners].tolist() == list(range(OURS.indices.size))


def test_the_same_polygon_twice_and_a_vertex_twice() -> None:
    ours, theirs = of([0, 1, 2], [0, 3, 0, 1], [1, 2, 0]), of([0, 1, 0, 3], [2, 0, 1], [0, 1, 2])
    found = match_polygons(ours, theirs)
    assert found is not None
    np.testing.assert_array_equal(theirs.indices[found.corners], ours.indices)
    assert sorted(found.polygons.tolist()) == [0, 1, 2]


@pytest.mark.parametrize(
    ("theirs", "message"),
    [
        (of([0, 2, 1, 3], [3, 2, 4]), "polygon 0 of A (vertices 0 1 2 3) is not in B"),
        (of([0, 1, 2, 3], [2, 3, 4]), "polygon 1 of A (vertices 3 2 4) is flipped in B"),
        (of([0, 1, 2, 3], [3, 2, 4], [3, 2, 4]), "polygon 2 of B (vertices 3 2 4) is not in A"),
        (of([0, 1, 2, 3]), "polygon 1 of A (vertices 3 2 4) is not in B"),
    ],
    ids=["other", "turned", "more", "fewer"],
)
def test_what_differs_first_is_named(theirs: Polygons, message: str) -> None:
    ours = of([0, 1, 2, 3], [3, 2, 4])
    assert match_polygons(ours, theirs) is None
    assert describe_difference(ours, theirs, NAMES) == message
    with pytest.raises(InvalidSequenceError) as caught:
        match_triangles(ours, theirs, NAMES)
    assert str(caught.value) == message


def test_count_of_common_polygons() -> None:
    assert count_common_polygons(OURS, SHUFFLED) == 4
    assert count_common_polygons(OURS, of([2, 3, 0, 1], [2, 3, 4], [2, 5, 4], [2, 5, 4])) == 2


def test_triangles_of_quads_that_begin_at_opposite_corners() -> None:
    """Their triangles are the same, the second one first. An n-gon beside them is cut otherwise."""
    ours = of([0, 1, 2, 3], [3, 2, 4, 5, 6], [6, 5, 7, 8])
    theirs = of([8, 6, 5, 7], [2, 4, 5, 6, 3], [2, 3, 0, 1])
    assert match_triangles(ours, theirs, NAMES).tolist() == [6, 5, 2, 3, 4, 0, 1]


@pytest.mark.parametrize(
    "theirs",
    [OURS, SHUFFLED, of(*OURS.triangles.tolist()), of(*np.roll(OURS.triangles, 1, axis=1)[::-1].tolist())],
    ids=["same", "shuffled", "cut", "cut and shuffled"],
)
def test_triangles(theirs: Polygons) -> None:
    """Each has one of the polygon that it was cut from: there are no two with three common vertices."""
    found = match_triangles(OURS, theirs, NAMES)
    assert sorted(found.tolist()) == list(range(len(OURS.triangles)))
    for own, other in zip(OURS.triangles, theirs.triangles[found], strict=True):
        polygons = [set(row.tolist()) for row in np.split(OURS.indices, np.cumsum(OURS.counts)[:-1])]
        assert any({*own.tolist(), *other.tolist()} <= each for each in polygons)
