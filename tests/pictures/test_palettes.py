"""Colours: parts differ from each other and, in any light, from the joints."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.pictures.colours import JOINT_RED, part_colours, segmentation_colours, viridis
from mixseq.pictures.raster import shade


def test_part_colours_are_colours_and_do_not_depend_on_their_number() -> None:
    colours = part_colours(24)
    assert colours.shape == (24, 3)
    assert colours.min() >= 0 and colours.max() <= 1
    assert np.array_equal(colours[:7], part_colours(7))


def test_part_colours_differ() -> None:
    colours = part_colours(20)
    distances = np.linalg.norm(colours[:, None] - colours, axis=2)
    assert distances[np.triu_indices(20, 1)].min() > 0.06
    assert np.diag(distances, 1).min() > 0.2


def test_no_part_looks_like_a_joint_in_any_light() -> None:
    normals = np.random.default_rng(1).normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    def lit(colour: object) -> NDArray[np.float64]:
        return shade(np.broadcast_to(np.asarray(colour, dtype=np.float64), normals.shape), normals, 1.0)

    def hues(colours: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([360 * colorsys.rgb_to_hsv(*colour)[0] for colour in colours])

    reds = lit(JOINT_RED)
    for colour in part_colours(50):
        lights = lit(colour)
        turn = np.abs((hues(lights)[:, None] - hues(reds) + 180) % 360 - 180)
        assert turn.min() > 30
        assert np.linalg.norm(lights[:, None] - reds, axis=2).min() > 0.1


def test_segmentation_colours() -> None:
    parts, joints = np.array([0, 0, 1, 1, 0, 0, 1, 1]), np.array([0, -1, -1, 0, -1, -1, -1, -1])
    colours = segmentation_colours(parts, joints)
    assert np.allclose(colours[joints >= 0], JOINT_RED)
    assert np.allclose(colours[1], part_colours(2)[0])
    assert np.allclose(colours[2], part_colours(2)[1])


def test_viridis_is_that_of_matplotlib() -> None:
    maps = pytest.importorskip("matplotlib").colormaps
    assert viridis().shape == (256, 3)
    assert np.abs(viridis() - maps["viridis"](np.arange(256))[:, :3]).max() < 1.4 / 255
