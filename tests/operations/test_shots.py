"""Several shots in one pose space, and the moments at which motions meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mixseq
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.operations import cut, find_moments, fit_shots, transition
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from tests.meshes import bent, rotation, tube

POINTS, FACES = tube(8, 21)
LABELS = (POINTS[FACES][:, :, 2].mean(axis=1) > 2.0).astype(np.int64)


def shot(angles: Float, name: str = "shot") -> MeshSequence:
    """A bar that is bent by angles, at 20 frames per second."""
    frames = np.stack([bent(POINTS, float(angle)) for angle in angles])
    return MeshSequence.from_arrays(frames, FACES, fps=20, name=name)


def swing(seconds: float, phase: float = 0.0) -> Float:
    """Angles of a swing of one second, at 20 frames per second."""
    return np.asarray(0.6 * np.sin(2 * np.pi * (np.arange(round(20 * seconds) + 1) / 20 + phase)))


def test_shots_share_key_shapes_and_keep_their_frames_and_times() -> None:
    first, second = shot(swing(1.0), "swing"), shot(np.linspace(0.0, 0.9, 9), "bend")
    late = replace(second, times=second.times + 7.0)
    models = fit_shots([first, late], exact=True, parts=LABELS)
    np.testing.assert_array_equal(models[0].shapes, models[1].shapes)
    for sequence, model in zip((first, late), models, strict=True):
        assert model.header.name == sequence.name
        np.testing.assert_allclose(model.times, sequence.times, atol=1e-12)
        np.testing.assert_allclose(model.sample().points, sequence.points, atol=1e-7)
    joined = transition(models[0], models[1], at=0.5, duration=0.2)
    assert len(joined.shapes) == len(models[0].shapes)


def test_a_cycle_is_found() -> None:
    model = mixseq.fit(shot(swing(2.5)), exact=True, space="vertex")
    best = find_moments(model, duration=0.2, count=1)[0]
    assert best.leave - best.enter in (pytest.approx(1.0), pytest.approx(2.0))
    assert best.distance < 1e-3
    assert all(each.leave - each.enter >= 0.4 - 1e-9 for each in find_moments(model, duration=0.2))


def test_moments_have_the_pose_and_its_velocity() -> None:
    first, second = fit_shots([shot(swing(1.0)), shot(swing(1.0, phase=0.25))], exact=True, parts=LABELS)
    best = find_moments(first, second, duration=0.1, count=1)[0]
    assert (best.leave - best.enter) % 1.0 == pytest.approx(0.25, abs=1e-9)
    assert best.distance < 1e-3
    joined = transition(first, cut(second, best.enter, second.end), at=best.leave, duration=0.1)
    angle = 0.6 * np.sin(2 * np.pi * (best.leave + 0.05))
    np.testing.assert_allclose(joined(best.leave + 0.05), bent(POINTS, angle), atol=0.01)


def test_strain_is_what_a_blend_half_way_shortens() -> None:
    """Blends of vertices in the plane of a rotation are shorter by the cosine of half the angle between them."""
    corners, faces = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]]), [[0, 1, 2], [0, 2, 3]]
    models: list[mixseq.Model] = []
    for first in (0.0, 2.0):
        turned = np.stack([corners @ rotation((0.0, 0.0, first + 0.3 * k)).T for k in range(5)])
        sequence = MeshSequence.from_arrays(turned, faces, fps=10)
        models.append(mixseq.fit(sequence, exact=True, space="vertex", cuts="none"))
    moments = find_moments(models[0], models[1], duration=0.2)
    assert moments[0][:2] == pytest.approx((0.2, 0.0))
    for leave, enter, _, strain in moments:
        assert strain == pytest.approx(1.0 - np.cos((2.0 + 3.0 * (enter - leave)) / 2), abs=1e-6)


def test_the_nearest_pairs_are_blended(monkeypatch: pytest.MonkeyPatch) -> None:
    model = mixseq.fit(shot(swing(1.5)), exact=True, space="vertex")
    every = find_moments(model, duration=0.1, count=99)
    monkeypatch.setattr("mixseq.operations.shots.MAX_BLENDED_VERTICES", 3 * len(POINTS))
    assert find_moments(model, duration=0.1, count=99) == every[:1]


def test_moments_depend_neither_on_place_nor_on_heading() -> None:
    angles = swing(1.0), np.linspace(-0.2, 0.7, 15)
    shots = [shot(each) for each in angles]
    moved = shots[1].with_points(shots[1].points @ rotation((0.3, 1.0, -0.2)).T + [4.0, -1.0, 2.0])
    found = []
    for each in (shots[1], moved):
        first, second = fit_shots([shots[0], each], exact=True, parts=LABELS)
        found.append(find_moments(first, second, duration=0.1))
    assert [each[:2] for each in found[0]] == [each[:2] for each in found[1]]
    np.testing.assert_allclose([each[2:] for each in found[0]], [each[2:] for each in found[1]], atol=1e-6)


def test_refusals() -> None:
    first, other = shot(swing(1.0)), MeshSequence.from_arrays(np.stack([POINTS[:-1]] * 3), FACES[:-8])
    with pytest.raises(SettingsError, match="no shots"):
        fit_shots([])
    with pytest.raises(InvalidSequenceError, match="another mesh"):
        fit_shots([first, other])
    with pytest.raises(InvalidSequenceError, match="other units"):
        fit_shots([first, replace(first, up_axis="Z")])
    with pytest.raises(InvalidSequenceError, match="single frame"):
        fit_shots([first, first[0:1]])
    model = mixseq.fit(first, exact=True, space="vertex")
    with pytest.raises(SettingsError, match="positive numbers"):
        find_moments(model, duration=0.0)
    with pytest.raises(SettingsError, match="positive numbers"):
        find_moments(model, count=0)
    with pytest.raises(SettingsError, match="shorter than that"):
        find_moments(model, duration=2.0)
