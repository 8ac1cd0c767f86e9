"""Pieces of a mesh: what hangs together across edges, and where it is."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.topology import Topology
from mixseq.spaces.pieces import Pieces
from mixseq.types import Float
from tests.meshes import SEQUENCES, grid, joined, rigid_motions, tetrahedron, topology_of, tube


def two_and_a_point() -> tuple[Topology, Float]:
    """A tetrahedron, a vertex that no face uses, and a sheet."""
    points, faces = joined(tetrahedron(), (np.array([[9.0, 9, 9]]), np.zeros((0, 3), int)), grid(2, 3))
    return Topology(faces, len(points)), points


def bowtie() -> tuple[Topology, Float]:
    """Two triangles that share a vertex."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    return Topology(np.array([[0, 1, 2], [0, 3, 4]]), 5), points


def test_pieces_are_connected_across_edges_and_unused_vertices_come_last() -> None:
    topology, points = two_and_a_point()
    pieces = Pieces.of(topology, points)
    assert [each.tolist() for each in pieces.vertices] == [list(range(4)), list(range(5, 17)), [4]]
    assert [each.tolist() for each in pieces.faces] == [list(range(4)), list(range(4, 16)), []]
    assert pieces.row_vertices.tolist() == [0, 1, 2, 3, *range(5, 17), 4]
    assert pieces.owner.tolist() == [0] * 4 + [1] * 12 + [2]
    assert pieces.slices == [slice(0, 4), slice(4, 16), slice(16, 17)]
    np.testing.assert_allclose(pieces.radii, [np.sqrt(3), np.sqrt(15 / 12 + 8 / 12), 1e-3])


def test_shared_vertices_have_a_row_in_every_piece() -> None:
    topology, points = bowtie()
    pieces = Pieces.of(topology, points)
    assert pieces.row_vertices.tolist() == [0, 1, 2, 0, 3, 4]
    assert pieces.face_rows(topology).tolist() == [[0, 1, 2], [3, 4, 5]]
    assert pieces.rows_of(np.array([0, 1, 1]), np.array([0, 0, 4])).tolist() == [0, 3, 5]


def test_rows_of_faces_are_their_corners() -> None:
    for name in ("several components", "unused vertices", "repeated corners", "bowtie", "three pages"):
        sequence = SEQUENCES[name]()
        topology = Topology(sequence.faces, sequence.vertex_count)
        pieces = Pieces.of(topology, sequence.points[0])
        rows = pieces.face_rows(topology)
        np.testing.assert_array_equal(pieces.row_vertices[rows], sequence.faces)
        np.testing.assert_array_equal(
            pieces.owner[rows], np.repeat(topology.component_of_face[:, None], 3, axis=1)
        )


@settings(max_examples=20, deadline=None)
@given(motion=rigid_motions)
def test_poses_are_the_motion_of_a_piece(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    mesh = tetrahedron()
    pieces = Pieces.of(topology_of(mesh), mesh[0])
    rotations, centres = pieces.poses(mesh[0] @ turn.T + shift)
    np.testing.assert_allclose(rotations[0], turn, atol=1e-12)
    np.testing.assert_allclose(centres[0], shift, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(first=rigid_motions, second=rigid_motions)
def test_placing_undoes_any_motion_of_a_piece(
    first: tuple[Float, Float], second: tuple[Float, Float]
) -> None:
    topology, points = two_and_a_point()
    pieces = Pieces.of(topology, points)
    rotations, centres = pieces.poses(points)
    rows = points[pieces.row_vertices]
    for each, (turn, shift) in zip(pieces.slices, (first, second), strict=False):
        rows[each] = rows[each] @ turn.T + shift
    np.testing.assert_allclose(pieces.place(rows, rotations, centres), points, atol=1e-10)


def test_centred_pieces_do_not_turn_and_shared_vertices_meet_half_way() -> None:
    topology, points = bowtie()
    pieces = Pieces.of(topology, points)
    centres = pieces.centres(points)
    np.testing.assert_allclose(centres, [[1 / 3, 1 / 3, 0], [-1 / 3, -1 / 3, 0]])
    rows = points[pieces.row_vertices] + np.repeat([[3.0, 0, 0], [0, 4, 1]], 3, axis=0)
    np.testing.assert_allclose(pieces.centred(rows, centres), points, atol=1e-14)
    apart = pieces.centred(rows, centres + np.outer([1, 0], [0, 0, 1]))
    np.testing.assert_allclose(apart - points, np.outer([0.5, 1, 1, 0, 0], [0, 0, 1]), atol=1e-14)


@settings(max_examples=30, deadline=None)
@given(motion=rigid_motions, squeeze=st.sampled_from([(1.0, 1.0, 0.0), (1.0, 1e-5, 0), (0, 1, 0), (0, 0, 0)]))
def test_references_without_width_place_frames_that_have_some(
    motion: tuple[Float, Float], squeeze: tuple[float, float, float]
) -> None:
    turn, shift = motion
    points, faces = tube(5, 4)
    pieces = Pieces.of(Topology(faces, len(points)), points * squeeze)
    for frame in (points, points * squeeze, points * [1.0, 1e-4, 0], points * 0):
        rotations, centres = pieces.poses(frame)
        moved = frame @ turn.T + shift
        np.testing.assert_allclose(pieces.place(moved, rotations, centres), frame, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(motion=rigid_motions)
def test_lines_point_where_they_are_moved(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    line = np.outer([0.0, 1, 3, 4, 7], [1.0, 2, 2]) / 3
    pieces = Pieces.of(Topology(np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4]]), 5), line)
    rotations, _ = pieces.poses(line @ turn.T + shift)
    np.testing.assert_allclose(rotations[0] @ [1, 2, 2], turn @ [1, 2, 2], atol=1e-5)
    np.testing.assert_allclose(pieces.poses(line)[0][0], np.eye(3), atol=1e-5)
