"""Transfer of deformation gradients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from mixseq.mesh.topology import Topology
from mixseq.retargeting.gradient_transfer import normalise_rows
from mixseq.retargeting.markers import Correspondence
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from tests.meshes import (
    SEQUENCES,
    Mesh,
    bending,
    bent,
    grid,
    joined,
    rigid_motions,
    rotation,
    tetrahedron,
    topology_of,
    tube,
)
from tests.retargeting.pairs import furthest, gradients, same, subdivided, to_subdivided


def shaped(points: Float) -> Float:
    """Another body on the same triangles: thicker, longer, with a waist."""
    waist = 1.6 - 0.4 * np.sin(1.5 * points[:, 2:])
    return np.asarray(points * [1.0, 1.2, 1.5] * np.concatenate([waist, waist, np.ones_like(waist)], axis=1))


def led(mesh: Mesh, follower: Mesh, leader: int) -> Correspondence:
    """Map a mesh to itself joined with a second mesh."""
    (own, own_faces), (others, other_faces) = map(len, mesh), map(len, follower)
    one, count = same(mesh), own + others
    return Correspondence(
        (own, own_faces),
        (count, own_faces + other_faces),
        np.concatenate([one.corners, np.full((others, 3), -1)]),
        np.concatenate([one.weights, np.zeros((others, 3))]),
        np.concatenate([one.faces, np.full(other_faces, -1)]),
        np.concatenate([one.leaders, np.full(others, leader)]),
    )


@pytest.mark.parametrize("name", SEQUENCES)
def test_transfer_to_the_same_mesh_is_identity(name: str) -> None:
    sequence: MeshSequence = SEQUENCES[name]()
    mesh = sequence.points[0].astype(np.float64), sequence.faces.astype(np.int64)
    method = gradients(mesh, mesh)
    moved = method.transfer_frames(sequence.points)
    assert furthest(moved, sequence.points) <= 1e-9 * sequence.diagonal


@given(rigid_motions)
@settings(max_examples=20, deadline=None)
def test_a_rigid_motion_of_the_source_is_one_of_the_target(motion: tuple[Float, Float]) -> None:
    """About the target's own middle, and as far as it is large."""
    turn, shift = motion
    source = joined(tube(6, 9), (0.3 * tetrahedron()[0] + [1.0, 0.0, 2.0], tetrahedron()[1]))
    lying = rotation((np.pi / 2, 0, 0))
    target = shaped(source[0]) @ lying.T, source[1]
    method = gradients(source, target)
    assert np.array_equal(method.alignment.rotation, lying.round())
    moved = method.transfer_frames((source[0] @ turn.T + shift)[None])[0]
    about = lying.round() @ turn @ lying.round().T
    root = np.arange(len(tube(6, 9)[0]))
    middle, way = target[0][root].mean(axis=0), (source[0] @ turn.T + shift - source[0])[root].mean(axis=0)
    expected = (target[0] - middle) @ about.T + middle + method.alignment.map_vectors(way)
    np.testing.assert_allclose(moved[root], expected[root], atol=1e-9)
    # The other piece turns along; the gap between the two is as wide as the source's, turned.
    np.testing.assert_allclose(moved, expected, atol=1e-9)


def test_a_linear_map_of_the_source_is_applied_to_the_target() -> None:
    """A longer tube has its triangles in the planes of the shorter one's, where a gradient is the map."""
    source = tube(8, 12)
    target = source[0] * [1.0, 1.0, 1.7], source[1]
    method = gradients(source, target)
    np.testing.assert_array_equal(method.alignment.rotation, np.eye(3))
    matrix = rotation((0.4, 1.0, -0.3)) @ [[1.3, 0.2, 0.1], [0.0, 0.8, -0.3], [0.0, 0.0, 1.1]]
    moved, expected = method.transfer_frames((source[0] @ matrix.T)[None])[0], target[0] @ matrix.T
    np.testing.assert_allclose(moved - moved.mean(axis=0), expected - expected.mean(axis=0), atol=1e-9)
    way = (source[0] @ matrix.T - source[0]).mean(axis=0)
    np.testing.assert_allclose(moved.mean(axis=0) - target[0].mean(axis=0), method.alignment.scale * way, atol=1e-9)


@pytest.mark.parametrize("size", [0.1, 1.0, 25.0])
def test_a_copy_of_any_size_moves_as_the_source(size: float) -> None:
    source, turn = tube(6, 9), rotation((0.5, -1.1, 2.0))
    target = size * source[0] @ turn.T + [4.0, 5.0, 6.0], source[1]
    method = gradients(source, target)
    for x in bending(source):
        expected = size * x @ turn.T + [4.0, 5.0, 6.0]
        assert furthest(method.transfer_frames(x[None])[0], expected) <= 1e-9 * size * 4


