"""Free vertices that follow the parts around them."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.mesh.rotations import matrices
from mixseq.retargeting.joints import HarmonicSkin
from mixseq.segmentation.joints import make_joint
from mixseq.shells.fitting import Patch, rebuild
from mixseq.shells.gauss_newton import ShellSettings
from mixseq.types import Float
from tests.meshes import topology_of, tube

SIDES, RINGS = 6, 9
BAR, FACES = tube(SIDES, RINGS, length=8.0, closed=False)
RING = np.arange(SIDES * RINGS) // SIDES
OWNER = np.where(RING < 2, 0, np.where(RING >= RINGS - 2, 4, -1))
"""The ends belong to the parts 0 and 4."""


@pytest.fixture
def patch() -> Patch:
    topology = topology_of((BAR, FACES))
    whole = make_joint(topology, np.ones(len(FACES), dtype=bool), np.zeros(len(BAR), dtype=bool))
    return Patch.of_joint(topology, whole, OWNER >= 0)


def motions(first: Float, last: Float, shift: Float) -> tuple[Float, Float]:
    """Rotation vectors of the parts 0 and 4, and how far part 4 goes; the others are far away."""
    turns, shifts = np.full((5, 3), 2.0), np.full((5, 3), 1e6)
    turns[0], turns[4], shifts[0], shifts[4] = first, last, 0.0, shift
    return matrices(turns), shifts


def test_weights_are_harmonic(patch: Patch) -> None:
    """Along a tube they fall evenly from one end to the other."""
    skin = HarmonicSkin.of(patch, OWNER, BAR)
    assert skin.parts.tolist() == [0, 4]
    expected = (RING[patch.free] - 1) / (RINGS - 3)
    np.testing.assert_allclose(skin.weights[:, 1], expected, atol=1e-12)
    np.testing.assert_allclose(skin.weights.sum(axis=1), 1.0, atol=1e-12)


def test_a_common_motion_moves_the_joint_rigidly(patch: Patch) -> None:
    turn, shift = np.array([0.3, -1.0, 0.5]), np.zeros(3)
    placed = HarmonicSkin.of(patch, OWNER, BAR).place(*motions(turn, turn, shift))
    np.testing.assert_allclose(placed, BAR[patch.free] @ matrices(turn).T, atol=1e-12)


def test_vertices_follow_in_proportion(patch: Patch) -> None:
    shift = np.array([0.0, 2.0, 0.0])
    skin = HarmonicSkin.of(patch, OWNER, BAR)
    placed = skin.place(*motions(np.zeros(3), np.zeros(3), shift))
    np.testing.assert_allclose(placed - skin.rest, skin.weights[:, 1:] * shift, atol=1e-12)


def test_the_start_of_lower_energy_is_taken(patch: Patch) -> None:
    """With a bar that is too short for its lengths, a good guess is kept and a bad one is not."""
    lengths = edge_lengths(BAR, patch.edges)[patch.free_edges]
    angles = dihedral_angles(BAR, patch.hinges)[patch.free_hinges]
    squeezed = BAR.copy()
    squeezed[RING >= RINGS - 2, 2] -= 1.0
    no_steps = ShellSettings(iterations=0)
    unguided, report = rebuild(patch, lengths, angles, 1 / lengths, squeezed, no_steps)
    bad = unguided[patch.free] + np.linspace(0.0, 1.0, len(patch.free))[:, None]
    kept, same = rebuild(patch, lengths, angles, 1 / lengths, squeezed, no_steps, guess=bad)
    np.testing.assert_array_equal(kept, unguided)
    assert same.energy == report.energy
    best, settled = rebuild(patch, lengths, angles, 1 / lengths, squeezed, ShellSettings())
    assert settled.converged
    assert settled.energy < report.energy
    taken, _ = rebuild(patch, lengths, angles, 1 / lengths, squeezed, no_steps, guess=best[patch.free])
    np.testing.assert_array_equal(taken, best)
