"""Suggested markers match corresponding points in any poses; nothing is suggested where it is not sure."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import mixseq
from mixseq.creature import walk_cycle
from mixseq.mesh.topology import Topology
from mixseq.retargeting.bodies import CoarseBody, subdivide
from mixseq.retargeting.markers import Markers
from mixseq.retargeting.proposals import (
    Poses,
    Proposal,
    contradict,
    extend_tip_map,
    find_best_map,
    find_pose_pair,
    propose_markers,
    similarity_residuals,
)
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Index
from tests.meshes import grid, rotation, topology_of, torus, tube
from tests.retargeting.foxes import long_legs, on_bones, short, tall
from tests.retargeting.test_bodies import TIPS

pytestmark = pytest.mark.slow

NOTHING = np.zeros(0, np.int64)
TIP_BONES = sorted(TIPS)


def still(points: np.ndarray, faces: np.ndarray) -> MeshSequence:
    return MeshSequence.from_arrays(points[None], faces, fps=24)


@cache
def walking() -> tuple[Poses, Poses]:
    """The walk of the short fox, and two frames of the tall one's on longer legs, turned."""
    frames = walk_cycle(4).points
    turned = rotation((0.1, 0.6, 0.0))
    tall_frames = np.stack([100.0 * long_legs(points) @ turned.T for points in frames[1:3]])
    return (frames[:, short().vertices], short().topology), (tall_frames[:, tall().vertices], tall().topology)


@cache
def proposed() -> Proposal:
    return propose_markers(*walking())


def joined_bones(pairs: Markers) -> list[tuple[str, str]]:
    return [(short().bones[s], tall().bones[t]) for s, t in zip(pairs.source, pairs.target, strict=True)]


def test_walking_foxes_of_different_proportions_correspond() -> None:
    found = proposed()
    assert not found.doubt
    pairs = joined_bones(found.markers)
    tips = pairs[: found.tip_count]
    assert all(one == other for one, other in tips)
    assert {one for one, _ in tips} <= TIPS
    assert len(tips) >= 5
    assert 12 <= len(pairs) <= 46
    sides = [(one[-2:], other[-2:]) for one, other in pairs]
    assert not {(".l", ".r"), (".r", ".l")} & set(sides)


def test_markers_of_moved_copies_are_exact() -> None:
    """Two poses of one body with a known map: other frames of the same walk."""
    poses, topology = walking()[0]
    found = propose_markers((poses[:2], topology), (3 * poses[2:] @ rotation((0.4, -1.0, 0.3)).T, topology))
    assert not found.doubt
    source, target = (poses[0][vertices] for vertices in (found.markers.source, found.markers.target))
    distances = np.linalg.norm(source - target, axis=1) / np.linalg.norm(np.ptp(poses[0], axis=0))
    assert np.median(distances) < 0.01
    assert np.max(distances) < 0.06


@cache
def bodies() -> tuple[CoarseBody, CoarseBody]:
    first, second = (CoarseBody.from_poses(*poses, 700, NOTHING) for poses in walking())
    return first, second


def tip_pairs(first_bones: list[str], second_bones: list[str]) -> Index:
    """Pairs of coarse vertices near the tips on bones."""
    columns = []
    for body, fox, bones in zip(bodies(), (short(), tall()), (first_bones, second_bones), strict=True):
        points = fox.points[on_bones(fox, *bones)]
        coarse = fox.points[body.surface.vertices]
        columns.append(np.linalg.norm(coarse[None] - points[:, None], axis=2).argmin(axis=1))
    return np.stack(columns, axis=1)


def test_a_map_with_left_and_right_exchanged_has_a_worse_score() -> None:
    exchanged = [{"l": bone[:-1] + "r", "r": bone[:-1] + "l"}.get(bone[-1], bone) for bone in TIP_BONES]
    assert sorted(exchanged) == TIP_BONES
    right, wrong = (extend_tip_map(*bodies(), tip_pairs(TIP_BONES, partners)) for partners in (TIP_BONES, exchanged))
    assert contradict(wrong.pairs, right.pairs)
    assert not contradict(right.pairs, right.pairs)
    assert wrong.score > right.score + 0.015


def test_handedness_changes_its_sign_in_a_mirror_and_not_with_the_pose() -> None:
    poses, topology = walking()[0]
    reversed_faces = np.ascontiguousarray(topology.faces[:, ::-1])
    mirrored = poses * [1, 1, -1], Topology(reversed_faces, topology.vertex_count)
    whole = len(poses[0])  # not decimated, so that all have the same vertices
    body, mirror, other_pose = (
        CoarseBody.from_poses(some, its_topology, whole, NOTHING)
        for some, its_topology in ((poses, topology), mirrored, (poses[2:], topology))
    )
    tips = on_bones(short(), *TIP_BONES)
    values = body.handedness(tips).reshape(-1)
    for other, sign in ((mirror, -1), (other_pose, 1)):
        assert np.corrcoef(values, sign * other.handedness(tips).reshape(-1))[0, 1] > 0.9


def test_the_most_similar_poses_are_found() -> None:
    """The tall fox has frames 1 and 2 of the walk."""
    found = find_pose_pair(*bodies(), tip_pairs(TIP_BONES, TIP_BONES))
    assert found.poses in {(1, 0), (2, 1)}


def test_residuals_of_similar_poses_vanish() -> None:
    points = short().points
    poses = np.stack([points, 3 * points @ rotation((1.0, 0.2, 0.3)).T + 5, points * [1, 1, -1]])
    residuals = similarity_residuals(poses, points)
    np.testing.assert_allclose(residuals[:2], 0, atol=1e-6)
    assert residuals[2] > 0.1  # a mirror image is not similar


def test_a_subdivision_keeps_the_surface() -> None:
    points, faces = grid(3, 2)
    poses, topology = subdivide(np.stack([points, 2 * points]), topology_of((points, faces)))
    assert np.array_equal(poses[:, : len(points)], [points, 2 * points])
    assert len(topology.faces) == 4 * len(faces)
    corners = poses[:, topology.faces]
    areas = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])[..., 2] / 2
    np.testing.assert_allclose(areas, np.array([[0.125], [0.5]]) * np.ones(len(topology.faces)))


@pytest.mark.parametrize("mesh", [torus(20, 12), tube(12, 30)])
def test_bodies_without_limbs_get_no_suggestions(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    points, faces = mesh
    assert len(mixseq.suggest_markers(still(points, faces), still(2 * points, faces))) == 0
    assert len(mixseq.suggest_markers(short().mesh, still(points, faces))) == 0


def test_known_markers_are_kept_and_followed() -> None:
    bones = ["nose", "forepaw.l", "hindpaw.l"]
    known = Markers.from_pairs(np.stack([on_bones(short(), *bones), on_bones(tall(), *bones)], axis=1), tuple(bones))
    found = propose_markers(*walking(), known)
    assert not found.doubt
    assert np.array_equal(found.markers.source[:3], known.source)
    assert found.markers.names[:4] == (*bones, "")
    assert all(one == other for one, other in joined_bones(found.markers)[: found.tip_count])


def test_no_map_has_too_few_tips() -> None:
    points, faces = tube(12, 30)
    body = CoarseBody.from_poses(points[None], topology_of((points, faces)), 700, NOTHING)
    assert find_best_map(body, body) is None
