"""The free placement, the paper's: aligned parts, joints by lengths and angles, a pose for every component."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.arrays import Float
from mixseq.errors import ReconstructionError
from mixseq.geometry.rigid import kabsch
from mixseq.geometry.rotations import rotations_of
from mixseq.segmentation import decompose
from mixseq.shells.shell import Relaxation
from mixseq.spaces import mixed_space
from mixseq.spaces.mixed import FreeSpace
from tests.meshes import topology_of, tube
from tests.spaces.mixed.made import anchored, free, sequence_of


def rms(differences: Float) -> float:
    return float(np.sqrt(np.mean(differences**2)))


def test_parts_are_aligned_and_the_first_of_a_component_has_a_pose() -> None:
    space, points = free("rigid component"), sequence_of("rigid component").points
    x, blocks = points / space.scale, space.split(space.encode(points))
    np.testing.assert_allclose(blocks.lengths.mean(axis=0), space.reference_lengths, atol=1e-14)
    parts = space.decomposition.parts
    assert blocks.parts.shape[1] == sum(map(len, parts)) == len(space.shapes)
    starts = np.cumsum([0, *map(len, parts)])
    for pose, part in enumerate(space.projection.posed):
        rows = slice(starts[part], starts[part + 1])
        moved = blocks.parts[:, rows] @ np.swapaxes(rotations_of(blocks.rotations[:, pose]), 1, 2)
        np.testing.assert_allclose(moved + blocks.centres[:, pose, None], x[:, parts[part]], atol=1e-12)
    for part in range(len(parts)):  # every frame of a part is aligned to its mean shape
        rows = slice(starts[part], starts[part + 1])
        turns, shifts = kabsch(space.shapes[rows], blocks.parts[:, rows])
        np.testing.assert_allclose(turns, np.broadcast_to(np.eye(3), turns.shape), atol=1e-7)
        np.testing.assert_allclose(shifts, 0, atol=1e-12)


def test_a_pose_for_every_component() -> None:
    space = free("rigid component")
    assert space.rotation_count == space.centre_count == len(space.projection.posed) == 2
    assert anchored("rigid component").rotation_count == 3


def test_joints_are_known_but_for_what_parts_have() -> None:
    space = free("bar")
    joint = space.decomposition.joints[0]
    edges = space.topology.edges[joint.edge_ids]
    held = [np.isin(edges, part).all(axis=1) for part in space.decomposition.parts]
    np.testing.assert_array_equal(space.edge_ids, joint.edge_ids[~np.any(held, axis=0)])


def test_the_metric_is_in_diagonals() -> None:
    space = free("bar")
    weights = space.split(space.weights[None])
    for block in (weights.parts, weights.centres, weights.lengths):
        assert (block == 1).all()
    hinges = space.topology.hinges[space.hinge_ids]
    edges = np.linalg.norm(space.reference[hinges[:, 1]] - space.reference[hinges[:, 0]], axis=1)
    np.testing.assert_allclose(weights.angles[0], 0.3 * edges, rtol=1e-12)
    assert (weights.rotations[0] == 2 * space.radii[space.projection.posed, None]).all()


def test_half_way_the_joint_bends_by_half() -> None:
    """Averaged vertices, which shorten and fold what turns, are the yardstick."""
    space, points = free("bar"), sequence_of("bar").points
    middle = space.encode(points)[[0, 4]].mean(axis=0, keepdims=True)
    decoded = space.decode(middle)
    averaged = points[[0, 4]].mean(axis=0, keepdims=True)
    wanted, got, plain = (
        space.split(vectors)
        for vectors in (middle, space.encode(decoded, middle[0]), space.encode(averaged, middle[0]))
    )
    assert rms(got.angles - wanted.angles) < 0.3 * rms(plain.angles - wanted.angles)
    assert rms(got.lengths - wanted.lengths) < 0.1 * rms(plain.lengths - wanted.lengths)
    assert np.abs(got.parts - wanted.parts).max() < 0.02


def test_lengths_of_reference_are_means_over_all_frames() -> None:
    """A tube that is twice as large in one of four frames: lengths are 1.25 times those of the first."""
    mesh = tube(6, 13)
    points = np.stack([mesh[0], mesh[0], 2 * mesh[0], mesh[0]])
    topology = topology_of(mesh)
    labels = (mesh[0][mesh[1]].mean(axis=1)[:, 2] > 2).astype(np.int64)
    space = mixed_space(points, topology, decompose(topology, labels, 3), "free")
    assert isinstance(space, FreeSpace)
    ends = mesh[0][topology.edges[space.edge_ids]] / space.scale
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    np.testing.assert_allclose(space.reference_lengths, 1.25 * lengths, rtol=1e-12)


def test_steps_make_lengths_and_angles_agree() -> None:
    """They lower the energy, and none is taken where there is nothing to do."""
    space = free("bar")
    vectors = space.encode(sequence_of("bar").points)
    middle = vectors[[0, 4]].mean(axis=0, keepdims=True)
    (half,), (first,) = list(space.frames(middle)), list(space.frames(vectors[:1]))
    with_steps = {n: replace(space, relaxation=Relaxation(steps=n)).projection for n in (0, 6, 10, 100)}
    none, few, many = (with_steps[n].assemble(half).energy for n in (0, 10, 100))
    assert many <= 1.001 * few < 0.5 * none
    still, moved = (with_steps[n].assemble(first) for n in (0, 6))
    np.testing.assert_array_equal(still.points, moved.points)


def test_a_point_that_is_not_finite_is_refused() -> None:
    space = free("bar")
    vectors = space.encode(sequence_of("bar").points[:1])
    vectors[0, 3] = np.nan
    with pytest.raises(ReconstructionError, match="not finite"):
        space.decode(vectors)


@pytest.mark.parametrize("blend", [0.0, 0.4])
def test_velocities_are_derivatives_of_decoded_points(blend: float) -> None:
    space, points = free("bar"), sequence_of("bar").points
    vectors = space.encode(points)
    rate = (vectors[2] - vectors[1])[None]
    vector = vectors[1] + blend * rate
    decoded, velocities = space.decode_moving(vector, rate)
    step = 1e-3
    ahead, behind = (space.decode(vector + sign * step * rate) for sign in (1, -1))
    quotient = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(decoded, space.decode(vector), atol=1e-12)
    assert np.abs(velocities - quotient).max() < 1e-3 * np.abs(quotient).max()
