"""Whole meshes from lengths and angles, piece by piece, by both projections."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import ReconstructionError
from mixseq.mesh.measures import dihedral_angles, edge_lengths, volume, wrap
from mixseq.mesh.rigid import kabsch
from mixseq.shells.gauss_newton import ShellSettings
from mixseq.spaces.edge import DiscreteShell, EdgeProjection, RelaxedShell, Wanted
from mixseq.spaces.pieces import Pieces
from mixseq.types import Float
from tests.meshes import Mesh, bent, grid, joined, pages, tetrahedron, topology_of, torus, tube

MESH: Mesh = joined(tube(6, 9), tetrahedron(), torus(9, 5), pages(3, 4, 2))
STRAY: Mesh = np.concatenate([MESH[0], [[9.0, 9, 9]]]), MESH[1]
"""A mesh of four pieces, one of them no manifold, and a vertex that no face uses."""

KINDS = "steps", "dso"


def projection_of(kind: str, mesh: Mesh) -> EdgeProjection:
    topology = topology_of(mesh)
    pieces = Pieces.of(topology, mesh[0])
    if kind == "dso":
        return DiscreteShell(topology, pieces)
    return RelaxedShell(topology, pieces, edge_lengths(mesh[0], topology.edges), ShellSettings().bending)


def wanted(lengths: Float, angles: Float, weights: Float | None = None) -> Wanted:
    return Wanted(lengths, 1 / lengths if weights is None else weights, angles, np.zeros(0), np.zeros(0))


def measured(mesh: Mesh, x: Float) -> tuple[Float, Float]:
    topology = topology_of(mesh)
    return edge_lengths(x, topology.edges), dihedral_angles(x, topology.hinges)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [0.0, 0.1])
def test_pieces_come_back(kind: str, size: float) -> None:
    """The reference, and a mesh that is not."""
    made = projection_of(kind, STRAY)
    made.prepared()
    x = STRAY[0] + size * np.random.default_rng(3).normal(size=STRAY[0].shape)
    rows, reports = made.fit(wanted(*measured(STRAY, x)), ShellSettings())
    assert all(report.converged for report in reports)
    assert len(rows) == len(x)
    pieces = Pieces.of(topology_of(STRAY), STRAY[0])
    for place, vertices in zip(pieces.slices, pieces.vertices, strict=True):
        rotation, translation = kabsch(rows[place], x[vertices])
        np.testing.assert_allclose(rows[place] @ rotation.T + translation, x[vertices], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_edges_that_do_not_count_and_lengths_that_cannot_be(kind: str) -> None:
    lengths, angles = measured(STRAY, STRAY[0])
    weights = 1 / lengths
    weights[0] = 0.0
    lengths[1] = -1.0
    rows, _ = projection_of(kind, STRAY).fit(wanted(lengths, angles, weights), ShellSettings())
    assert np.isfinite(rows).all()


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_not_finite_is_refused(kind: str) -> None:
    lengths, angles = measured(STRAY, STRAY[0])
    angles[0] = np.nan
    with pytest.raises((ReconstructionError, np.linalg.LinAlgError)):
        projection_of(kind, STRAY).fit(wanted(lengths, angles), ShellSettings())


@pytest.mark.parametrize("mesh", [tube(8, 31, length=6.0), grid(25, 7)], ids=["tube", "sheet"])
def test_steps_go_nearly_as_far_as_gauss_newton(mesh: Mesh) -> None:
    """Half-way between bends to both sides, one of them stretched: no mesh has these lengths and angles.

    Steps leave folds as they are, which costs a tenth of the energy on the sheet.
    """
    points, along = mesh[0], int(np.argmax(np.ptp(mesh[0], axis=0)))
    upright = np.roll(points, 2 - along, axis=1)
    ends = bent(upright, -1.2, 3.0, 1.0) * [1.2, 1.0, 1.0], bent(upright, 1.2, 3.0, 1.0)
    first, last = (measured(mesh, x) for x in ends)
    lengths, angles = (first[0] + last[0]) / 2, first[1] + wrap(last[1] - first[1]) / 2
    settings = ShellSettings(tolerance=1e-10, accuracy=1e-10)
    (_, (ours,)), (_, (best,)) = (
        projection_of(kind, mesh).fit(wanted(lengths, angles), settings) for kind in KINDS
    )
    assert 1e-3 < ours.energy < 1.1 * best.energy


def test_volumes_of_pieces() -> None:
    topology = topology_of(STRAY)
    made = DiscreteShell(topology, Pieces.of(topology, STRAY[0]))
    volumes = made.volumes(STRAY[0])
    assert volumes[1] == pytest.approx(8 / 3)
    assert volumes[2] == pytest.approx(volume(*torus(9, 5)))
    assert volumes[-1] == 0
    weights = made.volume_weights(STRAY[0])
    np.testing.assert_allclose(weights[1:3] * np.abs(volumes[1:3]), 1.0)
    assert weights[-1] == made.areas(STRAY[0])[-1] == 0
    assert made.areas(STRAY[0])[1] == pytest.approx(8 * np.sqrt(3))
