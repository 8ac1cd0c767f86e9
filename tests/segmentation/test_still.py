"""Parts of a single frame, by its shape: slices of a bar, limbs of a star, components."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mixseq.mesh.measures import triangle_areas
from mixseq.mesh.topology import Topology, face_patches
from mixseq.segmentation import segment_by_motion
from mixseq.segmentation.still import mean_surface_distances, segment_still
from mixseq.types import Float, Index
from tests.meshes import Mesh, grid, rotation, tube


def parts_of(mesh: Mesh, count: int) -> Index:
    points, faces = mesh
    topology = Topology(faces, len(points))
    return segment_still(points, topology, triangle_areas(points, faces), count)


def cross(width: float = 1.0, length: float = 6.0) -> Mesh:
    """A flat cross with four arms, uneven so that no distances are equal."""
    points, faces = grid(26, 26)
    points = points - [13.0, 13.0, 0.0] + np.random.default_rng(0).uniform(-0.05, 0.05, points.shape)
    near = np.abs(np.round(points[:, :2]))
    inside = (near.min(axis=1) <= width) & (near.max(axis=1) <= length)
    kept = faces[inside[faces].all(axis=1)]
    used = np.unique(kept)
    return points[used], np.searchsorted(used, kept).astype(np.int32)


def sizes(labels: Index) -> list[int]:
    return sorted(np.unique(labels, return_counts=True)[1].tolist())


@pytest.mark.parametrize("count", [3, 5])
def test_a_bar_is_cut_into_slices(count: int) -> None:
    points, faces = tube(8, 61, length=12.0)
    labels = parts_of((points, faces), count)
    heights = points[faces][:, :, 2].mean(axis=1)
    ends = sorted((heights[labels == part].min(), heights[labels == part].max()) for part in np.unique(labels))
    assert len(ends) == count
    assert all(before[1] <= after[0] + 0.25 for before, after in pairwise(ends)), "slices overlap"


def test_every_arm_of_a_cross_is_a_part_and_the_middle_is_one() -> None:
    points, faces = cross()
    labels = parts_of((points, faces), 5)
    centres = points[faces].mean(axis=1)
    tips = [int((centres @ direction).argmax()) for direction in np.vstack([np.eye(3)[:2], -np.eye(3)[:2]])]
    middle = int(np.linalg.norm(centres, axis=1).argmin())
    assert len(np.unique(labels[[*tips, middle]])) == 5


def test_distances_are_least_in_the_middle() -> None:
    points, faces = cross()
    distances = mean_surface_distances(points, Topology(faces, len(points)))
    assert np.linalg.norm(points[distances.argmin()]) <= 2.0
    assert distances.min() == 0.0
    assert np.linalg.norm(points[distances.argmax()]) >= 5.5


@pytest.mark.parametrize("count", [1, 2, 7])
def test_components_are_parts_and_parts_are_connected(count: int) -> None:
    (points, faces), shift = tube(6, 21), np.array([5.0, 0.0, 0.0])
    mesh = np.concatenate([points, points + shift]), np.concatenate([faces, faces + len(points)])
    labels, topology = parts_of(mesh, count), Topology(mesh[1], len(mesh[0]))
    assert len(np.unique(labels)) == max(count, 2)
    assert all(face_patches(topology, labels == part).max() == 0 for part in np.unique(labels))


def test_parts_turn_with_the_mesh() -> None:
    points, faces = cross()
    moved: Float = points @ rotation((0.3, 1.2, -0.4)).T + [3.0, -1.0, 2.0]
    assert sizes(parts_of((points, faces), 5)) == sizes(parts_of((moved, faces), 5))


def test_a_mesh_without_extent_is_one_part() -> None:
    points, faces = cross()
    assert len(np.unique(parts_of((np.zeros_like(points), faces), 4))) == 1


def test_segmentation_by_motion_takes_the_shape_of_a_single_frame() -> None:
    points, faces = cross()
    topology = Topology(faces, len(points))
    assert segment_by_motion(points[None], topology).max() == 0
    assert segment_by_motion(points[None], topology, 5).max() == 4
