"""Curves from sections: exact where nothing jumps, and smooth where something does."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.choices import SpaceName
from mixseq.mesh.rotations import matrix_to_rotvec, quat_to_matrix, rotvec_to_matrix
from mixseq.operations.sections import (
    MAX_BISECTIONS,
    CurveSection,
    Seam,
    blend_placements,
    correction_norm,
    interpolate_adaptively,
    join_curves,
    lerp,
    map_curve_times,
    merge_sites,
    placement_norm,
    shape_norm,
    subdivide,
)
from mixseq.operations.transitions import concatenate
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.detail import VISUALLY_LOSSLESS_TOLERANCE
from mixseq.signals.fitting import fit
from mixseq.types import Float
from tests.meshes import bar, coarse_walk, seeds
from tests.operations.chains import TIMES, chain
from tests.operations.motions import bar_motion, jets, jumps, spin


def wild(seed: int, knots: int = 9, start: float = 0.0, end: float = 2.0) -> Curve:
    """A curve through random values at uneven times."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.3, 1.0, knots - 1)
    times = start + (end - start) * np.append(0, np.cumsum(steps)) / steps.sum()
    times[-1] = end
    return Curve(times, rng.normal(size=(knots, 2)))


@settings(max_examples=50, deadline=None)
@given(seed=seeds, cuts=st.lists(st.floats(0.05, 1.95), max_size=3, unique=True), knots=st.integers(2, 12))
def test_sections_of_one_curve_make_that_curve(seed: int, cuts: list[float], knots: int) -> None:
    curve = wild(seed, knots)
    edges = [0.0, *sorted(cut for cut in cuts if np.abs(curve.times - cut).min() > 1e-3), 2.0]
    edges = [edge for edge, after in zip(edges, [*edges[1:], np.inf], strict=True) if after - edge > 1e-2]
    sections = [CurveSection(curve, start, end) for start, end in pairwise(edges)]
    shortest = min(end - start for _, start, end in sections)
    whole = join_curves(sections, [Seam(shortest)] * (len(sections) - 1))
    times = np.linspace(0, 2, 301)
    sizes = np.abs(jets(curve, times)).max(axis=(1, 2))
    errors = np.abs(jets(whole, times) - jets(curve, times)).max(axis=(1, 2))
    assert (errors <= np.array([1e-10, 1e-8, 1e-6]) * np.maximum(sizes, 1)).all()


@settings(max_examples=50, deadline=None)
@given(seed=seeds, fade=st.floats(0.05, 1.0), share=st.sampled_from([0.0, 0.3, 0.5, 1.0]))
def test_a_jump_is_taken_up_within_the_fade(seed: int, fade: float, share: float) -> None:
    before, after = wild(seed, start=0, end=1), wild(seed + 1, start=1, end=2)
    whole = join_curves([CurveSection(before, 0, 1), CurveSection(after, 1, 2)], [Seam(fade, share)])
    assert (jumps(whole) < 1e-9).all()
    reach = 1.02 * fade  # its end may move to a knot
    for piece, times in ((before, np.linspace(0, 1 - reach, 50)), (after, np.linspace(1 + reach, 2, 50))):
        if 0 <= times[0] < times[-1] <= 2 and reach < 1:
            np.testing.assert_allclose(whole(times), piece(times), atol=1e-10)
    seam = np.array([1.0])
    expected = (1 - share) * jets(before, seam) + share * jets(after, seam)
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(jets(whole, seam) / size, expected / size, atol=1e-9)


def test_without_a_share_a_side_stays_as_it_is() -> None:
    before, after = wild(1, start=0, end=1), wild(2, start=1, end=2)
    times = np.linspace(0, 1, 50)
    kept = join_curves([CurveSection(before, 0, 1), CurveSection(after, 1, 2)], [Seam(0.5, fraction_before=0.0)])
    np.testing.assert_allclose(kept(times), before(times), atol=1e-12)
    assert np.abs(kept(1 + times) - after(1 + times)).max() > 0.1
    kept = join_curves([CurveSection(before, 0, 1), CurveSection(after, 1, 2)], [Seam(0.5, fraction_before=1.0)])
    np.testing.assert_allclose(kept(1 + times), after(1 + times), atol=1e-12)


