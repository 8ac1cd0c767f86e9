from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from mixseq.mesh.measures import edge_lengths
from mixseq.mesh.topology import Topology
from mixseq.types import Float, Index
from scripts.paper_study.common.stitching import Seams, stitch
from tests.meshes import bent, joined, seeds, tetrahedron, topology_of, tube

BAR = tube(6, 9)
MESH = joined((bent(BAR[0], 1.0), BAR[1]), tetrahedron())


def cut(topology: Topology, points: Float) -> list[Index]:
    """Pieces that overlap by two rings: below, in the middle, above, and the tetrahedron."""
    z, body = BAR[0][:, 2], np.arange(len(BAR[0]))
    return [body[z < 2], body[(z > 1) & (z < 3)], body[z >= 2], np.arange(len(body), len(points))]


def own_lengths(topology: Topology) -> Float:
    return np.full(len(topology.edges), np.nan)


def test_pieces_that_agree_give_the_mesh() -> None:
    topology = topology_of(MESH)
    pieces = cut(topology, MESH[0])
    seams = Seams.of(topology, pieces)
    result = stitch(seams, MESH[0][np.concatenate(pieces)], own_lengths(topology))
    np.testing.assert_allclose(result, MESH[0], atol=1e-12)
    lengths = edge_lengths(MESH[0], topology.edges)
    np.testing.assert_allclose(stitch(seams, MESH[0][np.concatenate(pieces)], lengths), MESH[0], atol=1e-12)


def test_edges_get_the_lengths_asked_for() -> None:
    topology = topology_of(MESH)
    pieces = cut(topology, MESH[0])
    lengths = 2 * edge_lengths(MESH[0], topology.edges)
    result = stitch(Seams.of(topology, pieces), MESH[0][np.concatenate(pieces)], lengths)
    np.testing.assert_allclose(edge_lengths(result, topology.edges), lengths, atol=1e-11)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_the_edges_fit_best_in_the_least_squares_sense(seed: int) -> None:
    """Compared with NumPy's dense least squares on the edges of all pieces (the paper's equation 1)."""
    rng = np.random.default_rng(seed)
    topology = topology_of(MESH)
    pieces = cut(topology, MESH[0])
    points = MESH[0][np.concatenate(pieces)]
    points = points + 0.1 * rng.normal(size=points.shape)
    lengths = np.where(rng.random(len(topology.edges)) < 0.5, np.nan, rng.uniform(0.5, 1.5))
    result = stitch(Seams.of(topology, pieces), points, lengths)

    rows, wanted, start = [], [], 0
    for piece in pieces:
        place = {int(v): start + k for k, v in enumerate(piece)}
        for (i, j), length in zip(topology.edges.tolist(), lengths, strict=True):
            if i in place and j in place:
                side = points[place[j]] - points[place[i]]
                unit = side / np.linalg.norm(side)
                row = np.zeros(len(MESH[0]))
                row[i], row[j] = -1, 1
                rows.append(row)
                wanted.append(side if np.isnan(length) else length * unit)
        start += len(piece)
    dense = np.linalg.lstsq(np.stack(rows), np.stack(wanted), rcond=None)[0]
    ends = topology.edges
    np.testing.assert_allclose(
        result[ends[:, 1]] - result[ends[:, 0]], dense[ends[:, 1]] - dense[ends[:, 0]], atol=1e-9
    )


def test_pieces_that_differ_are_averaged() -> None:
    """One piece in two copies, the second one moved and swollen: the result is half way."""
    topology = topology_of(tetrahedron())
    points = tetrahedron()[0]
    seams = Seams.of(topology, [np.arange(4), np.arange(4)])
    result = stitch(seams, np.concatenate([points, 3 * points + [4.0, 0, 0]]), own_lengths(topology))
    np.testing.assert_allclose(result, 2 * points + [2.0, 0, 0], atol=1e-12)


def test_components_stay_where_their_pieces_are() -> None:
    topology = topology_of(MESH)
    pieces = cut(topology, MESH[0])
    moved = MESH[0] + np.where(np.arange(len(MESH[0])) >= len(BAR[0]), 5.0, 0.0)[:, None]
    result = stitch(Seams.of(topology, pieces), moved[np.concatenate(pieces)], own_lengths(topology))
    np.testing.assert_allclose(result, moved, atol=1e-12)


def test_vertices_without_edges_are_where_their_copies_are_on_average() -> None:
    topology = Topology(np.array([[0, 1, 2]]), 5)
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [7, 8, 9], [1, 1, 1], [3, 1, 1]])
    seams = Seams.of(topology, [np.array([0, 1, 2, 3, 4]), np.array([4])])
    result = stitch(seams, points, own_lengths(topology))
    np.testing.assert_allclose(result, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [7, 8, 9], [2, 1, 1]], atol=1e-12)


@pytest.mark.parametrize("length", [0.0, np.nan])
def test_edges_of_no_length_are_allowed(length: float) -> None:
    topology = Topology(np.array([[0, 1, 2]]), 3)
    points = np.array([[1.0, 1, 1], [1, 1, 1], [2, 1, 1]])
    result = stitch(Seams.of(topology, [np.arange(3)]), points, np.array([length, np.nan, np.nan]))
    np.testing.assert_allclose(result, points, atol=1e-12)
