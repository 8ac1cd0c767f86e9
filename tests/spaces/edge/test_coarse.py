"""Coarse meshes, and what they carry over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.geometry.rigid import kabsch
from mixseq.shells.fitting import ShellSettings
from mixseq.spaces.edge.coarse import CoarseShell
from mixseq.spaces.edge.discrete_shell import DiscreteShell, Wanted
from tests.meshes import Float, bent, joined, rotation, tetrahedron, topology_of, tube

TUBE = tube(10, 41)
MESH = joined(TUBE, tetrahedron())


def shells(count: int) -> CoarseShell:
    topology = topology_of(MESH)
    owner = topology.component_of_face
    faces = [np.flatnonzero(owner == number) for number in (0, 1)]
    vertices = [np.unique(topology.faces[each]).astype(np.int64) for each in faces]
    return CoarseShell.of(DiscreteShell(topology, vertices, faces), MESH[0], count)


def wanted(shell: DiscreteShell, x: Float) -> Wanted:
    lengths = edge_lengths(x, shell.topology.edges)
    none = np.zeros(0)
    return Wanted(lengths, dihedral_angles(x, shell.topology.hinges), 1 / lengths, none, none)


def test_coarse_vertices_are_vertices() -> None:
    made = shells(60)
    rows = np.concatenate(list(made.fine.vertices))
    assert rows[made.kept_rows].tolist() == made.kept.tolist()
    assert made.coarse.topology.vertex_count == made.coarse.row_count == len(made.kept)
    assert made.coarse.topology.unused_vertices.size == 0
    assert len(made.kept) == pytest.approx(60, abs=4)
    assert len(made.coarse.vertices[1]) == 4


@pytest.mark.parametrize("steps", [0, 3])
def test_meshes_come_back(steps: int) -> None:
    made = shells(60)
    made.prepare()
    x = bent(MESH[0], 1.2) @ rotation((3.0, 1.0, 0.2)).T
    coarsely = wanted(made.coarse, x[made.kept])
    rows, reports = made.fit(wanted(made.fine, x), coarsely, ShellSettings(), steps)
    assert len(reports) == 4
    assert all(report.converged for report in reports)
    start = 0
    for vertices in made.fine.vertices:
        own = rows[start : start + len(vertices)]
        turn, shift = kabsch(own, x[vertices])
        np.testing.assert_allclose(own @ turn.T + shift, x[vertices], atol=1e-9)
        start += len(vertices)


def test_the_coarse_mesh_decides_where_a_mesh_goes() -> None:
    """Angles with noise bend the linear start as a whole; the coarse mesh, which is sure, puts it right."""
    made = shells(60)
    x = bent(MESH[0], 1.2)
    told = wanted(made.fine, x)
    noise = 0.03 * np.random.default_rng(0).normal(size=len(told.angles))
    (fine, _), (coarse, _) = made.fine.pieces, made.coarse.pieces
    assert fine is not None
    assert coarse is not None
    problem = made.fine.problem(0, fine, replace_angles(told, told.angles + noise), ShellSettings())
    places = x[made.kept][coarse.rows]
    carried = made.carriers[0]
    assert carried is not None
    result = carried.carried(problem.lengths, problem.angles, places)
    away = np.linalg.norm(result - x[: len(result)], axis=1).max()
    only, _ = made.fine.fit(replace_angles(told, told.angles + noise), replace(ShellSettings(), iterations=0))
    turn, shift = kabsch(only[: len(result)], x[: len(result)])
    linear = np.linalg.norm(only[: len(result)] @ turn.T + shift - x[: len(result)], axis=1).max()
    assert away < 0.5 * linear


def replace_angles(told: Wanted, angles: Float) -> Wanted:
    return told._replace(angles=angles)
