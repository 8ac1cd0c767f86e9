"""Augmented silhouettes of shapes that have known ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.segmentation.methods import adjusted_rand_index
from mixseq.segmentation.silhouettes import (
    SilhouetteSettings,
    segment_by_silhouettes,
    significant_vertices,
    silhouette,
    viewpoints,
)
from tests.meshes import bar, grid, tetrahedron, topology_of, torus, tube
from tests.segmentation.bones import three_bones

pytestmark = pytest.mark.slow


def test_viewpoints_are_spread_over_a_half_sphere() -> None:
    directions = viewpoints(50)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert (directions[:, 2] > 0).all()
    assert np.linalg.norm(directions.mean(axis=0) - [0, 0, 0.5]) < 0.02  # the centroid of a half sphere
    apart = np.linalg.norm(directions[:, None] - directions, axis=2)[~np.eye(50, dtype=bool)]
    assert apart.min() > 0.5 * np.sqrt(2 * np.pi / 50)  # half the side of a square of equal area


def test_silhouette_of_a_tetrahedron() -> None:
    """Along a corner, three faces are visible and one is not: the silhouette is that one's outline."""
    points, faces = tetrahedron()
    topology = Topology(faces, 4)
    edges = topology.edges[topology.hinge_edges[silhouette(points, topology, points[0])]]
    assert sorted(edges.tolist()) == [[1, 2], [1, 3], [2, 3]]


def test_silhouette_of_a_tube() -> None:
    """From the side these are two lines along it, a quarter turn away to either side."""
    mesh = tube(8, 6, closed=False)
    points, topology = mesh[0], topology_of(mesh)
    edges = topology.edges[topology.hinge_edges[silhouette(points, topology, np.array([1.0, 0.02, 0.1]))]]
    assert len(edges) == 2 * 5
    np.testing.assert_allclose(points[edges][:, :, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(points[edges][:, :, 2], axis=1), 4.0 / 5)


def test_silhouettes_from_behind_are_the_same() -> None:
    mesh = torus(13, 7)
    direction = np.array([0.3, -0.5, 0.7])
    np.testing.assert_array_equal(
        silhouette(mesh[0], topology_of(mesh), direction), silhouette(mesh[0], topology_of(mesh), -direction)
    )


def test_a_flat_sheet_has_no_silhouette() -> None:
    mesh = grid(4, 4)
    assert not silhouette(mesh[0], topology_of(mesh), np.array([0.0, 0.6, 0.8])).any()


def test_what_deforms_most_is_significant() -> None:
    mesh = tube(8, 21)
    z = mesh[0][:, 2]
    deformation = np.exp(-((z - 2.0) ** 2))
    settings = SilhouetteSettings(share=0.3, silhouettes=40)
    significant = significant_vertices(mesh[0][None], topology_of(mesh), deformation, settings)
    assert significant.any()
    assert np.abs(z[significant] - 2.0).max() < 0.9
    assert significant[np.abs(z - 2.0) < 0.3].all()


def test_nothing_is_significant_where_nothing_deforms() -> None:
    mesh = tube(8, 21)
    still = np.full(len(mesh[0]), 1e-4)
    assert not significant_vertices(mesh[0][None], topology_of(mesh), still, SilhouetteSettings()).any()


def test_other_seeds_choose_other_views_but_find_the_same_bones() -> None:
    sequence, bones = three_bones()
    topology = Topology(sequence.faces, sequence.vertex_count)
    settings = SilhouetteSettings(silhouettes=20)
    for seed in (0, 1, 2):
        labels = segment_by_silhouettes(sequence.points, topology, settings=replace(settings, seed=seed))
        assert adjusted_rand_index(labels, bones) > 0.8


def test_more_silhouettes_than_there_are() -> None:
    sequence = bar()
    topology = Topology(sequence.faces, sequence.vertex_count)
    all_views = SilhouetteSettings(viewpoints=5, silhouettes=5 * sequence.frame_count)
    np.testing.assert_array_equal(
        segment_by_silhouettes(sequence.points, topology, settings=all_views),
        segment_by_silhouettes(sequence.points, topology, settings=replace(all_views, silhouettes=999, seed=8)),
    )


def test_parts_of_the_sheet_that_nobody_sees_deform() -> None:
    """A mesh without silhouettes is one part."""
    points, faces = grid(4, 4)
    flat = np.stack([points, 2.0 * points])
    assert segment_by_silhouettes(flat, Topology(faces, len(points))).max() == 0


@pytest.mark.parametrize(
    "settings", [{"viewpoints": 0}, {"silhouettes": 0}, {"eigenvectors": 0}, {"seed": -1}, {"share": 0.0}, {"time": -1}]
)
def test_settings_outside_their_range(settings: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=f"{next(iter(settings))}=.*expected"):
        SilhouetteSettings(**settings)  # type: ignore[arg-type]