def test_a_step_closes_by_the_formula() -> None:
    """From 0 to 1: up to the middle at the seam, level there, by three cubics of length 1 each."""
    flat = Curve(np.array([0.0, 10.0]), np.array([[0.0], [0.0]]))
    high = Curve(flat.times, flat.values + 1)
    whole = join_curves([CurveSection(flat, 0, 5), CurveSection(high, 5, 10)], [Seam(3.0)])
    np.testing.assert_allclose(jets(whole, np.array([5.0]))[:, 0, 0], [0.5, 0, 0], atol=1e-12)
    # a (r^3) = 1/2 with sum a r^2 = sum a r = 0 for r = 1, 2, 3: a = 1/4, -1/4, 1/12.
    np.testing.assert_allclose(whole([4.0, 3.0])[:, 0], [8 / 12 - 1 / 4, 1 / 12], atol=1e-12)
    np.testing.assert_allclose(whole([2.0, 1.0, 8.0, 9.0])[:, 0], [0, 0, 1, 1], atol=1e-12)


def test_curves_of_no_coordinates() -> None:
    nothing = Curve(np.arange(5.0), np.zeros((5, 0)))
    whole = join_curves([CurveSection(nothing, 0, 2), CurveSection(nothing, 2, 4)], [Seam(1)])
    assert whole.values.shape == (len(whole.times), 0)
    assert (whole.start, whole.end) == (0, 4)


def test_sites_hold_all_breakpoints_and_two_more() -> None:
    sites = merge_sites(np.array([0.0, 4.0]), np.array([3.0, 1.0, 1.0 + 1e-12, 1e-12]))
    np.testing.assert_allclose(sites, [0, 0.5, 1, 3, 3.5, 4], atol=1e-9)
    np.testing.assert_allclose(merge_sites(np.array([0.0, 3.0]), np.zeros(0)), [0, 1, 2, 3])


def test_refined_times() -> None:
    np.testing.assert_allclose(subdivide(np.array([0.0, 1, 3]), 2), [0, 0.5, 1, 2, 3])
    np.testing.assert_array_equal(subdivide(np.array([0.0, 0.1, 0.3]), 1), [0, 0.1, 0.3])


@pytest.mark.parametrize("scale", [0.5, 3.0, -1.0])
def test_moved_curves(scale: float) -> None:
    curve, times = wild(3), np.linspace(0, 2, 40)
    np.testing.assert_allclose(map_curve_times(curve, 0.3, scale)(scale * times + 0.3), curve(times), atol=1e-12)


# Means of placements: turns in proportion

COUNT = len(TIMES)
LATER = TIMES[::-1]


def shares(value: float) -> Float:
    return np.full((COUNT, 1), value)


@pytest.mark.parametrize("space", ["mixed", "gradient"])
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_all_or_nothing_gives_one_of_them(space: SpaceName, share: float) -> None:
    """Also the length of quaternions: curves through more knots are the same curves."""
    model = bar_motion(space)
    both = 1.1 * model.placement(TIMES), model.placement(LATER)
    found, expected = blend_placements(model.space, *both, shares(share)), both[int(share)]
    turns, others = (model.space.unpack_placements(each).rotations for each in (found, expected))
    signs = np.where(np.einsum("tgi,tgi->tg", turns, others) < 0, -1.0, 1.0)[:, :, None]
    np.testing.assert_allclose(signs * turns, others, atol=1e-12)
    np.testing.assert_allclose(
        model.space.unpack_placements(found).centres, model.space.unpack_placements(expected).centres, atol=1e-12
    )


def test_a_body_turns_along_the_shortest_way() -> None:
    model = chain()
    one, other = (model.placement(times) for times in (TIMES, LATER))
    found = model.space.unpack_placements(blend_placements(model.space, one, other, shares(0.3)))
    turns, others = (quat_to_matrix(model.space.unpack_placements(each).rotations[:, 0]) for each in (one, other))
    expected = turns @ rotvec_to_matrix(0.3 * matrix_to_rotvec(np.swapaxes(turns, 1, 2) @ others))
    np.testing.assert_allclose(quat_to_matrix(found.rotations[:, 0]), expected, atol=1e-12)
    here, there = (model.space.unpack_placements(each).centres[:, 0] for each in (one, other))
    np.testing.assert_allclose(found.centres[:, 0], lerp(here, there, shares(0.3)), atol=1e-12)


def test_whole_turns_count() -> None:
    model = spin()
    times = model.placement.times
    turning = model.placement.values
    still = np.repeat(turning[:1], len(times), axis=0)
    found = blend_placements(model.space, turning, still, np.full((len(times), 1), 0.5))
    cosines = np.abs(model.space.unpack_placements(found).rotations[:, 0] @ turning[0, :4])
    np.testing.assert_allclose(cosines, np.abs(np.cos(np.pi * times / 2)), atol=1e-9)  # a quarter of the angle


# Splines through functions, and lengths of steps in pose space


def largest(deviations: Float) -> Float:
    return np.asarray(np.abs(deviations).max(axis=1))


