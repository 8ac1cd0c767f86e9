"""Splines through functions, and lengths of steps in pose space."""

from __future__ import annotations

import numpy as np

from mixseq.operations.sections import ROUNDS, correction_measure, placement_measure, sampled, shape_measure
from mixseq.signals.fitting import fit
from mixseq.types import Float
from tests.meshes import bar


def largest(deviations: Float) -> Float:
    return np.asarray(np.abs(deviations).max(axis=1))


def test_a_cubic_needs_no_more_sites() -> None:
    sites = np.array([0.0, 0.4, 1.0, 2.0])
    curve = sampled(lambda t: t[:, None] ** 3, sites, 1e-12, largest)
    np.testing.assert_array_equal(curve.times, sites)


def test_sites_go_where_the_function_bends() -> None:
    def function(times: Float) -> Float:
        return np.asarray(np.tanh(20.0 * (times - 0.2))[:, None])

    curve = sampled(function, np.linspace(0, 1, 9), 1e-4, largest)
    dense = np.linspace(0, 1, 501)
    assert np.abs(curve(dense) - function(dense)).max() < 3e-4
    assert np.count_nonzero(curve.times < 0.5) > 2 * np.count_nonzero(curve.times > 0.5)


def test_kinks_end_it() -> None:
    curve = sampled(lambda t: np.abs(t - 0.31)[:, None], np.linspace(0, 1, 5), 1e-12, largest)
    assert np.diff(curve.times).min() >= 0.25 / 2**ROUNDS


def test_one_site_stays_one() -> None:
    assert sampled(lambda t: t[:, None], np.array([2.0]), 1e-3, largest).times.tolist() == [2.0]


def test_lengths_of_steps_are_those_of_scores() -> None:
    """In the modes of a fit coordinates are distances; in its keys they are the same ones."""
    sequence = bar(sides=5, rings=15, frames=6)
    for pose in ("modes", "keys"):
        model = fit(sequence, exact=True, pose=pose)
        steps = np.diff(model.time(model.times), axis=0)
        expected = np.linalg.norm(steps, axis=1) / np.sqrt(sequence.vertex_count)
        np.testing.assert_allclose(shape_measure(model)(steps), expected, rtol=1e-9)


def test_vertices_that_move_alike_move_by_the_length() -> None:
    sequence = bar(sides=5, rings=15, frames=2)
    moved = np.stack([sequence.points[0], sequence.points[0] + np.array([0.3, 0.0, 0.4])])
    model = fit(sequence.with_points(moved), exact=True, space="vertex")
    step = np.diff(model.time(model.times), axis=0)
    np.testing.assert_allclose(shape_measure(model)(step), 0.5 / sequence.diagonal)
    assert placement_measure(model)(np.zeros((3, 0))).tolist() == [0.0, 0.0, 0.0]


def test_the_size_of_a_placement_is_its_largest_number() -> None:
    model = fit(bar(sides=5, rings=15, frames=3), exact=True, parts=2)
    changes = np.zeros((2, model.space.placement_dim))
    changes[1, 4] = -0.25  # of the centre, after the quaternion
    np.testing.assert_allclose(placement_measure(model)(changes), [0.0, 0.25])


def test_the_size_of_a_correction_is_its_largest_number() -> None:
    model = fit(bar(sides=5, rings=15, frames=3), exact=True, parts=2)
    changes = np.zeros((2, model.space.correction_dim))
    changes[1, 3 * 2] = -0.25  # of a shift, after the turns of both parts
    np.testing.assert_allclose(correction_measure(model)(changes), [0.0, 0.25])
    assert correction_measure(fit(bar(sides=5, rings=15, frames=2), space="lri"))(np.zeros((1, 0))) == [0.0]
