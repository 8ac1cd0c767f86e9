"""Linear reconstruction: exact on lengths and angles of real meshes, whatever their connectivity."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.mesh.rigid import kabsch, transform_points
from mixseq.segmentation.joints import make_joint
from mixseq.shells.fitting import Patch, linear_initialisation
from mixseq.types import Float
from tests.meshes import Mesh, bent, flipped, grid, pages, rigid_motions, seeds, tetrahedron, topology_of, torus, tube

CYLINDER = tube(8, 9, closed=False)
BAR = tube(6, 17)
MESHES: dict[str, Mesh] = {
    "one triangle": (np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]]), np.array([[0, 1, 2]])),
    "tetrahedron": tetrahedron(),
    "flat sheet": grid(4, 5),
    "cylinder": CYLINDER,
    "closed bar, bent": (bent(BAR[0], 1.4), BAR[1]),
    "torus": torus(12, 6),
    "three faces at an edge": pages(3, 5, 2),
    "five faces at an edge": pages(5, 4, 2),
    "turned over at random": (CYLINDER[0], flipped(CYLINDER[1])),
    "pages turned over at random": (pages(3, 5, 2)[0], flipped(pages(3, 5, 2)[1], 2)),
    "inside out": (BAR[0], BAR[1][:, ::-1].copy()),
}


def patch_of(mesh: Mesh, fixed: Float | None = None) -> Patch:
    topology = topology_of(mesh)
    every = np.ones(len(mesh[1]), dtype=bool)
    nothing = np.zeros(len(mesh[0]), dtype=bool)
    joint = make_joint(topology, every, nothing)
    return Patch.from_joint(topology, joint, nothing if fixed is None else fixed.astype(bool))


def rebuilt(mesh: Mesh, patch: Patch) -> Float:
    points = mesh[0]
    given_points = np.where(patch.fixed_mask[:, None], points, np.nan)  # free positions are not looked at
    return linear_initialisation(
        patch, edge_lengths(points, patch.edges), dihedral_angles(points, patch.hinges), given_points
    )


@pytest.mark.parametrize("name", MESHES)
def test_exact_up_to_a_rigid_motion(name: str) -> None:
    mesh = MESHES[name]
    result = rebuilt(mesh, patch_of(mesh))
    turn, shift = kabsch(result, mesh[0])
    np.testing.assert_allclose(transform_points(result, turn, shift), mesh[0], atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1)


@pytest.mark.parametrize("name", sorted(set(MESHES) - {"one triangle"}))
def test_exact_in_place_where_faces_are_fixed(name: str) -> None:
    mesh = MESHES[name]
    rng = np.random.default_rng(3)
    fixed = np.zeros(len(mesh[0]))
    fixed[mesh[1][0]] = fixed[mesh[1][-1]] = 1
    fixed[rng.integers(0, len(fixed), len(fixed) // 4)] = 1
    np.testing.assert_allclose(rebuilt(mesh, patch_of(mesh, fixed)), mesh[0], atol=1e-9)


def test_nothing_to_solve_for() -> None:
    mesh = tetrahedron()
    np.testing.assert_array_equal(rebuilt(mesh, patch_of(mesh, np.ones(4))), mesh[0])


@settings(max_examples=12, deadline=None)
@given(seed=seeds, motion=rigid_motions, name=st.sampled_from(list(MESHES)), free=st.booleans())
def test_exact_on_crumpled_meshes_anywhere(seed: int, motion: tuple[Float, Float], name: str, free: bool) -> None:
    rng = np.random.default_rng(seed)
    points, faces = MESHES[name]
    crumpled = points + rng.uniform(-0.08, 0.08, points.shape)
    moved = crumpled @ motion[0].T + motion[1], faces
    fixed = None if free else np.isin(np.arange(len(points)), faces[: 1 + len(faces) // 3])
    result = rebuilt(moved, patch_of(moved, None if fixed is None else fixed.astype(float)))
    if free:
        result = transform_points(result, *kabsch(result, moved[0]))
    np.testing.assert_allclose(result, moved[0], atol=1e-8)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, motion=rigid_motions)
def test_fixed_vertices_take_the_patch_along(seed: int, motion: tuple[Float, Float]) -> None:
    """Also where lengths and angles fit no mesh: what the fixed vertices do rigidly the rest does too."""
    rng = np.random.default_rng(seed)
    points, _ = CYLINDER
    patch = patch_of(CYLINDER, np.isin(np.arange(len(points)), [*range(16), *range(56, 72)]).astype(float))
    lengths = edge_lengths(points, patch.edges) * rng.uniform(0.9, 1.1, len(patch.edges))
    angles = dihedral_angles(points, patch.hinges) + rng.uniform(-0.2, 0.2, len(patch.hinges))
    here = linear_initialisation(patch, lengths, angles, points)
    there = linear_initialisation(patch, lengths, angles, points @ motion[0].T + motion[1])
    np.testing.assert_allclose(there, here @ motion[0].T + motion[1], atol=1e-8)
    np.testing.assert_array_equal(here[patch.fixed_mask], points[patch.fixed_mask])


def test_twice_the_lengths_give_twice_the_mesh() -> None:
    patch = patch_of(BAR)
    lengths, angles = edge_lengths(BAR[0], patch.edges), dihedral_angles(BAR[0], patch.hinges)
    nowhere = np.zeros_like(BAR[0])
    np.testing.assert_allclose(
        linear_initialisation(patch, 2 * lengths, angles, nowhere),
        2 * linear_initialisation(patch, lengths, angles, nowhere),
        atol=1e-9,
    )


def test_impossible_triangles_give_finite_points() -> None:
    patch = patch_of(CYLINDER)
    lengths = edge_lengths(CYLINDER[0], patch.edges)
    lengths[::5] *= 3.0
    result = linear_initialisation(
        patch, lengths, dihedral_angles(CYLINDER[0], patch.hinges), np.zeros_like(CYLINDER[0])
    )
    assert np.isfinite(result).all()
