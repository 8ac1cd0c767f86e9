"""Renumbered meshes are the same meshes: what lies on vertices, polygons and corners goes along, and comes back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.compression import numbering
from mixseq.compression.numbering import Renumbering, find_numbering, identity_numbering, object_vertex_counts
from mixseq.mesh.polygons import Polygons, match_polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from tests.compression.bitstream.test_polygon_walk import MESHES, quads, shuffled
from tests.meshes import bar

pytestmark = pytest.mark.slow


def by_walk(mesh: SequenceHeader, vertices: bool) -> Renumbering:
    return numbering.walk_numbering(mesh.polygons, object_vertex_counts(mesh), vertices=vertices)


def dressed(polygons: Polygons, vertex_count: int, seed: int = 0) -> MeshSequence:
    """A mesh in any shape, with texture coordinates, hard edges, and two face sets that overlap."""
    random = np.random.default_rng(seed)
    corners = polygons.indices.size
    surface = Surface(
        uvs=CornerValues(random.random((corners, 2)), random.permutation(corners)),
        hard_edges=random.integers(0, 5, corners),
        face_sets=(
            FaceSet("all", np.arange(len(polygons.counts)), "skin"),
            FaceSet("some", np.flatnonzero(random.random(len(polygons.counts)) < 0.4), "cloth"),
        ),
    )
    return MeshSequence(
        polygons=polygons,
        vertex_count=vertex_count,
        times=np.arange(2.0),
        points=random.normal(size=(2, vertex_count, 3)),
        velocities=random.normal(size=(2, vertex_count, 3)),
        surface=surface,
    )


def scrambled(rows: int = 6, columns: int = 5, seed: int = 3) -> MeshSequence:
    """A grid of quads, of which half are triangles, in no order at all, and two vertices without polygons."""
    whole = quads(rows, columns).indices.reshape(-1, 4)
    cut = [list(each) for row in whole[::2] for each in (row[[0, 1, 2]], row[[0, 2, 3]])]
    faces = cut + [list(row) for row in whole[1::2]]
    numbers = np.random.default_rng(seed).permutation(rows * columns + 2)
    polygons = Polygons(
        np.array([len(face) for face in faces]), numbers[np.concatenate([np.array(face) for face in faces])]
    )
    return dressed(shuffled(polygons, seed)[0], rows * columns + 2)


def seen(sequence: MeshSequence) -> set[tuple[object, ...]]:
    """The mesh as it looks, whatever the numbers: places, velocities and texture coordinates around every triangle."""
    surface = sequence.surface
    assert surface.uvs is not None and sequence.velocities is not None
    corners = np.concatenate(
        [
            sequence.points[:, sequence.polygons.indices].transpose(1, 0, 2).reshape(-1, 6),
            sequence.velocities[0][sequence.polygons.indices],
            surface.uvs.at_corners,
        ],
        axis=1,
    )
    found = set()
    for polygon, rows in enumerate(np.split(corners, np.cumsum(sequence.polygons.counts)[:-1])):
        sets = tuple(each.name for each in surface.face_sets if polygon in each.polygons)
        for last in range(2, len(rows)):
            triangle = [tuple(rows[each]) for each in (0, last - 1, last)]
            first = triangle.index(min(triangle))
            found.add((*triangle[first:], *triangle[:first], sets, len(rows)))
    return found


def partition(sequence: MeshSequence) -> set[frozenset[tuple[float, ...]]]:
    """Which corners share a normal, by their texture coordinates, no two of which are the same."""
    surface = sequence.surface
    assert surface.uvs is not None and surface.hard_edges is not None
    rows = [tuple(row) for row in surface.uvs.at_corners.tolist()]
    return {
        frozenset(rows[corner] for corner in np.flatnonzero(surface.hard_edges == number))
        for number in np.unique(surface.hard_edges)
    }


@pytest.mark.parametrize("vertices", [False, True])
def test_a_scrambled_grid_is_the_same_mesh(vertices: bool) -> None:
    grid = scrambled()
    found = by_walk(grid, vertices=vertices).renumber_frames(grid)
    assert isinstance(found, MeshSequence)
    assert seen(found) == seen(grid)
    assert partition(found) == partition(grid)
    assert np.array_equal(found.points, grid.points) != vertices
    assert (match_polygons(grid.polygons, found.polygons) is None) == vertices


@pytest.mark.parametrize("name", MESHES)
@settings(max_examples=10)
@given(st.integers(0, 2**32), st.booleans())
def test_renumberings_are_permutations_that_their_inverses_undo(name: str, seed: int, vertices: bool) -> None:
    polygons = MESHES[name]
    mesh = dressed(polygons, int(polygons.indices.max()) + 3, seed)
    found = by_walk(mesh, vertices=vertices)
    for numbers in (found.vertices, found.polygons, found.corners):
        assert np.array_equal(np.sort(numbers), np.arange(len(numbers)))
    again = found.inverse.renumber_frames(found.renumber_frames(mesh))
    assert isinstance(again, MeshSequence)
    assert again.polygons.same_as(mesh.polygons)
    np.testing.assert_array_equal(again.points, mesh.points)
    assert seen(again) == seen(mesh)
    assert partition(again) == partition(mesh)


@settings(max_examples=10)
@given(st.integers(0, 2**32))
def test_vertices_have_the_same_numbers_however_polygons_are_listed(seed: int) -> None:
    grid = scrambled()
    polygons, _ = shuffled(grid.polygons, seed)
    listed = by_walk(dressed(polygons, grid.vertex_count), vertices=True)
    np.testing.assert_array_equal(listed.vertices, by_walk(grid, vertices=True).vertices)


def test_first_vertices_come_first_and_unused_ones_last() -> None:
    grid = scrambled()
    found = by_walk(grid, vertices=True)
    polygons = found.renumber_polygons(grid.polygons)
    used, first = np.unique(polygons.indices, return_index=True)
    assert used.tolist() == list(range(grid.vertex_count - 2))
    assert first[0] == 0
    unused = np.setdiff1d(np.arange(grid.vertex_count), grid.polygons.indices)
    assert found.vertices[-2:].tolist() == unused.tolist()


def test_larger_polygons_are_cut_into_the_same_triangles() -> None:
    """Quads may begin at the opposite corner, pentagons where they began."""
    polygons = Polygons(np.array([5, 4, 4]), np.array([4, 3, 2, 1, 0, 1, 2, 6, 5, 7, 6, 2, 3]))
    header = SequenceHeader(polygons=polygons, vertex_count=8, times=np.zeros(1))
    new = by_walk(header, vertices=False).renumber_polygons(polygons)
    triangles = [sorted(map(frozenset, each.triangles.tolist()), key=sorted) for each in (polygons, new)]
    assert triangles[0] == triangles[1]
    assert not new.same_as(polygons)


def test_objects_keep_their_vertices_and_polygons() -> None:
    one, other = scrambled(4, 4, 1), scrambled(5, 3, 2)
    count = one.vertex_count
    both = Polygons(
        np.concatenate([one.polygons.counts, other.polygons.counts]),
        np.concatenate([one.polygons.indices, other.polygons.indices + count]),
    )
    objects = tuple(
        MeshObject(name, f"/{name}", each.vertex_count, len(each.polygons.counts))
        for name, each in (("one", one), ("other", other))
    )
    mesh = dressed(both, count + other.vertex_count)
    mesh = replace(mesh, surface=replace(mesh.surface, objects=objects))
    found = by_walk(mesh, vertices=True)
    header = found.renumber_header(mesh.header)  # it refuses polygons across objects
    assert header.objects == objects
    np.testing.assert_array_equal(found.vertices[:count], by_walk(one, vertices=True).vertices)
    np.testing.assert_array_equal(found.vertices[count:], by_walk(other, vertices=True).vertices + count)


def test_hard_edges_are_numbered_as_they_come() -> None:
    grid = scrambled()
    hard_edges = identity_numbering(grid.polygons, grid.vertex_count).renumber_header(grid.header).surface.hard_edges
    assert hard_edges is not None and hard_edges[0] == 0
    highest = np.maximum.accumulate(hard_edges)
    assert (hard_edges[1:] <= highest[:-1] + 1).all()


@dataclass(frozen=True)
class Streamed:
    """Frames that are not in memory."""

    sequence: MeshSequence

    @property
    def header(self) -> SequenceHeader:
        return self.sequence.header

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        return self.sequence.blocks(size)


def test_frames_stream() -> None:
    walk = bar(5, 9, 7)
    found = by_walk(walk, vertices=True)
    streamed = found.renumber_frames(Streamed(walk))
    points = np.concatenate(list(streamed.blocks(3)))
    np.testing.assert_array_equal(points, walk.points[:, found.vertices])
    assert streamed.header.polygons.same_as(found.renumber_polygons(walk.polygons))


def test_the_numbering_of_a_file_is_found() -> None:
    grid = scrambled()
    polygons, sizes = grid.polygons, object_vertex_counts(grid)
    walked = by_walk(grid, vertices=True)
    for seed in range(3):
        free, _ = shuffled(walked.renumber_polygons(polygons), seed)
        found = find_numbering(free, polygons, sizes)
        assert found is not None and found.order == "free"
        np.testing.assert_array_equal(found.vertices, walked.vertices)
        kept = find_numbering(shuffled(polygons, seed)[0], polygons, sizes)
        assert kept is not None and kept.order == "keep"
    assert find_numbering(Polygons(polygons.counts, np.roll(polygons.indices, 1)), polygons, sizes) is None
    assert find_numbering(bar().polygons, polygons, sizes) is None
