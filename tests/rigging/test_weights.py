"""Weights and motions, held against searches of all there are."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import nnls

import mixseq
from mixseq.rigging.bone_tree import Joints, build_bone_tree, fit_motions
from mixseq.rigging.bones import Binding, bind, fit_rigid_motion, merge_bones, seed_bones, transpose_motion
from mixseq.rigging.fitting import fit_skin, principal_shapes
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index
from tests.meshes import joined, rotation, tetrahedron, tube


def random_bones(bones: int, frames: int, seed: int = 3) -> Float:
    rng = np.random.default_rng(seed)
    turns = np.stack([[rotation(rng.normal(size=3)) for _ in range(frames)] for _ in range(bones)])
    return np.stack([transpose_motion(turn, rng.normal(size=(frames, 3))) for turn in turns])


def unbound(rest: Float) -> Binding:
    zeros = np.zeros((len(rest), 4))
    return Binding(rest, zeros.astype(np.int64), zeros, zeros[:, 0])


def shown(motions: Float, binding: Binding) -> Float:
    return np.asarray(binding.matrix(len(motions)) @ motions.reshape(-1, motions.shape[2]))


def best_of_all(columns: Float, track: Float) -> float:
    """The least squared error with four bones or fewer, weights not negative with sum one, by trying all."""
    heavy = 1e5
    measure_errors = []
    for chosen in combinations(range(columns.shape[1]), 4):
        a = np.concatenate([columns[:, chosen], np.full((1, 4), heavy)])
        w = nnls(a, np.append(track, heavy))[0]
        measure_errors.append(float(np.sum((columns[:, chosen] @ w - track) ** 2)))
    return min(measure_errors)


def test_weights_are_nearly_the_best_there_are() -> None:
    rng = np.random.default_rng(0)
    motions, rest = random_bones(7, 5), rng.normal(size=(60, 3))
    tracks = rng.normal(size=(60, 15))
    binding = bind(tracks, motions, unbound(rest), free_rest=False)
    np.testing.assert_allclose(np.sum((shown(motions, binding) - tracks) ** 2, axis=1), binding.errors)
    homogeneous = np.concatenate([rest, np.ones((60, 1))], axis=1)
    best = np.array([best_of_all(np.einsum("bit,i->tb", motions, homogeneous[v]), tracks[v]) for v in range(60)])
    assert (binding.errors > best * (1 - 1e-6)).all()
    assert np.median(binding.errors / best) < 1 + 1e-6  # one out at a time finds most of them
    assert (binding.errors < 1.2 * best).all()


def test_known_weights_are_found() -> None:
    rng = np.random.default_rng(1)
    motions, rest = random_bones(9, 8), rng.normal(size=(50, 3))
    known = Binding(
        rest, np.stack([rng.permutation(9)[:4] for _ in range(50)]), rng.dirichlet(np.ones(4), size=50), np.zeros(50)
    )
    found = bind(shown(motions, known), motions, unbound(rest), free_rest=False)
    np.testing.assert_allclose(found.matrix(9).toarray()[:, 3::4], known.matrix(9).toarray()[:, 3::4], atol=1e-6)


def test_known_rest_positions_and_motions_are_found() -> None:
    rng = np.random.default_rng(2)
    motions, rest = random_bones(3, 8), rng.normal(size=(50, 3))
    known = Binding(rest, np.tile([0, 1, 2, 0], (50, 1)), np.zeros((50, 4)), np.zeros(50))
    known.weights[:, :3] = rng.dirichlet(np.ones(3), size=50)
    tracks = shown(motions, known)
    off = Binding(rest + 1e-3 * rng.normal(size=rest.shape), known.influences, known.weights, known.errors)
    for _ in range(300):
        off = bind(tracks, motions, off)
    np.testing.assert_allclose(off.rest, rest, atol=1e-6)
    moved = random_bones(3, 8, seed=9)
    for _ in range(50):
        moved, _ = fit_motions(tracks, known, moved, Joints.free(3))
    np.testing.assert_allclose(moved, motions, atol=1e-6)


def test_errors_never_grow() -> None:
    rng = np.random.default_rng(4)
    motions, binding = random_bones(4, 6), unbound(rng.normal(size=(80, 3)))
    tracks = rng.normal(size=(80, 18))
    past = np.inf
    for _ in range(8):
        binding = bind(tracks, motions, binding)
        motions, _ = fit_motions(tracks, binding, motions, Joints.free(4))
        now = float(np.sum((shown(motions, binding) - tracks) ** 2))
        assert now <= min(past, binding.errors.sum()) * (1 + 1e-9)
        past = now


def test_bones_that_no_vertex_follows_keep_still() -> None:
    rng = np.random.default_rng(5)
    motions = random_bones(3, 4)
    binding = unbound(rng.normal(size=(20, 3)))
    binding.weights[:, 0] = 1.0  # all on bone 0
    moved, _ = fit_motions(rng.normal(size=(20, 12)), binding, motions, Joints.free(3))
    np.testing.assert_array_equal(moved[1:], motions[1:])
    np.testing.assert_allclose(moved[0], fit_rigid_motion(rng_tracks(), binding.rest, np.arange(20)), atol=1e-9)


def rng_tracks() -> Float:
    """The tracks of the test above: the second thing that its generator draws."""
    rng = np.random.default_rng(5)
    rng.normal(size=(20, 3))
    return np.asarray(rng.normal(size=(20, 12)))


def test_bones_that_move_together_are_merged_first() -> None:
    rng = np.random.default_rng(6)
    rest = rng.normal(size=(40, 3))
    motions = random_bones(2, 5)
    labels = np.repeat(np.arange(4), 10)
    binding = unbound(rest)
    binding.weights[:, 0] = 1.0
    binding.influences[:, 0] = np.array([0, 1, 0, 1])[labels]
    np.testing.assert_array_equal(merge_bones(shown(motions, binding), labels, 2), np.array([0, 1, 0, 1])[labels])
    assert merge_bones(shown(motions, binding), labels, 1).max() == 0
    np.testing.assert_array_equal(merge_bones(shown(motions, binding), labels, 9), labels)


def test_bones_are_seeded_where_vertices_are_worst_explained() -> None:
    rng = np.random.default_rng(7)
    rest = np.concatenate([0.1 * rng.normal(size=(20, 3)), 0.1 * rng.normal(size=(10, 3)) + 5])
    motions = random_bones(2, 4)
    known = unbound(rest)
    known.weights[:, 0] = 1.0
    known.influences[20:] = 1
    tracks = shown(motions, known)
    alone = bind(tracks, motions[:1], unbound(rest), free_rest=False)
    found = seed_bones(tracks, alone, 1, 5)
    np.testing.assert_allclose(found[0], motions[1], atol=1e-6)
    assert len(seed_bones(tracks, unbound(rest), 3, 5)) == 0


@pytest.mark.parametrize("rank", [0, 1, 3])
def test_principal_shapes_are_as_many_as_there_are(rank: int) -> None:
    rng = np.random.default_rng(8)
    displacements = np.einsum("tm,mvi->tvi", rng.normal(size=(6, rank)), rng.normal(size=(rank, 10, 3)))
    shapes, weights = principal_shapes(displacements)
    assert len(shapes) == rank
    np.testing.assert_allclose(np.einsum("tm,mvi->tvi", weights, shapes), displacements, atol=1e-12)
    sizes = np.linalg.norm(shapes, axis=(1, 2)) * np.linalg.norm(weights, axis=0)
    assert (np.diff(sizes) <= 0).all()
    assert (weights.max(axis=0) == 1).all() if rank else weights.shape == (6, 0)


# The tree of bones, held against chains whose joints are known

HEIGHTS = (1.0, 2.0, 3.0)
"""Where the chain bends."""


def motions_of_chain(frames: int = 9) -> tuple[Float, Float]:
    """Four bones along z, each turning against the one below: rotations ``(4, T, 3, 3)``, translations."""
    rng = np.random.default_rng(7)
    turns = np.empty((4, frames, 3, 3))
    shifts = np.empty((4, frames, 3))
    for frame in range(frames):
        turn, shift = rotation(rng.normal(size=3)), rng.normal(size=3)
        for bone in range(4):
            if bone:
                joint = np.array([0, 0, HEIGHTS[bone - 1]])
                own = turn @ rotation(0.5 * rng.normal(size=3))
                turn, shift = own, turn @ joint + shift - own @ joint
            turns[bone, frame], shifts[bone, frame] = turn, shift
    return turns, shifts


def chain() -> tuple[Index, Binding, Float]:
    """A tube whose vertices follow the bone at their height, blended over a short way."""
    points, faces = tube(8, 41)
    turns, shifts = motions_of_chain()
    share = np.clip((points[:, 2:] - HEIGHTS) / 0.2 + 0.5, 0, 1)
    weights = np.diff(np.concatenate([np.ones((len(points), 1)), share, np.zeros((len(points), 1))], axis=1))
    binding = Binding(points, np.tile(np.arange(4), (len(points), 1)), -weights, np.zeros(len(points)))
    return faces, binding, np.stack([transpose_motion(r, t) for r, t in zip(turns, shifts, strict=True)])


def test_a_chain_is_found_with_its_joints() -> None:
    order, joints = build_bone_tree(*chain())
    links = {frozenset((int(order[b]), int(order[a]))) for b, a in enumerate(joints.parents) if a >= 0}
    assert links == {frozenset((0, 1)), frozenset((1, 2)), frozenset((2, 3))}
    assert order[0] in (1, 2)  # the middle, so that no bone is more than two joints away
    assert joints.sliding.tolist() == [True, False, False, False]
    assert (joints.parents < np.arange(4)).all()
    for bone, parent in enumerate(joints.parents.tolist()):
        if parent >= 0:
            height = HEIGHTS[min(order[bone], order[parent])]
            np.testing.assert_allclose(joints.pivots[bone], [0, 0, height], atol=0.02)


def test_a_joint_that_never_turns_is_where_bones_touch() -> None:
    faces, binding, motions = chain()
    still = np.repeat(motions[:1], 4, axis=0)
    order, joints = build_bone_tree(faces, binding, still)
    for bone, parent in enumerate(joints.parents.tolist()):
        if parent >= 0:
            height = HEIGHTS[min(order[bone], order[parent])]
            np.testing.assert_allclose(joints.pivots[bone], [0, 0, height], atol=0.1)


def test_components_hang_from_what_they_move_with() -> None:
    """An ornament next to the lowest bone, but moving with the highest one."""
    faces, binding, motions = chain()
    points, all_faces = joined((binding.rest, faces), (0.1 * tetrahedron()[0] + [0.7, 0, 0.5], tetrahedron()[1]))
    more = len(points) - len(binding.rest)
    influences = np.concatenate([binding.influences, np.tile([4, 0, 0, 0], (more, 1))])
    weights = np.concatenate([binding.weights, np.tile([1.0, 0, 0, 0], (more, 1))])
    whole = Binding(points, influences, weights, np.zeros(len(points)))
    order, joints = build_bone_tree(all_faces, whole, np.concatenate([motions, motions[3:]]))
    ornament = int(np.flatnonzero(order == 4)[0])
    assert order[joints.parents[ornament]] == 3


def test_one_bone_is_a_root() -> None:
    faces, binding, motions = chain()
    whole = Binding(binding.rest, 0 * binding.influences, np.eye(4)[0] + 0 * binding.weights, binding.errors)
    order, joints = build_bone_tree(faces, whole, motions[:1])
    assert order.tolist() == [0]
    assert joints.parents.tolist() == [-1]
    np.testing.assert_allclose(joints.pivots[0], binding.rest.mean(axis=0), atol=1e-12)


@pytest.mark.slow
def test_a_skin_hangs_in_the_tree_and_its_joints_hold() -> None:
    faces, binding, motions = chain()
    frames = np.asarray(binding.matrix(4) @ motions.reshape(16, -1)).reshape(len(binding.rest), -1, 3)
    sequence = MeshSequence.from_arrays(frames.swapaxes(0, 1), faces)
    height = binding.rest[faces, 2].mean(axis=1)
    skin = fit_skin(sequence, np.searchsorted(HEIGHTS, height), rounds=200)
    assert (skin.skeleton.parents < 0).sum() == 1
    spread = np.ptp(skin.local_motion()[1], axis=0).max(axis=1) / sequence.diagonal
    assert (spread[1:] < 1e-9).all()  # rotations only
    assert mixseq.compare(sequence, skin).kg_percent < 0.05
