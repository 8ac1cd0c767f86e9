"""Cutting a spanning tree, where hinges are known to bend."""

from __future__ import annotations

import numpy as np

from mixseq.mesh.topology import Topology
from mixseq.segmentation.methods import adjusted_rand_index
from mixseq.segmentation.silhouettes import SpanningTreeSettings, segment_by_spanning_tree
from mixseq.types import Float, Index
from tests.meshes import grid, rotation
from tests.segmentation.bones import three_bones


def folding(crease: int = 3, angle: float = 1.0) -> tuple[Float, Index]:
    """A sheet of 4 x 8 squares that folds sharply about the line x = crease, in four frames."""
    points, faces = grid(4, 8)
    beyond = points[:, 0] > crease
    frames = []
    for t in np.linspace(0, angle, 4):
        x = points.copy()
        x[beyond] = (points[beyond] - [crease, 0, 0]) @ rotation((0, t, 0)).T + [crease, 0, 0]
        frames.append(x)
    return np.stack(frames), faces


def test_the_plain_tree_is_cut_exactly_at_a_crease() -> None:
    """No smoothing: hinges bend at the crease and nowhere else."""
    points, faces = folding()
    labels = segment_by_spanning_tree(
        points, Topology(faces, points.shape[1]), settings=SpanningTreeSettings(radius=0.0)
    )
    beyond = points[0][faces].mean(axis=1)[:, 0] > 3
    np.testing.assert_array_equal(labels, np.where(beyond, 0, 1))  # the larger part is number 0


def test_small_bends_are_noise() -> None:
    points, faces = folding(angle=np.radians(0.09))
    assert segment_by_spanning_tree(points, Topology(faces, points.shape[1])).max() == 0
    points, faces = folding(angle=np.radians(9.0))
    assert segment_by_spanning_tree(points, Topology(faces, points.shape[1])).max() == 1


def test_parts_below_the_least_area_are_not_cut_off_unless_asked_for() -> None:
    points, faces = folding(crease=1)  # an eighth
    topology = Topology(faces, points.shape[1])
    large = SpanningTreeSettings(radius=0.0, small_region=0.2)
    assert segment_by_spanning_tree(points, topology, settings=large).max() == 0
    labels = segment_by_spanning_tree(points, topology, 2, large)
    assert np.bincount(labels).tolist() == [56, 8]


def test_noise_does_not_hide_the_bones() -> None:
    sequence, bones = three_bones()
    topology = Topology(sequence.faces, sequence.vertex_count)
    noise = np.random.default_rng(5).normal(0.0, 0.002, sequence.points.shape)
    labels = segment_by_spanning_tree(sequence.points + noise, topology, 3)
    assert adjusted_rand_index(labels, bones) > 0.8
