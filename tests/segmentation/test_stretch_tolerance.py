"""Joints inside parts: where blends of registered frames would shorten edges."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.segmentation import decompose
from mixseq.segmentation.stretch_tolerance import CORE, StretchTolerance
from mixseq.topology import Topology, face_patches, vertices_of
from tests.meshes import grid, rotation, topology_of, tube


def folded(angle: float, columns: int = 24) -> tuple[Topology, np.ndarray]:
    """A sheet whose right quarter turns by an angle about the line x = 18 between two frames."""
    points, faces = grid(6, columns)
    turned = points.copy()
    right = points[:, 0] > 18.0
    turned[right] = (points[right] - [18.0, 0, 0]) @ rotation((0.0, angle, 0.0)).T + [18.0, 0, 0]
    return topology_of((points, faces)), np.stack([points, turned])


def test_rigid_parts_are_not_soft() -> None:
    points, faces = tube(8, 10)
    moved = points @ rotation((0.3, 1.0, -0.4)).T + [1.0, 2, 3]
    topology = topology_of((points, faces))
    whole = [np.ones(len(points), dtype=bool)]
    depth = StretchTolerance(np.stack([points, moved]), 1e-9).depth(topology, whole)
    assert not depth.any()


def test_a_hinge_inside_a_part_is_a_joint() -> None:
    topology, frames = folded(np.pi / 2)
    depth = StretchTolerance(frames, 0.01).depth(topology, [np.ones(topology.vertex_count, dtype=bool)])
    x = frames[0, :, 0]
    # The larger piece is what the part is registered by; the other turns against it as a whole.
    assert not depth[x < 15].any()
    assert (depth[x >= 18] >= 2).all()


@pytest.mark.parametrize(("degrees", "is_soft"), [(10.0, False), (20.0, True)])
def test_the_threshold_is_a_share_of_length(degrees: float, is_soft: bool) -> None:
    # Blending two edges at an angle 2 phi leaves cos(phi) of their length.
    topology, frames = folded(np.radians(degrees))
    tolerance = 1.0 - np.cos(np.radians(7.5))
    depth = StretchTolerance(frames, tolerance).depth(topology, [np.ones(topology.vertex_count, dtype=bool)])
    assert bool((depth >= 2).any()) == is_soft


def test_parts_keep_a_core() -> None:
    points, faces = tube(8, 20)
    crumpled = points + np.random.default_rng(3).normal(scale=0.2, size=points.shape)
    topology = topology_of((points, faces))
    depth = StretchTolerance(np.stack([points, crumpled]), 1e-6).depth(
        topology, [np.ones(len(points), dtype=bool)]
    )
    firm = (depth[topology.faces] <= 1).all(axis=1)
    assert CORE <= firm.mean() < 0.5


def test_decompositions_stay_valid() -> None:
    topology, frames = folded(np.pi / 2)
    labels = (frames[0][topology.faces].mean(axis=1)[:, 1] > 3.0).astype(np.int64)
    plain = decompose(topology, labels, 2, frames)
    soft = decompose(topology, labels, 2, frames, StretchTolerance(frames, 0.01))
    for before, after in zip(plain.parts, soft.parts, strict=True):
        assert set(after) < set(before)
        held = np.isin(np.arange(topology.vertex_count), after)
        assert held[topology.faces].all(axis=1).any()
    covered = soft.joint_of_face >= 0
    for part in soft.parts:
        covered |= np.isin(topology.faces, part).all(axis=1)
    assert covered.all()
    for joint in soft.joints:
        inside = np.zeros(len(topology.faces), dtype=bool)
        inside[joint.face_ids] = True
        assert face_patches(topology, inside).max() == 0
        assert (vertices_of(topology, inside).sum()) == len(joint.vertices)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, np.inf])
def test_refusals(tolerance: float) -> None:
    with pytest.raises(SettingsError, match="a positive share of an edge's length is expected"):
        StretchTolerance(np.zeros((2, 3, 3)), tolerance)
