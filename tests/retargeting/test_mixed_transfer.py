"""Transfer in the mixed space: parts, poses and joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.mesh.rigid import kabsch
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.mixed_transfer import MixedTransfer, mixed_transfer
from mixseq.retargeting.parts import PartPoses, RestShapes
from mixseq.segmentation.joints import decompose
from mixseq.segmentation.methods import segment_by_labels
from mixseq.shells.fitting import ShellSettings
from mixseq.types import Float
from tests.meshes import Mesh, bent, joined, rotation, tetrahedron, topology_of, tube
from tests.retargeting.pairs import furthest, gradients, same, subdivided, to_subdivided

TUBE = tube(8, 33, radius=0.3)
ELBOW = 1.3
"""Radians."""


def lengthened(points: Float, thicker: float = 1.0) -> Float:
    """Bones of 3 and 1.5 for two of 2; the elbow is at z = 3."""
    below, above = np.minimum(points[:, 2], 2.0), np.maximum(points[:, 2] - 2.0, 0.0)
    return np.stack([thicker * points[:, 0], thicker * points[:, 1], 1.5 * below + 0.75 * above], axis=1)


def moving(source: Mesh, target: Mesh, frames: Float, correspondence: Correspondence | None = None) -> MixedTransfer:
    """Two parts that meet at z = 2."""
    halves = (source[0][source[1]].mean(axis=1)[:, 2] > 2).astype(np.int64)
    labels = segment_by_labels(halves, topology_of(source))
    made = gradients(source, target, correspondence or same(source))
    return mixed_transfer(made, frames, labels, 3, ShellSettings())


def placed(method: MixedTransfer, x: Float) -> PartPoses:
    return method.transfer_poses(x, method.rest_shapes.register(method.deform_by_gradients(x[None])[0])[1])


@pytest.mark.parametrize("finer", [False, True], ids=["same triangles", "finer"])
@pytest.mark.parametrize(("thicker", "degrees"), [(1.0, 0.2), (2.0, 2.5)])  # 0.015 and 2.2
def test_bones_keep_their_lengths_and_take_the_angle(finer: bool, thicker: float, degrees: float) -> None:
    x = bent(TUBE[0], ELBOW, blend=0.3)
    target, correspondence = (lengthened(TUBE[0], thicker), TUBE[1]), same(TUBE)
    if finer:
        target, correspondence = subdivided(target), to_subdivided(TUBE)
    method = moving(TUBE, target, np.stack([TUBE[0], x]), correspondence)
    moved, rest = method.transfer_frames(x[None])[0], target[0]
    bones = np.flatnonzero(rest[:, 2] < 2.4), np.flatnonzero(rest[:, 2] > 3.4)
    turns, shifts = zip(*(kabsch(rest[bone], moved[bone]) for bone in bones), strict=True)
    between = turns[0].T @ turns[1]
    assert abs(np.arccos((np.trace(between) - 1) / 2) - ELBOW) < np.radians(degrees)
    # Bones are as they were, but for a bulge at the elbow that is as thick as they are.
    for bone, turn, shift in zip(bones, turns, shifts, strict=True):
        assert furthest(rest[bone] @ turn.T + shift, moved[bone]) < (0.003 if thicker == 1 else 0.025) * 4.5
        ends = [bone[rest[bone, 2] == pick(rest[bone, 2])] for pick in (np.min, np.max)]
        length, own = (np.linalg.norm(np.diff([x[end].mean(axis=0) for end in ends], axis=0)) for x in (moved, rest))
        assert length == pytest.approx(own, rel=5e-3)
    # The elbow of both is at the same place.
    first, second = (turn @ [0.0, 0.0, 3.0] + shift for turn, shift in zip(turns, shifts, strict=True))
    assert np.linalg.norm(first - second) < 0.02 * 4.5


def test_part_offsets_scale_with_the_target() -> None:
    """A telescope: the gap between parts is that of the source, as large as the target is."""
    x = TUBE[0] + np.clip((TUBE[0][:, 2:] - 1.9) / 0.2, 0.0, 1.0) * [0.0, 0.0, 0.4]
    size, turn = 3.0, rotation((0.4, -1.0, 2.0))
    target = size * TUBE[0] @ turn.T, TUBE[1]
    method = moving(TUBE, target, np.stack([TUBE[0], x]))
    poses, rest = placed(method, x), method.body.centres
    away = (poses.centres - rest) * method.gradients.target.scale
    np.testing.assert_allclose(away[1] - away[0], size * turn @ [0.0, 0.0, 0.4], atol=0.05 * 0.4 * size)


def test_root_travel_scales_with_the_stride() -> None:
    method = moving(TUBE, (lengthened(TUBE[0]), TUBE[1]), TUBE[0][None])
    way = np.array([0.3, 1.0, -2.0])
    rest = method.rest_shapes.centres
    for stride in (1.0, 1.7):
        centres = placed(replace(method, stride_ratio=stride), TUBE[0] + way).centres
        expected = stride * method.gradients.alignment.scale * way / method.gradients.target.scale
        np.testing.assert_allclose(centres - rest, np.tile(expected, (2, 1)), atol=1e-9)


def test_given_poses_replace_transferred_poses() -> None:
    """Other poses move the target rigidly with them: the whole, if all parts move as one."""
    target = lengthened(TUBE[0]), TUBE[1]
    x = bent(TUBE[0], ELBOW, blend=0.3)
    method = moving(TUBE, target, np.stack([TUBE[0], x]))
    own = placed(method, x)
    given = PartPoses(own.rotations[None], own.centres[None])
    np.testing.assert_array_equal(method.transfer_frames(x[None], given)[0], method.transfer_frames(x[None])[0])
    turn, shift = rotation((0.3, 2.0, -0.5)), np.array([1.0, 2.0, 3.0])
    told = PartPoses((turn @ own.rotations)[None], (own.centres @ turn.T + shift)[None])
    expected = method.transfer_frames(x[None])[0] @ turn.T + shift * method.gradients.target.scale
    assert furthest(method.transfer_frames(x[None], told)[0], expected) < 1e-7


def test_disconnected_pieces_are_linked() -> None:
    """An eye on the upper bone turns with it, in its own place."""
    eye = 0.1 * tetrahedron()[0] + [0.0, 0.45, 3.5], tetrahedron()[1]
    source = joined(TUBE, eye)
    target = lengthened(source[0]), source[1]
    x = bent(source[0], ELBOW, blend=0.3)
    method = moving(source, target, np.stack([source[0], x]))
    assert method.body.pairs.tolist()[0] == [0, 1]
    assert len(method.body.pairs) == 2
    assert 2 in method.body.pairs[1]
    moved = method.transfer_frames(x[None])[0]
    upper = np.flatnonzero(target[0][:, 2] > 3.6)
    turn, shift = kabsch(target[0][upper], moved[upper])
    assert furthest(target[0][upper] @ turn.T + shift, moved[upper]) < 5e-3


def test_a_mesh_of_one_part_moves_as_gradients_move_it() -> None:
    target = lengthened(TUBE[0]), TUBE[1]
    x = bent(TUBE[0], 0.2, blend=3.0)
    made = gradients(TUBE, target)
    alone = np.zeros(len(TUBE[1]), dtype=np.int64)
    method = mixed_transfer(made, x[None], alone, 3, ShellSettings())
    moved, other = method.transfer_frames(x[None])[0], made.transfer_frames(x[None])[0]
    np.testing.assert_allclose(moved - moved.mean(axis=0), other - other.mean(axis=0), atol=1e-9)


def test_parts_are_registered_to_their_shapes() -> None:
    labels = (TUBE[0][TUBE[1]].mean(axis=1)[:, 2] > 2).astype(np.int64)
    parts = RestShapes.from_decomposition(decompose(topology_of(TUBE), labels, 3), TUBE[0])
    turn, shift = rotation((1.0, 2.0, -0.5)), np.array([3.0, 1.0, 0.0])
    aligned, poses = parts.register(TUBE[0] @ turn.T + shift)
    np.testing.assert_allclose(aligned, parts.shapes, atol=1e-9)
    np.testing.assert_allclose(poses.rotations, np.tile(turn, (2, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(poses.centres, parts.centres @ turn.T + shift, atol=1e-9)


def test_frames_do_not_depend_on_other_frames() -> None:
    target = subdivided((lengthened(TUBE[0]), TUBE[1]))
    x = bent(TUBE[0], ELBOW, blend=0.3)
    first = moving(TUBE, target, np.stack([TUBE[0], x]), to_subdivided(TUBE))
    second = moving(TUBE, target, np.stack([TUBE[0], x]), to_subdivided(TUBE))
    alone = first.transfer_frames(x[None])
    np.testing.assert_array_equal(second.transfer_frames(np.stack([TUBE[0], x, 1.1 * x]))[1:2], alone)
