"""Settling: between far poses lengths and angles agree; at poses nothing moves, and nothing jumps in between."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.arrays import Float
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.operations.interpolation import PoseInterpolator
from mixseq.sequence import MeshSequence
from mixseq.signals import fit
from mixseq.spaces.mixed import AnchoredSpace
from tests.meshes import SEQUENCES, rotation, tube


def curled() -> MeshSequence:
    """A tube, straight and curled up to a ring: no part of it is rigid."""
    points, faces = tube(8, 41, length=10.0)
    turns = np.pi * (points[:, 2] / 10.0)
    frames = [points]
    for share in (0.5, 1.0):
        angle = np.maximum(share * turns, 1e-9)
        radius = points[:, 2] / angle
        ring = np.stack([np.zeros_like(angle), radius * (np.cos(angle) - 1), radius * np.sin(angle)], axis=1)
        across = points * [1, 1, 0]
        turned = np.stack([rotation((a, 0, 0)) @ x for a, x in zip(angle, across, strict=True)])
        frames.append(ring + turned)
    return MeshSequence.from_arrays(np.stack(frames), faces)


CURLED = curled()


def blend_of(*among: int) -> PoseInterpolator:
    blend = PoseInterpolator.of(CURLED, among=among, parts=3)
    assert isinstance(blend.space, AnchoredSpace) and blend.space.relaxation.steps
    return blend


def strain(x: Float) -> float:
    """Largest relative error of a length half-way between the first and the last pose."""
    edges = blend_of(0, 2).space.topology.edges  # type: ignore[attr-defined]
    wanted = edge_lengths(CURLED.points[[0, 2]], edges).mean(axis=0)
    return float(np.abs(edge_lengths(x, edges) / wanted - 1).max())


def test_poses_stay_what_they_are() -> None:
    blend = blend_of(0, 2)
    for weights, pose in (([1, 0], 0), ([0, 1], 2)):
        np.testing.assert_allclose(blend.at(weights), CURLED.points[pose], atol=1e-9)


def test_half_way_a_tube_is_half_curled_up() -> None:
    found = blend_of(0, 2).at([0.5, 0.5])
    plain = CURLED.points[[0, 2]].mean(axis=0)
    assert strain(found) < 0.05 < 0.3 < strain(plain)
    distances = [np.linalg.norm(x[:8].mean(axis=0) - x[-8:].mean(axis=0)) for x in (found, CURLED.points[1])]
    assert distances[0] == pytest.approx(distances[1], rel=0.1)


def test_nothing_jumps_between_poses() -> None:
    blend = blend_of(0, 2)
    path = np.stack(list(blend.along([[1 - w, w] for w in np.linspace(0, 1, 65)])))
    steps = np.linalg.norm(np.diff(path, axis=0), axis=2).max(axis=1)
    assert steps.max() < 2.5 * np.median(steps)


def test_the_farther_poses_are_apart_the_more_steps_are_taken() -> None:
    spaces = [PoseInterpolator.of(CURLED, among=among, parts=3).space for among in ((0, 0), (0, 1), (0, 2))]
    steps = [space.relaxation.steps for space in spaces if isinstance(space, AnchoredSpace)]
    assert steps[0] == 0 and 6 <= steps[1] < steps[2] <= 20


def test_velocities_are_those_of_settled_points() -> None:
    space = blend_of(0, 2).space
    vectors = space.encode(CURLED.points[[0, 2]])
    vector, rate = vectors[:1], (vectors[1:] - vectors[:1]) * 0.01
    _, velocities = space.decode_moving(vector + 20 * rate, rate)
    ahead, behind = (space.decode(vector + (20 + step) * rate) for step in (0.01, -0.01))
    assert np.linalg.norm(velocities - (ahead - behind) / 0.02) < 1e-3 * np.linalg.norm(velocities)


def test_no_vertex_shakes_between_poses() -> None:
    """Steps that are too long for the curvature of the energy, or unfold what is folded, would leave fast moves."""
    space = blend_of(0, 2).space
    first, last = space.encode(CURLED.points[[0, 2]])
    rate = (last - first)[None]
    vectors = first + np.linspace(0.02, 0.98, 25)[:, None] * rate
    _, velocities = space.decode_moving(vectors, np.repeat(rate, 25, axis=0))
    speeds = np.linalg.norm(velocities, axis=2).max(axis=1)
    assert speeds.max() < 5 * np.median(speeds)


@pytest.mark.parametrize("name", ["several components", "zero area", "unused vertices", "repeated corners"])
def test_any_mesh_can_settle(name: str) -> None:
    """Where there are triangles without area, too, and vertices that no triangle uses."""
    sequence = SEQUENCES[name]()
    blend = PoseInterpolator.of(sequence)
    count = len(sequence.points)
    for pose in (0, count - 1):
        np.testing.assert_allclose(blend.at(np.eye(count)[pose]), sequence.points[pose], atol=1e-8)
    assert np.isfinite(blend.at(np.full(count, 1 / count))).all()


def test_models_of_far_poses_settle_between_frames_and_keep_their_frames() -> None:
    poses = MeshSequence.from_arrays(CURLED.points[[0, 2, 0]], CURLED.faces, fps=1.0)
    for model in (fit(poses, parts=1), fit(poses, parts=1, exact=True)):
        assert isinstance(model.space, AnchoredSpace) and model.space.relaxation.steps
        np.testing.assert_allclose(model.sample().points, poses.points, atol=1e-6)
        edges = model.space.topology.edges
        wanted = edge_lengths(CURLED.points[[0, 2]], edges)
        found = edge_lengths(model(0.5)[None], edges)[0]
        assert (found > 0.9 * wanted.min(axis=0)).all() and (found < 1.1 * wanted.max(axis=0)).all()


def test_models_of_few_numbers_and_of_near_frames_do_not_settle() -> None:
    far = MeshSequence.from_arrays(CURLED.points[[0, 2, 0, 2, 0, 2]], CURLED.faces)
    near = MeshSequence.from_arrays(
        (1 - np.linspace(0, 0.02, 6))[:, None, None] * CURLED.points[0], CURLED.faces
    )
    for model in (
        fit(far, parts=1, rank=1),
        fit(far, parts=1, knots=1),
        fit(near, parts=1),
        fit(near, exact=True),
    ):
        assert isinstance(model.space, AnchoredSpace)
        assert not (model.space.relaxation.steps or model.space.known.any())
