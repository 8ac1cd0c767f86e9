"""glTF files in: skins and morph targets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mixseq.sequence.sequence import MeshSequence
from tests.formats.gltf_maker import JOINTS, TRIANGLE, morphing, skinned


@pytest.mark.parametrize("scale", [1, 7])  # weights are made to sum to 1
def test_two_joints(made: Callable[..., MeshSequence], scale: float) -> None:
    got = made(skinned(scale * np.array([[1, 0, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0]]), JOINTS))
    np.testing.assert_allclose(got.points[0], [[2, 0, 0], [2, 1, 0], [0, 1, 0]], atol=1e-6)
    # The second vertex is half way between (2, 1) and where the joint takes it, (0, 1).
    np.testing.assert_allclose(got.points[-1], [[1, 1, 0], [1, 1, 0], [0, 1, 0]], atol=1e-6)


def test_normalised_weights(made: Callable[..., MeshSequence]) -> None:
    weights = [[255, 0, 0, 0], [51, 204, 0, 0], [255, 0, 0, 0]]
    got = made(skinned(weights, JOINTS, "u1", normalized=True))
    np.testing.assert_allclose(got.points[-1, 1], [0.2 * 2 + 0.8 * 0, 1, 0], atol=1e-6)


def test_a_second_set_of_joints(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[0.25, 0, 0, 0]] * 3, np.zeros((3, 4)))
    maker.json["meshes"][0]["primitives"][0]["attributes"].update(
        JOINTS_1=maker.add([[1, 1, 1, 1]] * 3, "u2"), WEIGHTS_1=maker.add([[0.25, 0.25, 0.25, 0]] * 3)
    )
    np.testing.assert_allclose(made(maker).points[-1, 0], [0.25 * 2 + 0.75 * 1, 0.75, 0], atol=1e-6)


def test_weights_of_nothing_follow_the_first_joint(made: Callable[..., MeshSequence]) -> None:
    got = made(skinned(np.zeros((3, 4)), JOINTS))
    np.testing.assert_allclose(got.points[-1], got.points[0])


def test_a_mirroring_skeleton_keeps_faces_outwards(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, JOINTS)
    maker.json["nodes"][1]["scale"] = [1, 1, -1]
    assert made(maker).faces.tolist() == [[0, 2, 1]]


def test_morph_targets_that_stand_still(made: Callable[..., MeshSequence]) -> None:
    maker = morphing()
    assert made(maker).points[0].tolist() == TRIANGLE
    maker.json["meshes"][0]["weights"] = [0.5, 0.25]
    assert made(maker).points[0].tolist() == [[0, 0, 0.5], [2, 0, 0.5], [0, 1, 0.5]]
    maker.json["nodes"][0]["weights"] = [2, 0]
    assert made(maker).points[0].tolist() == [[0, 0, 2], [1, 0, 2], [0, 1, 2]]


@pytest.mark.parametrize("how", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_animated_morph_targets(made: Callable[..., MeshSequence], how: str) -> None:
    maker = morphing(translation=[0, 0, 10])
    keys, flat = np.array([[0, 0], [1, 0.5]]), np.zeros((2, 2))
    if how == "CUBICSPLINE":  # per key tangents, values, tangents
        keys = np.stack([flat, keys, flat], axis=1)
    maker.animate(0, "weights", [0, 1], keys, how)
    got = made(maker, fps=2)
    middle = 0.0 if how == "STEP" else 0.5
    np.testing.assert_allclose(
        got.points[:, 1], np.array([[1, 0, 10], [1 + 2 * middle, 0, 10 + middle], [3, 0, 11]])
    )


def test_morphs_come_before_the_skin(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, [[1, 0, 0, 0]] * 3)
    mesh = maker.json["meshes"][0]
    mesh["primitives"][0]["targets"] = [{"POSITION": maker.add([[1, 0, 0]] * 3)}]
    mesh["weights"] = [1]
    np.testing.assert_allclose(made(maker).points[-1, 0], [1, 2, 0], atol=1e-6)
