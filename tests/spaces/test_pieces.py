"""Pieces of a mesh: what hangs together across edges, and where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.spaces.pieces import Pieces, PosedSpace
from mixseq.spaces.temporal import TemporalOperator
from mixseq.types import Float
from tests.meshes import SEQUENCES, grid, joined, rigid_motions, rotation, tetrahedron, topology_of, tube


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
    pieces = Pieces.from_mesh(topology, points)
    assert [each.tolist() for each in pieces.vertices] == [list(range(4)), list(range(5, 17)), [4]]
    assert [each.tolist() for each in pieces.faces] == [list(range(4)), list(range(4, 16)), []]
    assert pieces.vertex_of_row.tolist() == [0, 1, 2, 3, *range(5, 17), 4]
    assert pieces.piece_of_row.tolist() == [0] * 4 + [1] * 12 + [2]
    assert pieces.row_slices == [slice(0, 4), slice(4, 16), slice(16, 17)]
    np.testing.assert_allclose(pieces.radii, [np.sqrt(3), np.sqrt(15 / 12 + 8 / 12), 1e-3])


def test_shared_vertices_have_a_row_in_every_piece() -> None:
    topology, points = bowtie()
    pieces = Pieces.from_mesh(topology, points)
    assert pieces.vertex_of_row.tolist() == [0, 1, 2, 0, 3, 4]
    assert pieces.face_rows(topology).tolist() == [[0, 1, 2], [3, 4, 5]]
    assert pieces.find_rows(np.array([0, 1, 1]), np.array([0, 0, 4])).tolist() == [0, 3, 5]


def test_rows_of_faces_are_their_corners() -> None:
    for name in ("several components", "unused vertices", "repeated corners", "bowtie", "three pages"):
        sequence = SEQUENCES[name]()
        topology = Topology(sequence.faces, sequence.vertex_count)
        pieces = Pieces.from_mesh(topology, sequence.points[0])
        rows = pieces.face_rows(topology)
        np.testing.assert_array_equal(pieces.vertex_of_row[rows], sequence.faces)
        np.testing.assert_array_equal(
            pieces.piece_of_row[rows], np.repeat(topology.component_of_face[:, None], 3, axis=1)
        )


@settings(max_examples=20, deadline=None)
@given(motion=rigid_motions)
def test_poses_are_the_motion_of_a_piece(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    mesh = tetrahedron()
    pieces = Pieces.from_mesh(topology_of(mesh), mesh[0])
    rotations, centres = pieces.measure_poses(mesh[0] @ turn.T + shift)
    np.testing.assert_allclose(rotations[0], turn, atol=1e-12)
    np.testing.assert_allclose(centres[0], shift, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(first=rigid_motions, second=rigid_motions)
def test_placing_undoes_any_motion_of_a_piece(first: tuple[Float, Float], second: tuple[Float, Float]) -> None:
    topology, points = two_and_a_point()
    pieces = Pieces.from_mesh(topology, points)
    rotations, centres = pieces.measure_poses(points)
    rows = points[pieces.vertex_of_row]
    for each, (turn, shift) in zip(pieces.row_slices, (first, second), strict=False):
        rows[each] = rows[each] @ turn.T + shift
    np.testing.assert_allclose(pieces.place(rows, rotations, centres), points, atol=1e-10)


def test_centred_pieces_do_not_turn_and_shared_vertices_meet_half_way() -> None:
    topology, points = bowtie()
    pieces = Pieces.from_mesh(topology, points)
    centres = pieces.measure_centres(points)
    np.testing.assert_allclose(centres, [[1 / 3, 1 / 3, 0], [-1 / 3, -1 / 3, 0]])
    rows = points[pieces.vertex_of_row] + np.repeat([[3.0, 0, 0], [0, 4, 1]], 3, axis=0)
    np.testing.assert_allclose(pieces.translate(rows, centres), points, atol=1e-14)
    apart = pieces.translate(rows, centres + np.outer([1, 0], [0, 0, 1]))
    np.testing.assert_allclose(apart - points, np.outer([0.5, 1, 1, 0, 0], [0, 0, 1]), atol=1e-14)


@settings(max_examples=30, deadline=None)
@given(motion=rigid_motions, squeeze=st.sampled_from([(1.0, 1.0, 0.0), (1.0, 1e-5, 0), (0, 1, 0), (0, 0, 0)]))
def test_references_without_width_place_frames_that_have_some(
    motion: tuple[Float, Float], squeeze: tuple[float, float, float]
) -> None:
    turn, shift = motion
    points, faces = tube(5, 4)
    pieces = Pieces.from_mesh(Topology(faces, len(points)), points * squeeze)
    for frame in (points, points * squeeze, points * [1.0, 1e-4, 0], points * 0):
        rotations, centres = pieces.measure_poses(frame)
        moved = frame @ turn.T + shift
        np.testing.assert_allclose(pieces.place(moved, rotations, centres), frame, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(motion=rigid_motions)
def test_lines_point_where_they_are_moved(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    line = np.outer([0.0, 1, 3, 4, 7], [1.0, 2, 2]) / 3
    pieces = Pieces.from_mesh(Topology(np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4]]), 5), line)
    rotations, _ = pieces.measure_poses(line @ turn.T + shift)
    np.testing.assert_allclose(rotations[0] @ [1, 2, 2], turn @ [1, 2, 2], atol=1e-5)
    np.testing.assert_allclose(pieces.measure_poses(line)[0][0], np.eye(3), atol=1e-5)


# Spaces whose vectors end with poses, seen in the smallest one: corners of a tetrahedron about their centre


@dataclass(frozen=True, eq=False)
class Sizes(PosedSpace):
    """Regular tetrahedra: the shape is the distance of the corners from the centre."""

    name = "sizes"
    shape_dim = 1
    shape_metric = np.ones(1)

    def measure_shape(self, x: Float) -> Float:
        return np.array([np.linalg.norm(x - x.mean(axis=0), axis=1).mean()])

    def rebuild_rows(self, shape: Float) -> Float:
        # Anywhere: neither upright nor at the origin.
        rows = shape * (tetrahedron()[0] / np.sqrt(3)) @ rotation((1.0, 2.0, 3.0)).T + 5.0
        return np.asarray(rows)


POINTS, FACES = tetrahedron()
SPACE = Sizes(Topology(FACES, 4), 2.0, POINTS / 2.0)


def test_a_vector_is_shape_rotation_and_centre() -> None:
    axis, angle = np.array([1.0, -2, 2]) / 3, 0.6
    vector = SPACE.encode((1.5 * POINTS @ rotation(axis * angle).T + [2.0, 4, 6])[None])
    quaternion = [np.cos(0.3), *np.sin(0.3) * axis]
    np.testing.assert_allclose(vector, [[1.5 * np.sqrt(3) / 2, *quaternion, 1, 2, 3]], atol=1e-12)
    assert SPACE.dim == 8
    assert (SPACE.rotation_count, SPACE.centre_count, SPACE.placement_dim) == (1, 1, 7)
    np.testing.assert_allclose(SPACE.weights, [1, *[np.sqrt(3)] * 4, 1, 1, 1])


def test_placements_are_poses() -> None:
    placements = np.random.default_rng(0).normal(size=(5, SPACE.placement_dim))
    poses = SPACE.unpack_placements(placements)
    assert poses.rotations.shape == (5, 1, 4)
    assert poses.centres.shape == (5, 1, 3)
    np.testing.assert_array_equal(SPACE.pack_placements(poses), placements)


def test_between_frames_a_body_turns_as_evenly_as_at_them() -> None:
    """By 150 degrees a frame; centres are the operator's."""
    angles, times = np.radians(150.0) * np.arange(6), np.arange(6) / 24
    path = np.random.default_rng(1).normal(size=(6, 3))
    points = np.stack([POINTS @ rotation((0.0, a, 0.0)).T + p for a, p in zip(angles, path, strict=True)])
    vectors = SPACE.encode(points)
    operator, at = TemporalOperator(times), np.array([0.0, 0.01, 0.1, 0.2])
    _, placements = SPACE.interpolate_poses(operator, vectors[:, :0], vectors[:, SPACE.shape_dim :], at)
    found = SPACE.decode(np.concatenate([np.repeat(vectors[:1, : SPACE.shape_dim], 4, axis=0), placements], axis=1))
    centres = operator.weights_at(at).interpolate(path)
    expected = [POINTS @ rotation((0.0, np.radians(150.0) * 24 * t, 0.0)).T for t in at]
    np.testing.assert_allclose(found, np.stack(expected) + centres[:, None], atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(motion=rigid_motions)
def test_rigid_motions_change_poses_only_and_come_back(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    points = (POINTS @ turn.T + shift)[None]
    vector = SPACE.encode(points)
    assert vector[0, 0] == pytest.approx(np.sqrt(3) / 2, abs=1e-12)
    np.testing.assert_allclose(SPACE.decode(vector), points, atol=1e-10)


def test_half_way_is_half_a_turn() -> None:
    axis, angle = np.array([1.0, 2, -2]) / 3, 3.0
    vectors = SPACE.encode(np.stack([POINTS, 3 * POINTS @ rotation(axis * angle).T + [1.0, 0, 0]]))
    half = SPACE.decode(vectors.mean(axis=0, keepdims=True))[0]
    np.testing.assert_allclose(half, 2 * POINTS @ rotation(axis * angle / 2).T + [0.5, 0, 0], atol=1e-12)


def test_a_body_that_turns_twice_goes_on_block_by_block() -> None:
    angles = np.linspace(0, 4 * np.pi, 13)
    points = np.stack([POINTS @ rotation((0.0, 0, angle)).T for angle in angles])
    vectors = SPACE.encode(points)
    expected = np.stack([np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)], axis=1)
    np.testing.assert_allclose(vectors[:, 1:5], expected, atol=1e-12)
    assert (SPACE.encode_independently(points)[:, 1] >= 0).all()
    np.testing.assert_allclose(SPACE.encode(points[6:], vectors[5]), vectors[6:], atol=1e-13)
    np.testing.assert_array_equal(SPACE.unwrap(SPACE.encode_independently(points)), vectors)


def test_vectors_of_other_spaces_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"vectors have shape \(2, 6\); \(T, 8\) is expected"):
        SPACE.decode(np.zeros((2, 6)))
    with pytest.raises(SettingsError, match=r"\(8,\)"):
        SPACE.decode(np.zeros(8))
