"""Clustering: what is updated step by step is what a fresh look would give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.topology import Topology, face_patches
from mixseq.segmentation import motion
from mixseq.segmentation import motion as clusters
from mixseq.segmentation.elements import Elements, Trajectories, face_areas
from mixseq.segmentation.motion import Clusters, Moments, moments, moments_of, motions_of, tally
from mixseq.types import Float, Index, Mask
from tests.meshes import SEQUENCES, bending, pages, seeds, topology_of, torus, tube


def faces_of(topology: Topology, frames: Float) -> Elements:
    return Elements.from_faces(topology, Trajectories(frames), face_areas(frames[0], topology))


MESH = torus(12, 7)
TOPOLOGY = topology_of(MESH)
FRAMES = bending(MESH, frames=4) + 0.02 * np.random.default_rng(2).normal(size=(4, *MESH[0].shape))
FACES = faces_of(TOPOLOGY, FRAMES)


def gathered(inside: Mask) -> Moments:
    """Moments of the marked faces, a third of each area on every corner."""
    weights = np.zeros(len(MESH[0]))
    np.add.at(weights, MESH[1][inside], np.repeat(FACES.weights[inside, None], 3, axis=1))
    return moments(FRAMES[0], FRAMES.transpose(1, 0, 2), weights)


def test_tallies_are_moments() -> None:
    labels = np.arange(len(MESH[1])) % 3
    tallies = tally(FACES, labels, 3)
    motions = motions_of(tallies, FACES.trajectories).reshape(3, 4, 3, 4)
    for k, found in enumerate(moments_of(tallies, FACES.trajectories)):
        expected = gathered(labels == k)
        for field in Moments.__dataclass_fields__:
            np.testing.assert_allclose(getattr(found, field), getattr(expected, field), atol=1e-12)
        turn, shift = expected.motion()
        np.testing.assert_allclose(motions[k, :, :, :3], turn, atol=1e-9)
        np.testing.assert_allclose(motions[k, :, :, 3], shift, atol=1e-9)


def by_definition(labels: Index, rounds: int) -> Float:
    """Costs ``(F, K)``, written down without short cuts."""
    topology = topology_of(MESH)
    columns = []
    for k in range(int(labels.max()) + 1):
        turn, shift = gathered(labels == k).motion()
        away = FRAMES - (np.einsum("tij,vj->tvi", turn, FRAMES[0]) + shift[:, None])
        columns.append(np.square(away).sum(axis=2).mean(axis=0)[MESH[1]].mean(axis=1))
    costs = np.stack(columns, axis=1)
    weights = topology.face_adjacency.toarray() + np.eye(len(costs))
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(np.linalg.matrix_power(weights, rounds) @ costs)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, rounds=st.integers(0, 4))
def test_elements_go_to_the_cheapest_cluster(seed: int, rounds: int) -> None:
    labels = np.random.default_rng(seed).integers(0, 4, len(MESH[1]))
    clusters = Clusters(FACES, labels, 4)
    for _ in range(3):  # also after some have moved, when only what changed is computed again
        used, dense = np.unique(clusters.labels, return_inverse=True)
        costs = by_definition(dense, rounds)
        lowest = clusters.assign(rounds)
        np.testing.assert_allclose(lowest, costs.min(axis=1), rtol=1e-3, atol=1e-7)
        own = costs[np.arange(len(costs)), np.searchsorted(used, clusters.labels)]
        np.testing.assert_allclose(own, costs.min(axis=1), rtol=1e-3, atol=1e-7)


def test_costs_may_be_found_a_few_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    labels = np.random.default_rng(0).integers(0, 20, len(MESH[1]))
    together = Clusters(FACES, labels, 20)
    monkeypatch.setattr(clusters, "_MAX_WORK_NUMBERS", 1)
    apart = Clusters(FACES, labels, 20)
    for _ in range(3):
        np.testing.assert_array_equal(apart.assign(2), together.assign(2))
        np.testing.assert_array_equal(apart.labels, together.labels)


def test_a_seed_becomes_a_cluster() -> None:
    clusters = Clusters(FACES, np.zeros(len(FACES), dtype=np.int64), 2)
    before = clusters.labels
    clusters.seed(FACES.ball(5, 10), 1)
    assert (before == 0).all()
    assert 10 <= clusters.labels.sum() < len(FACES)


def test_a_cluster_that_is_left_by_all_stays_empty() -> None:
    clusters = Clusters(FACES, np.zeros(len(FACES), dtype=np.int64), 2)
    clusters.seed(FACES.ball(5, 10), 1)
    clusters.seed(np.arange(len(FACES)), 0)
    lowest = clusters.assign(1)
    assert (clusters.labels == 0).all()
    assert np.isfinite(lowest).all()


def test_balls_grow_ring_by_ring() -> None:
    faces = faces_of(topology_of(tube(6, 9, closed=False)), tube(6, 9, closed=False)[0][None])
    assert faces.ball(20, 1).tolist() == sorted(set(faces.neighbourhoods[20].tolist()) - {len(faces)})
    assert len(faces.ball(20, 10**6)) == len(faces)


def test_cells_cover_the_mesh() -> None:
    for mesh in (tube(8, 30), pages(3, 8, 3)):
        topology = topology_of(mesh)
        areas = face_areas(mesh[0], topology)
        cells, cell_of_face = Elements.from_cells(topology, Trajectories(mesh[0][None]), areas)
        assert len(cells) < len(mesh[0]) / 2
        assert set(cell_of_face.tolist()) <= set(range(len(cells)))
        assert cells.weights.sum() == pytest.approx(areas.sum())
        # Centres are not beside each other, and every vertex is one or beside one.
        centres = [int(np.flatnonzero((mesh[0] == p).all(axis=1))[0]) for p in cells.trajectories.rows[:, -4:-1]]
        graph = topology.vertex_adjacency
        assert graph[centres][:, centres].nnz == 0
        assert (np.asarray(graph[centres].sum(axis=0)) + np.isin(np.arange(len(mesh[0])), centres) > 0).all()


def test_what_is_left_of_a_cluster_is_not_rounding() -> None:
    """All but a face without area leave: its motion must still be that of the face."""
    faces = replace(FACES, weights=np.where(np.arange(len(FACES)) == 3, 1e-17, 1.0))
    clusters = Clusters(faces, np.zeros(len(faces), dtype=np.int64), 2)
    clusters.seed(np.flatnonzero(np.arange(len(faces)) != 3), 1)
    clusters.assign(0)
    assert clusters.labels[3] == 0  # three points with a motion of their own are predicted best by it


@pytest.mark.parametrize("name", SEQUENCES)
def test_dense_meshes_are_cut_by_cells_first(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = SEQUENCES[name]()
    topology = Topology(sequence.faces, sequence.vertex_count)
    monkeypatch.setattr(motion, "MAX_FACES_WITHOUT_CELLS", 0)
    labels = motion.segment_by_motion(sequence.points, topology)
    for part in range(labels.max() + 1):
        assert face_patches(topology, labels == part).max() == 0


def test_cells_find_the_same_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = tube(24, 61)
    topology, points = topology_of(mesh), bending(mesh, angle=1.2)
    by_faces = motion.segment_by_motion(points, topology)
    monkeypatch.setattr(motion, "MAX_FACES_WITHOUT_CELLS", 0)
    by_cells = motion.segment_by_motion(points, topology)
    assert by_faces.max() == by_cells.max() == 1
    agree = (by_faces == by_cells).mean()
    assert max(agree, 1 - agree) > 0.9