def test_gradients_of_a_coarse_mesh_move_its_subdivision() -> None:
    """Where triangles are cut, the pieces move as the whole does: exactly."""
    source = tube(6, 9)
    method = gradients(source, subdivided(source), to_subdivided(source))
    for x in bending(source):
        assert furthest(method.transfer_frames(x[None])[0], subdivided((x, source[1]))[0]) <= 1e-9


def test_gaps_between_pieces_scale_with_the_target() -> None:
    body, lid = tube(6, 9), tetrahedron()
    source = joined(body, (0.2 * lid[0] + [0.0, 0.0, 4.5], lid[1]))
    count = len(body[0])
    turn = rotation((0.0, np.pi / 2, 0.0)).round()
    # The target's lid is farther away from its body at rest.
    apart = shaped(source[0])
    apart[count:] += [0.0, 0.0, 1.0]
    target = apart @ turn.T, source[1]
    method = gradients(source, target)
    assert np.array_equal(method.alignment.rotation, turn)
    opened, away = source[0].copy(), np.array([0.3, -0.2, 0.9])
    opened[count:] += away
    moved = method.transfer_frames(opened[None])[0]
    np.testing.assert_allclose(moved[:count], target[0][:count], atol=1e-9)
    np.testing.assert_allclose(moved[count:], target[0][count:] + method.alignment.map_vectors(away), atol=1e-9)


def test_held_components_rotate_with_their_holder() -> None:
    """A rigid lid at the tip of a bar that bends: the gap turns along, and stays as wide."""
    body, lid = tube(6, 25), tetrahedron()
    source = joined(body, (0.2 * lid[0] + [0.0, 0.0, 4.5], lid[1]))
    target = source[0] * [1.0, 1.0, 1.4], source[1]
    method = gradients(source, target)
    moved = method.transfer_frames(bent(source[0], 1.2)[None])[0]
    (tip,), count = method.attachments.holder_vertices, len(body[0])
    turn = rotation((1.2, 0.0, 0.0))
    expected = (target[0][count:] - target[0][tip]) @ turn.T + moved[tip]
    np.testing.assert_allclose(moved[count:], expected, atol=1e-9)


def test_followers_move_rigidly_with_leaders() -> None:
    body, hat = tube(6, 25), (0.3 * tetrahedron()[0] + [0.0, 0.7, 3.8], tetrahedron()[1])
    leader = 6 * 23 + 1  # near the upper end
    target = joined(body, hat)
    method = gradients(body, target, led(body, hat, leader))
    moved = method.transfer_frames(bent(body[0], 1.2)[None])[0]
    count = len(body[0])
    np.testing.assert_allclose(moved[:count], bent(body[0], 1.2), atol=1e-9)
    turn = rotation((1.2, 0.0, 0.0))
    expected = (target[0][count:] - target[0][leader]) @ turn.T + moved[leader]
    np.testing.assert_allclose(moved[count:], expected, atol=1e-9)


def test_an_unmatched_patch_follows() -> None:
    """Vertices within a piece may follow others of it, and turn with these."""
    mesh = tube(8, 25)
    correspondence = same(mesh)
    top = np.append(np.arange(8 * 23, 8 * 25), 8 * 25 + 1)  # two rings and the cap
    corners, weights = correspondence.corners.copy(), correspondence.weights.copy()
    leaders = correspondence.leaders.copy()
    corners[top], weights[top], leaders[top] = -1, 0.0, 8 * 22
    faces = np.where(np.isin(mesh[1], top).any(axis=1), -1, correspondence.faces)
    some = replace(correspondence, corners=corners, weights=weights, leaders=leaders, faces=faces)
    moved = gradients(mesh, mesh, some).transfer_frames(bent(mesh[0], 1.2)[None])[0]
    centred = bent(mesh[0], 1.2)
    np.testing.assert_allclose(moved - moved[0], centred - centred[0], atol=1e-9)


def test_means_are_over_triangles_around_a_point() -> None:
    sheet = grid(1, 2)  # vertex 1 is in three triangles of equal area, 0 in two
    method = gradients(sheet, sheet)
    weights = method.averaging_matrix(np.array([0, 1])).toarray()
    around = Topology(sheet[1], 6).faces
    np.testing.assert_allclose(weights, [np.any(around == v, axis=1) / np.sum(around == v) for v in (0, 1)])


def test_rows_of_weights_add_to_one() -> None:
    rows = normalise_rows(gradients(grid(2, 2), grid(2, 2)).averaging_matrix(np.array([4])) * 3.0)
    assert rows.sum() == pytest.approx(1.0)
    assert normalise_rows(rows * 0.0).sum() == 0.0


def test_a_source_in_single_precision_is_computed_in_double() -> None:
    mesh = tube(6, 9)
    method = gradients(mesh, mesh)
    single = bending(mesh)[2].astype(np.float32)
    np.testing.assert_array_equal(
        method.transfer_frames(single[None])[0], method.transfer_frames(single.astype(np.float64)[None])[0]
    )
    assert topology_of(mesh).vertex_count == len(method.transfer_frames(single[None])[0])
