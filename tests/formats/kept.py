"""What must be the same of a sequence that was written and read, by the table of what the format can store."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.mesh.measures import choose_origin
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import DEFAULT_COLOUR, CornerValues
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import IntArray
from mixseq_io.registry import OPAQUE_PER_VERTEX


def assert_kept(target: Any, written: MeshSequence, got: MeshSequence) -> None:
    """Check everything that the target's format can store."""
    if target.format.name == "glTF":
        written = in_metres(written)
    order, found = corner_order(target, written, got)
    assert_points(target, written, got, order, found)
    assert_header(target, written, got)
    assert_surface(target, written, got, order, found)


def corner_order(target: Any, written: MeshSequence, got: MeshSequence) -> tuple[IntArray, IntArray]:
    """Return the corners of a sequence and of what was read, in the same order."""
    if target.format.capabilities.polygons == "triangles":
        return sorted_triangles(written), sorted_triangles(got)
    assert got.polygons.same_as(written.polygons)
    every = np.arange(written.polygons.indices.size)
    return every, every


def in_metres(sequence: MeshSequence) -> MeshSequence:
    """Return a sequence in metres with Y up, as glTF has it."""
    x, y, z = np.moveaxis(sequence.points.astype(np.float64), 2, 0) * sequence.metres_per_unit
    axes = (x, z, -y) if sequence.up_axis == "Z" else (x, y, z)
    return sequence.with_points(np.stack(axes, axis=2))


def sorted_triangles(sequence: MeshSequence) -> IntArray:
    """Return the corners ``(3 F,)`` of all triangles, sorted by where they are in the first frame."""
    polygons = sequence.polygons
    # The corners of the triangles of polygons whose vertices are their own corners' numbers.
    corners = Polygons(polygons.counts, np.arange(polygons.indices.size)).triangles
    first = sequence.points[0].astype(np.float64)
    steps = 2.0**-18 * max(float(np.abs(first).max()), 1e-300)  # above the rounding of files
    places = np.rint(first / steps)[polygons.indices[corners]].reshape(len(corners), -1)
    return np.asarray(corners[np.lexsort(places.T[::-1])]).reshape(-1)


def assert_points(target: Any, written: MeshSequence, got: MeshSequence, order: IntArray, found: IntArray) -> None:
    """Compare the positions of all corners, and of vertices without corners where they are kept."""
    dtype: Any = np.float32 if target.rounds else written.points.dtype
    expected = written.points.astype(dtype)
    if target.format.has_nodes and written.points.dtype == np.float64:
        origin = choose_origin(written.points[0])
        if origin.any() and not np.array_equal(expected[0], written.points[0]):
            dtype, expected = np.float64, origin + (written.points - origin).astype(np.float32)
    assert got.points.dtype == dtype
    at = expected[:, written.polygons.indices[order]]
    assert_close(target, got.points[:, got.polygons.indices[found]], at)
    if target.keeps_unused:
        assert got.vertex_count == written.vertex_count
        if target.format.capabilities.polygons != "triangles":
            assert_close(target, got.points, expected)


def assert_close(target: Any, points: NDArray[Any], expected: NDArray[Any]) -> None:
    if target.format.name == "glTF":  # a difference, at most twice the size, is rounded, and then its sum with the base
        size = float(np.abs(expected).max())
        np.testing.assert_allclose(points, expected, rtol=0, atol=max(1.5 * 2**-23 * size, 1e-44))
    else:
        np.testing.assert_array_equal(points, expected)


def assert_header(target: Any, written: MeshSequence, got: MeshSequence) -> None:
    capabilities = target.format.capabilities
    times = written.times
    if "from 0 on" in capabilities.times:  # where a single frame is no animation, and has no time
        times = times if len(times) > 1 else np.zeros(1)
    even = np.allclose(np.diff(times, 2), 0, atol=1e-6)
    if not capabilities.times.startswith(("no", "even")) or (
        "even" in capabilities.times and even and written.fps == 24
    ):
        np.testing.assert_allclose(got.times, times, rtol=max(target.time_error, 1e-14), atol=target.time_error)
    if target.keeps_rate:
        assert got.fps == written.fps
    if target.keeps_name and len(written.objects) == 1:
        assert got.name == written.name
    if capabilities.units:
        assert (got.up_axis, got.metres_per_unit) == (written.up_axis, written.metres_per_unit)


def assert_surface(target: Any, written: MeshSequence, got: MeshSequence, order: IntArray, found: IntArray) -> None:
    capabilities, ours, theirs = target.format.capabilities, written.surface, got.surface
    if capabilities.uvs and ours.uvs is not None:
        assert theirs.uvs is not None
        # glTF counts v downwards, and 1 - v rounds.
        np.testing.assert_allclose(theirs.uvs.at_corners[found], ours.uvs.at_corners[order], rtol=0, atol=1e-7)
    if capabilities.colours and ours.colours is not None:
        assert theirs.colours is not None
        expected = ours.colours
        if capabilities.colours is not True:
            vertices = written.polygons.indices
            at_vertices = expected.at_vertices(vertices, written.vertex_count, DEFAULT_COLOUR)
            at_vertices[:, 3:] = 1 if capabilities.colours == OPAQUE_PER_VERTEX else at_vertices[:, 3:]
            expected = CornerValues(at_vertices, vertices)
        np.testing.assert_array_equal(theirs.colours.at_corners[found], expected.at_corners[order])
    if capabilities.hard_edges:
        np.testing.assert_array_equal(partition(got, found), partition(written, order))
    if capabilities.face_sets:
        sets = {each.name: each for each in theirs.face_sets}
        for face_set in ours.face_sets:
            assert marked(got, sets[face_set.name].polygons)[found].tolist() == (
                marked(written, face_set.polygons)[order].tolist()
            )
            if capabilities.materials != "no":
                assert PurePosixPath(sets[face_set.name].material or sets[face_set.name].name).name
    if capabilities.objects and len(ours.objects) > 1:
        assert [(each.name, each.vertex_count) for each in theirs.objects] == [
            (each.name, each.vertex_count) for each in ours.objects
        ]


def partition(sequence: MeshSequence, order: IntArray) -> IntArray:
    """Number the groups of corners that share a vertex and a normal, in the order of their first corners."""
    vertices = sequence.polygons.indices
    hard_edges = vertices if sequence.surface.hard_edges is None else sequence.surface.hard_edges
    pairs = np.stack([vertices, hard_edges], axis=1)[order]
    _, first, number = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return np.asarray(rank[number.reshape(-1)])


def marked(sequence: MeshSequence, polygons: IntArray) -> NDArray[np.bool_]:
    """Return which corners belong to polygons of a set."""
    counts = sequence.polygons.counts
    inside = np.zeros(len(counts), dtype=bool)
    inside[polygons] = True
    return np.repeat(inside, counts)
