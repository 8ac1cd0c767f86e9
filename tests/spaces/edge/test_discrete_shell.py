"""Whole meshes from lengths and angles, piece by piece."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import ReconstructionError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.geometry.rigid import kabsch
from mixseq.shells.fitting import ShellSettings
from mixseq.spaces.edge.discrete_shell import DiscreteShell
from mixseq.spaces.edge.projection import EdgeProjection
from mixseq.spaces.edge.volume import volume
from tests.meshes import Float, Mesh, joined, pages, tetrahedron, topology_of, torus, tube

MESH: Mesh = joined(tube(6, 9), tetrahedron(), torus(9, 5), pages(3, 4, 2))
STRAY = np.concatenate([MESH[0], [[9.0, 9, 9]]])


def shell() -> DiscreteShell:
    """A mesh of four pieces, one of them no manifold, and a vertex that no face uses."""
    topology = topology_of((STRAY, MESH[1]))
    owner = topology.component_of_face
    faces = [np.flatnonzero(owner == number) for number in range(owner.max() + 1)]
    vertices = [np.unique(topology.faces[each]).astype(np.int64) for each in faces]
    return DiscreteShell(topology, [*vertices, topology.unused_vertices], [*faces, np.zeros(0, dtype=int)])


def measured(made: DiscreteShell) -> tuple[Float, Float]:
    return edge_lengths(STRAY, made.topology.edges), dihedral_angles(STRAY, made.topology.hinges)


def test_pieces_come_back() -> None:
    made = shell()
    projection: EdgeProjection = made
    lengths, angles = measured(made)
    projection.prepare()
    rows, reports = projection.rebuild(lengths, angles, 1 / lengths, ShellSettings())
    assert len(reports) == 4
    assert all(report.converged for report in reports)
    assert len(rows) == made.row_count == len(STRAY)
    start = 0
    for vertices in made.vertices:
        own = rows[start : start + len(vertices)]
        rotation, translation = kabsch(own, STRAY[vertices])
        np.testing.assert_allclose(own @ rotation.T + translation, STRAY[vertices], atol=1e-9)
        start += len(vertices)


def test_edges_that_do_not_count_and_lengths_that_cannot_be() -> None:
    made = shell()
    lengths, angles = measured(made)
    weights = 1 / lengths
    weights[0] = 0.0
    lengths[1] = -1.0
    rows, _ = made.rebuild(lengths, angles, weights, ShellSettings())
    assert np.isfinite(rows).all()


def test_what_is_not_finite_is_refused() -> None:
    made = shell()
    lengths, angles = measured(made)
    angles[0] = np.nan
    with pytest.raises((ReconstructionError, np.linalg.LinAlgError)):
        made.rebuild(lengths, angles, 1 / lengths, ShellSettings())


def test_volumes_of_pieces() -> None:
    made = shell()
    volumes = made.volumes(STRAY)
    assert volumes[1] == pytest.approx(8 / 3)
    assert volumes[2] == pytest.approx(volume(*torus(9, 5)))
    assert volumes[-1] == 0
    weights = made.volume_weights(STRAY)
    np.testing.assert_allclose(weights[1:3] * np.abs(volumes[1:3]), 1.0)
    assert weights[-1] == made.areas(STRAY)[-1] == 0
    assert made.areas(STRAY)[1] == pytest.approx(8 * np.sqrt(3))
