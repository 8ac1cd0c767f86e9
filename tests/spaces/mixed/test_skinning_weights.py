"""Shares of vertices in parts: what always holds, and blends that are found again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from mixseq.mesh.rigid import mean_shape
from mixseq.segmentation.joints import Decomposition, decompose
from mixseq.segmentation.methods import segment_by_labels
from mixseq.spaces.mixed import skinning_weights
from mixseq.spaces.mixed.skinning_weights import MAX_PARTS_PER_VERTEX, MIN_WEIGHT, WEIGHT_STEP, fit_skinning_weights
from mixseq.types import Float
from tests.meshes import SEQUENCES, Mesh, bending, bent, joined, rigid_motions, rotation, seeds, topology_of, tube
from tests.spaces.mixed.made import MESHES, chain, sequence_of, sliced, space_of


def shares_of(mesh: Mesh, decomposition: Decomposition, frames: Float) -> sparse.csr_array:
    """Shares of frames as they are, whose first one is the reference."""
    shapes = np.concatenate([mean_shape(frames[:, part]) for part in decomposition.parts])
    return fit_skinning_weights(topology_of(mesh), decomposition, shapes, frames, 1.0, frames[0])


def upper(mesh: Mesh, decomposition: Decomposition) -> int:
    return int(decomposition.part_of_face[np.argmax(mesh[0][mesh[1]].mean(axis=1)[:, 2])])


def assert_sound(shares: sparse.csr_array, decomposition: Decomposition) -> None:
    assert shares.shape[1] == len(decomposition.parts)
    assert (shares.data > 0).all()
    np.testing.assert_allclose(np.asarray(shares.sum(axis=1)).reshape(-1), 1.0, atol=1e-14)
    counts = np.diff(shares.indptr)
    assert counts.min() >= 1
    assert counts.max() <= MAX_PARTS_PER_VERTEX
    assert shares.data.min() >= MIN_WEIGHT - WEIGHT_STEP
    np.testing.assert_array_equal(np.round(shares.data / WEIGHT_STEP) * WEIGHT_STEP, shares.data)


@pytest.mark.parametrize("name", SEQUENCES)
def test_shares_are_positive_and_add_up_to_one(name: str) -> None:
    space = space_of(name)
    assert space.skinning_weights.shape[0] == sequence_of(name).vertex_count
    assert_sound(space.skinning_weights, space.decomposition)


@settings(max_examples=12, deadline=None)
@given(seed=seeds, mesh=st.sampled_from(MESHES), parts=st.integers(1, 9), noise=st.sampled_from([0.0, 0.3]))
def test_shares_are_sound_whatever_the_parts(seed: int, mesh: Mesh, parts: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    frames = bending(mesh, frames=3) + noise * rng.normal(size=(3, len(mesh[0]), 3))
    labels = segment_by_labels(rng.integers(0, parts, len(mesh[1])), topology_of(mesh))
    decomposition = decompose(topology_of(mesh), labels, 2)
    assert_sound(shares_of(mesh, decomposition, frames), decomposition)


def test_one_part_has_all() -> None:
    mesh = tube(6, 9)
    whole = decompose(topology_of(mesh), np.zeros(len(mesh[1]), dtype=np.int64))
    shares = shares_of(mesh, whole, bending(mesh))
    np.testing.assert_array_equal(shares.toarray(), np.ones((len(mesh[0]), 1)))


def test_far_from_a_boundary_a_part_has_all() -> None:
    mesh = tube(6, 65)
    decomposition = decompose(topology_of(mesh), sliced(mesh, 2.0), 3)
    shares = shares_of(mesh, decomposition, np.stack([bent(mesh[0], angle) for angle in (0.0, 0.5, 1.0)]))
    top = upper(mesh, decomposition)
    assert (shares.toarray()[mesh[0][:, 2] > 3.5, top] == 1).all()
    assert (shares.toarray()[mesh[0][:, 2] < 0.5, 1 - top] == 1).all()


def test_of_large_meshes_only_boundaries_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = tube(6, 200, length=60.0)
    decomposition = decompose(topology_of(mesh), sliced(mesh, 20.0), 3)
    frames = np.stack([bent(mesh[0], angle, middle=20.0) for angle in (0.0, 0.5, 1.0)])
    expected = shares_of(mesh, decomposition, frames).toarray()
    monkeypatch.setattr(skinning_weights, "MAX_FULLY_FITTED_VERTICES", 100)
    found = shares_of(mesh, decomposition, frames)
    assert_sound(found, decomposition)
    np.testing.assert_allclose(found.toarray(), expected, atol=1e-3)
    whole = decompose(topology_of(mesh), np.zeros(len(mesh[1]), dtype=np.int64), 1)
    assert (shares_of(mesh, whole, frames).toarray() == 1).all()


def test_other_bodies_have_no_share() -> None:
    mesh = joined(tube(6, 9), tube(5, 9))
    count = len(tube(6, 9)[0])
    half = np.concatenate([sliced(tube(6, 9), 2.0), 2 + sliced(tube(5, 9), 2.0)])
    decomposition = decompose(topology_of(mesh), half, 2)
    shares = shares_of(mesh, decomposition, bending(mesh)).toarray()
    assert not shares[:count, 2:].any()
    assert not shares[count:, :2].any()


def test_vertices_of_no_face_follow_their_own_part() -> None:
    space = space_of("unused vertices")
    loose = space.topology.unused_vertices
    part = len(space.decomposition.parts) - 1
    np.testing.assert_array_equal(space.decomposition.parts[part], loose)
    assert (space.rigid_part_of_vertex[loose] == part).all()
    assert (np.delete(space.rigid_part_of_vertex, loose) != part).all()


@pytest.mark.parametrize("width", [3, 5])
@pytest.mark.parametrize("blend", [0.5, 0.8])
def test_blends_of_two_parts_are_found(blend: float, width: int) -> None:
    """Also at vertices on the axis, which both parts leave where they are: there neighbours tell."""
    mesh = tube(8, 33)
    frames = np.stack([bent(mesh[0], angle, blend=blend) for angle in np.linspace(0, 1.2, 7)])
    decomposition = decompose(topology_of(mesh), sliced(mesh, 2.0), width)
    found = shares_of(mesh, decomposition, frames / 4).toarray()[:, upper(mesh, decomposition)]
    weights = np.clip((mesh[0][:, 2] - 2) / blend + 0.5, 0, 1)
    np.testing.assert_allclose(found, weights, atol=0.1)
    assert np.abs(found - weights).mean() < 0.005


def test_blends_along_a_chain_are_found() -> None:
    frames, mesh = chain(np.linspace(0, 0.9, 5), links=3)
    decomposition = decompose(topology_of(mesh), sliced(mesh, 4.0, 8.0), 3)
    shares = shares_of(mesh, decomposition, frames / 12).toarray()
    z = mesh[0][:, 2]
    along = [decomposition.part_of_face[np.argmin(np.abs(mesh[0][mesh[1]].mean(axis=1)[:, 2] - at))] for at in (2, 10)]
    np.testing.assert_allclose(shares[:, along[0]], np.clip((4 - z) / 1.5 + 0.5, 0, 1), atol=0.1)
    np.testing.assert_allclose(shares[:, along[1]], np.clip((z - 8) / 1.5 + 0.5, 0, 1), atol=0.1)


@settings(max_examples=6, deadline=None)
@given(motion=rigid_motions)
def test_where_a_frame_is_does_not_matter(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    mesh = tube(6, 17)
    frames = bending(mesh, frames=3) / 4
    moved = frames.copy()
    moved[1] = frames[1] @ turn.T + shift
    decomposition = decompose(topology_of(mesh), sliced(mesh, 2.0), 3)
    here, there = (shares_of(mesh, decomposition, points).toarray() for points in (frames, moved))
    np.testing.assert_allclose(there, here, atol=1e-5)


def test_units_hardly_matter() -> None:
    mesh = tube(6, 17)
    frames = bending(mesh, frames=3)
    decomposition = decompose(topology_of(mesh), sliced(mesh, 2.0), 3)
    here, there = (shares_of(mesh, decomposition, size * frames).toarray() for size in (0.2, 1.0))
    np.testing.assert_allclose(there, here, atol=1e-4)


def test_parts_that_move_as_one_share_smoothly() -> None:
    """No motion tells them apart: from ring to ring shares change by little."""
    mesh = tube(6, 33)
    frames = np.stack([mesh[0] @ rotation((0, 0, angle)).T for angle in (0.0, 1.0, 2.0)]) / 4
    decomposition = decompose(topology_of(mesh), sliced(mesh, 2.0), 3)
    shares = shares_of(mesh, decomposition, frames)
    assert_sound(shares, decomposition)
    i, j = topology_of(mesh).edges.T
    top = shares.toarray()[:, upper(mesh, decomposition)]
    assert np.abs(top[i] - top[j]).max() < 0.3