def test_a_cubic_needs_no_more_sites() -> None:
    sites = np.array([0.0, 0.4, 1.0, 2.0])
    curve = interpolate_adaptively(lambda t: t[:, None] ** 3, sites, 1e-12, largest)
    np.testing.assert_array_equal(curve.times, sites)


def test_sites_go_where_the_function_bends() -> None:
    def function(times: Float) -> Float:
        return np.asarray(np.tanh(20.0 * (times - 0.2))[:, None])

    curve = interpolate_adaptively(function, np.linspace(0, 1, 9), 1e-4, largest)
    dense = np.linspace(0, 1, 501)
    assert np.abs(curve(dense) - function(dense)).max() < 3e-4
    assert np.count_nonzero(curve.times < 0.5) > 2 * np.count_nonzero(curve.times > 0.5)


def test_kinks_end_it() -> None:
    curve = interpolate_adaptively(lambda t: np.abs(t - 0.31)[:, None], np.linspace(0, 1, 5), 1e-12, largest)
    assert np.diff(curve.times).min() >= 0.25 / 2**MAX_BISECTIONS


def test_one_site_stays_one() -> None:
    assert interpolate_adaptively(lambda t: t[:, None], np.array([2.0]), 1e-3, largest).times.tolist() == [2.0]


def test_lengths_of_steps_are_those_of_scores() -> None:
    """In a fit, coordinates are distances."""
    sequence = bar(sides=5, rings=15, frames=6)
    model = fit(sequence, exact=True)
    steps = np.diff(model.time(model.times), axis=0)
    expected = np.linalg.norm(steps, axis=1) / np.sqrt(sequence.vertex_count)
    np.testing.assert_allclose(shape_norm(model)(steps), expected, rtol=1e-9)


def test_vertices_that_move_alike_move_by_the_length() -> None:
    sequence = bar(sides=5, rings=15, frames=2)
    moved = np.stack([sequence.points[0], sequence.points[0] + np.array([0.3, 0.0, 0.4])])
    model = fit(sequence.with_points(moved), exact=True, space="vertex")
    step = np.diff(model.time(model.times), axis=0)
    np.testing.assert_allclose(shape_norm(model)(step), 0.5 / sequence.diagonal)
    assert placement_norm(model)(np.zeros((3, 0))).tolist() == [0.0, 0.0, 0.0]


def test_the_size_of_a_placement_is_its_largest_number() -> None:
    model = fit(bar(sides=5, rings=15, frames=3), exact=True, parts=2)
    changes = np.zeros((2, model.space.placement_dim))
    changes[1, 4] = -0.25  # of the centre, after the quaternion
    np.testing.assert_allclose(placement_norm(model)(changes), [0.0, 0.25])


def test_the_size_of_a_correction_is_its_largest_number() -> None:
    model = fit(bar(sides=5, rings=15, frames=3), exact=True, parts=2)
    changes = np.zeros((2, model.space.correction_dim))
    changes[1, 3 * 2] = -0.25  # of a shift, after the turns of both parts
    np.testing.assert_allclose(correction_norm(model)(changes), [0.0, 0.25])
    assert correction_norm(fit(bar(sides=5, rings=15, frames=2), space="lri"))(np.zeros((1, 0))) == [0.0]


def test_slopes_and_curvatures_may_have_windows_of_their_own() -> None:
    times = np.arange(9.0)
    before, after = Curve(times, times[:, None] ** 2), Curve(times + 8, 64.0 - 3 * times[:, None])
    sections = [CurveSection(before, 0.0, 8.0), CurveSection(after, 8.0, 16.0)]
    joined = join_curves(sections, [Seam(4.0, slope_fade=1.0)])
    np.testing.assert_allclose(joined(np.arange(9.0)), before(times), atol=1e-9)
    np.testing.assert_allclose(joined(np.arange(8.0, 17.0)), after(times + 8), atol=1e-9)
    for order in (1, 2):
        left, right = (joined.derivative([8.0 + step], order) for step in (-1e-9, 1e-9))
        np.testing.assert_allclose(left, right, atol=1e-5)


@pytest.mark.parametrize("exact", [True, False])
def test_halves_of_a_motion_make_the_motion(exact: bool) -> None:
    """Frames of halves that are fitted separately stay within the tolerance when they are joined."""
    sequence = coarse_walk(frames=13)
    first, second = (
        MeshSequence.from_header(sequence.header.with_times(sequence.times[ids]), sequence.points[ids])
        for ids in (slice(0, 7), slice(6, 13))
    )
    joined = concatenate(fit(first, exact=exact), fit(second, exact=exact)).sample()
    error = np.linalg.norm(joined.points - sequence.points, axis=2).max() / sequence.diagonal
    assert error < (1e-8 if exact else 1.5 * VISUALLY_LOSSLESS_TOLERANCE)
