"""Further bodies of a model: any of them in front, and edits that play on all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

import mixseq
from mixseq.errors import SettingsError
from mixseq.operations import (
    concatenate,
    cut,
    drag,
    exaggerate,
    exaggerate_part,
    hold,
    in_place,
    key_poses,
    repeat,
    sculpt,
    speed,
    with_body,
)
from mixseq.signals.curve import Curve
from mixseq.signals.pose import PoseMap
from mixseq.types import Float
from tests.meshes import coarse_walk

pytestmark = pytest.mark.filterwarnings("ignore:.*own key poses give the motion back within")

STRETCH = np.array([1.0, 1.5, 1.0])
TURN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def shuffled(keys: mixseq.MeshSequence, stretch: Float = STRETCH) -> mixseq.MeshSequence:
    """The same poses of another body, whose vertices are in another order."""
    order = np.random.default_rng(0).permutation(keys.vertex_count)
    return mixseq.MeshSequence.from_arrays(keys.points[:, order] * stretch, np.argsort(order)[keys.faces], fps=1.0)


@pytest.fixture(scope="module")
def herd() -> mixseq.Model:
    """A fox, a tall one of other vertices and the same parts, and one that looks elsewhere."""
    fox = mixseq.fit(coarse_walk(frames=6), exact=True)
    keys = key_poses(fox)
    both = with_body(fox, shuffled(keys), "tall", fox.parts)
    return with_body(both, keys.with_points(keys.points @ TURN.T), "turned", turn=TURN)


def test_any_body_can_be_in_front_without_loss(herd: mixseq.Model) -> None:
    there = herd.body("tall")
    assert there.body_names == ("tall", "fox", "turned")
    np.testing.assert_array_equal(there.times, herd.times)
    back = there.body("turned").body("fox")
    np.testing.assert_allclose(back.sample().points, herd.sample().points, atol=1e-12)
    np.testing.assert_allclose(back.correction.values, herd.correction.values, atol=1e-12)
    for name in ("tall", "turned"):
        np.testing.assert_allclose(back.body(name).sample().points, herd.body(name).sample().points, atol=1e-12)


def distance_of_turned(model: mixseq.Model) -> float:
    """Largest distance of the turned body from the first one, turned, up to where it stands; in diagonals."""
    own, turned = model.body("fox").sample().points, model.body("turned").sample().points @ TURN
    return float(np.abs(turned - own - (turned - own).mean(axis=(0, 1))).max()) / model.space.scale


def test_a_turned_body_moves_as_the_turned_motion(herd: mixseq.Model) -> None:
    assert distance_of_turned(herd) < 1e-6


EDIT_TOLERANCE_DIAGONALS = 1e-5
PART_TOLERANCE_DIAGONALS = 2e-3  # coordinates of joints depend on the axes of the body


def part(model: mixseq.Model) -> int:
    return int(np.flatnonzero(model.mixed.articulation.parents >= 0)[0])


EDITS: Mapping[str, Callable[[mixseq.Model], mixseq.Model]] = {
    "cut": lambda model: cut(model, model.times[1], model.times[4]),
    "speed": lambda model: speed(model, 2.0),
    "repeat": lambda model: repeat(model, model.times[1], model.times[4], 2),
    "in_place": in_place,
    "exaggerate": lambda model: exaggerate(model, 1.5),
    "drag": lambda model: drag(model, model.times[2], model.embedding([model.times[4]])[0]),
    "exaggerate_part": lambda model: exaggerate_part(model, part(model), 2.0),
    "hold": lambda model: hold(model, part(model), model.times[3], model.times[2], model.times[4]),
    "concatenate": lambda model: concatenate(model, model),
}


@pytest.mark.parametrize("name", EDITS)
def test_an_edit_is_made_once_and_plays_on_all(herd: mixseq.Model, name: str) -> None:
    """A body of the same shape, only turned, ends up as the edited one, whichever of both is edited."""
    for model in (herd, herd.body("turned")):
        edited = EDITS[name](model)
        assert edited.body_names == model.body_names
        is_of_parts = name in ("exaggerate_part", "hold")
        assert distance_of_turned(edited) < (PART_TOLERANCE_DIAGONALS if is_of_parts else EDIT_TOLERANCE_DIAGONALS)
        tall = edited.body("tall")
        assert tall.time is edited.time
        assert np.isfinite(tall.sample().points).all()


def test_a_sculpted_shape_stays_on_its_body(herd: mixseq.Model) -> None:
    time = float(herd.times[2])
    points = herd(time).copy()
    points[0] += 0.1 * herd.space.scale
    edited = sculpt(herd, time, points)
    np.testing.assert_allclose(edited(time)[0], points[0], atol=1e-6 * herd.space.scale)
    before, after = (each.body("tall").sample().points for each in (herd, edited))
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_parts_whose_quaternions_change_sign_at_a_seam_do_so_on_all_bodies(herd: mixseq.Model) -> None:
    """The second section has all key shapes once more, with opposite signs."""
    count, start = len(herd.shapes), herd.space.shape_dim - herd.space.pose_dim
    signs = np.ones(herd.space.shape_dim)
    signs[start : start + 4] = -1.0
    pose = PoseMap.from_key_count(2 * count)

    def twice(shapes: Float) -> Float:
        return np.concatenate([shapes, signs[: shapes.shape[1]] * shapes if len(signs) == shapes.shape[1] else shapes])

    weights = herd.pose.weights(herd.time.values)
    sections = [np.pad(weights, ((0, 0), pads))[:, 1:] for pads in ((0, count), (count, 0))]
    bodies = tuple(replace(body, shapes=twice(body.shapes)) for body in herd.bodies)
    first, second = (
        replace(herd, pose=pose, shapes=twice(herd.shapes), time=Curve(herd.time.times, values), bodies=bodies)
        for values in sections
    )
    joined = concatenate(first, second)
    assert len(joined.pose.matrix) > len(first.pose.matrix)
    assert distance_of_turned(joined) < EDIT_TOLERANCE_DIAGONALS


def test_marks_all_bodies_as_edited(herd: mixseq.Model) -> None:
    assert herd.header.provenance is not None
    away = exaggerate(herd.body("tall"), 1.1)
    own = away.body("fox").header.provenance
    assert own is not None
    assert own.edited


def test_unknown_names_are_refused(herd: mixseq.Model) -> None:
    with pytest.raises(SettingsError, match=r"no body 'camel'; bodies are 'fox', 'tall', 'turned'"):
        herd.body("camel")


def test_bodies_have_to_fit(herd: mixseq.Model) -> None:
    with pytest.raises(SettingsError, match="'tall' does not fit its shape space"):
        replace(herd.bodies[0], shifts=np.zeros((2, 3)))
    fewer = replace(herd.bodies[0], shapes=herd.bodies[0].shapes[1:])
    with pytest.raises(SettingsError, match=r"the body 'tall' has \d key shapes and 1 placements; \d and 1"):
        replace(herd, bodies=(fewer,))


def test_a_motion_with_other_key_shapes_is_not_joined(herd: mixseq.Model) -> None:
    other = mixseq.fit(coarse_walk(frames=6), rank=3)
    with pytest.raises(SettingsError, match=r"its bodies tall, turned have none of these poses"):
        concatenate(herd, other)
