r"""Edit the time line: cut, repeat, loop, shift, change speed or reverse; compute and remove travel along the ground.

Travel is called root motion in game engines. The position of a body is the mean of the centres :math:`c_i` of its
parts, :math:`m(t) = \sum_i r_i^2\, c_i(t) / \sum_i r_i^2`, weighted by their squared radii of gyration :math:`r_i`. The
component along the up axis is omitted.

In a transition, with a weight w that rises from 0 to 1, the velocities of both motions are blended,

.. math:: m' = (1 - w)\, m_a' + w\, m_b' .

This is the derivative of :math:`(1 - w)\, m_a + w\, m_b + \int w' (m_a - m_b)\, dt`. The second motion is translated by
the integral over the whole transition, so that the last term vanishes at the end.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mixseq.errors import SettingsError
from mixseq.operations.sections import (
    ModelSection,
    Seam,
    breakpoints,
    centre_columns,
    check_fade,
    join_models,
    map_times,
    motion_seam,
    sites_between,
    snap_section,
    subdivide,
)
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.sequence.header import UP_AXES
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.types import Float

SITES_PER_KNOT = 8  # number of sites per knot of the splines that are integrated


@public
def travel_of(model: Model, even: bool = False) -> Curve:
    """Return the displacement of a model's body along the ground since the start.

    Parameters
    ----------
    model : Model
        The motion.
    even : bool
        Return travel at constant speed, as game engines move walking characters; by default return the actual motion.

    Returns
    -------
    Curve
        Displacement that `in_place` removes: three coordinates in the units of the points. It is zero at the start, and
        always zero along the up axis.

    Raises
    ------
    SettingsError
        If the space has no placement.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.operations import in_place
    >>> triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> points = triangle + np.arange(5.0)[:, None, None] * [2, 0, 1]  # (2, 0, 1) per frame
    >>> model = mixseq.fit(mixseq.MeshSequence.from_arrays(points, [[0, 1, 2]]), exact=True, space="lri")
    >>> travel_of(model)(model.end).round(9).tolist()
    [[8.0, 0.0, 4.0]]
    >>> bool(np.allclose(in_place(model).sample().points, triangle))
    True
    """
    position = ground_position(model)
    start, end = position([model.start, model.end]) * model.space.scale
    if not even:
        return Curve(position.times, position.values * model.space.scale - start)
    duration = model.end - model.start
    fraction = (position.times - model.start) / (duration if duration > 0 else 1.0)
    return Curve(position.times, fraction[:, None] * (end - start))


@public
def in_place(model: Model, even: bool = False) -> Model:
    """Remove the travel of a model along the ground, so that the body stays at its start.

    Rotations and vertical motion are kept. `travel_of` returns the removed displacement.

    Parameters
    ----------
    model : Model
        The motion, such as a walking character.
    even : bool
        Remove only the mean velocity, so that a cycle keeps its sway. By default the position of the body is fixed.

    Raises
    ------
    SettingsError
        If the space has no placement.
    """
    return translate(model, -travel_of(model, even).values / model.space.scale)


def ground_position(model: Model) -> Curve:
    """Return the curve of the body's position on the ground, three coordinates in the space's unit."""
    space = model.space
    columns = centre_columns(space)
    if not len(columns):
        raise SettingsError(
            f"the {space.name} space has no positions of bodies, so nothing can travel; leave out travel, or fit the "
            "model with space='mixed'"
        )
    ground_mask = np.array([axis != model.header.up_axis for axis in UP_AXES])
    centres = model.placement.values[:, columns]
    # the weight of a quaternion in the space is twice the radius of gyration
    diameters = space.weights[space.shape_dim :][: 4 * space.rotation_count].reshape(-1, 4)[:, 0]
    weights = np.square(diameters) / np.square(diameters).sum()
    return Curve(model.placement.times, np.einsum("g,mgi->mi", weights, centres) * ground_mask)


def ground_displacement(model: Model, start: float, end: float) -> Float:
    """Return the body's displacement ``(3,)`` along the ground between two times, in the space's unit."""
    first, last = ground_position(model)([start, end])
    return np.asarray(last - first)


def translate(model: Model, offset: Float) -> Model:
    """Translate a model by a constant offset ``(3,)`` or offsets of placement knots ``(m, 3)``, in the space's unit."""
    placement = model.placement
    values = placement.values.copy()
    values[:, centre_columns(model.space)] += offset if offset.ndim == 1 else offset[:, None]
    return model.edited(placement=Curve(placement.times, values))


def ground_drift(
    a: Model, b: Model, start: float, end: float, weight_rate: Callable[[Float], Float]
) -> Callable[[Float], Float]:
    r"""Return the integral :math:`\int w' (m_a - m_b)\, dt` from the start of a transition, as a function of times."""
    from scipy.interpolate import CubicHermiteSpline  # slow import

    position_a, position_b = ground_position(a), ground_position(b)
    knots = np.concatenate([breakpoints(position_a), breakpoints(position_b)])
    sites = subdivide(sites_between(start, end, knots), SITES_PER_KNOT)
    integrand = Curve(sites, weight_rate(sites) * (position_a(sites) - position_b(sites)))
    integral = CubicHermiteSpline(integrand.times, integrand.values, integrand.slopes[:]).antiderivative()
    return lambda times: np.asarray(integral(times) - integral(start))


MAX_REPETITIONS = 10_000  # largest number of repetitions of a section


@public
def cut(model: Model, start: Seconds, end: Seconds, at: Seconds | None = None) -> Model:
    """Extract a section of a model.

    Parameters
    ----------
    model : Model
        The motion.
    start, end : float
        Section in seconds. The result starts and ends there, and keeps the frames of the section.
    at : float, optional
        Start time of the result, in seconds; by default `start`.

    Raises
    ------
    SettingsError
        If the section is outside the model, has no duration, or contains no frame.
    """
    first, last = snap_section(model, start, end)
    section = join_models([ModelSection(model, first, last)], [])
    return section if at is None else shift(section, at - first)


@public
def repeat(
    model: Model, start: Seconds, end: Seconds, times: int = 2, fade: Seconds | None = None, travel: bool = False
) -> Model:
    """Repeat a section of a model.

    The motion before and after the section is only shifted in time. Between repetitions, value, slope and curvature of
    all signals are made continuous by changes within the section.

    Parameters
    ----------
    model : Model
        The motion.
    start, end : float
        Section in seconds, such as one cycle of a walk.
    times : int
        Number of repetitions.
    fade : float, optional
        Seconds before and after every seam over which jumps are distributed; at most the duration of the section, by
        default a quarter of the maximum.
    travel : bool
        Move every repetition along the ground by the travel of the section (`travel_of`), which should be a whole
        cycle. Heading and height do not change.

    Raises
    ------
    SettingsError
        If the section is outside the model or has no duration, a setting is out of range, or `travel` is set and the
        space has no placement.
    """
    first, last = snap_section(model, start, end)
    if not 1 <= times <= MAX_REPETITIONS:
        raise SettingsError(f"times is {times}; give 1 to {MAX_REPETITIONS:,} repetitions")
    fade = check_fade(fade, last - first)
    displacement = ground_displacement(model, first, last) if travel else np.zeros(3)
    sections = []
    for number in range(times):
        delay = number * (last - first)
        copy = map_times(translate(model, number * displacement), delay) if number else model
        start = first + delay if number else copy.start
        end = last + delay if number < times - 1 else copy.end
        sections.append(ModelSection(copy, start, end))
    return join_models(sections, [motion_seam(model, fade)] * (times - 1))


@public
def loop(model: Model, fade: Seconds | None = None, travel: bool = False) -> Model:
    """Close a model to a loop: make value, slope and curvature of all signals equal at the start and the end.

    The last frame equals the first. Parts that make whole turns keep turning.

    Parameters
    ----------
    model : Model
        The motion, such as one cycle of a walk; `cut` extracts a cycle from a longer sequence.
    fade : float, optional
        Seconds at the start and at the end over which jumps are distributed; at most half the duration of the model, by
        default a quarter of the maximum.
    travel : bool
        Keep the travel along the ground (`travel_of`): the last frame equals the first except for its position. By
        default the body returns to its start.

    Raises
    ------
    SettingsError
        If the model has no duration, the fade is out of range, or `travel` is set and the space has no placement.
    """
    start, end = snap_section(model, model.start, model.end)
    fade, length = check_fade(fade, (end - start) / 2), end - start
    displacement = ground_displacement(model, start, end) if travel else np.zeros(3)
    # Join two copies: the second half of the first copy and the first half of the second meet at the loop's seam.
    second = ModelSection(map_times(translate(model, displacement), length), start + length, end + length)
    passes = join_models([ModelSection(model, start, end), second], [motion_seam(model, fade)])
    middle = (start + end) / 2
    moved_back = map_times(translate(passes, -displacement), -length)
    sections = [ModelSection(moved_back, start, middle), ModelSection(passes, middle, end)]
    return join_models(sections, [Seam(length / 4)])


@public
def shift(model: Model, seconds: Seconds) -> Model:
    """Shift a model in time by a number of seconds; negative numbers shift to earlier times.

    Raises
    ------
    SettingsError
        If `seconds` is not finite.
    """
    if not np.isfinite(seconds):
        raise SettingsError(f"seconds is {seconds}; a number is expected")
    return map_times(model, float(seconds))


@public
def speed(model: Model, factor: float) -> Model:
    """Speed up a model by a factor, with the same start time.

    The number of frames does not change; `Model.sample` and `mixseq.operations.resampling` make new frames.

    Raises
    ------
    SettingsError
        If the factor is not positive.
    """
    if not (np.isfinite(factor) and factor > 0):
        raise SettingsError(f"factor is {factor}; a positive number is expected (reverse runs backwards)")
    return map_times(model, model.start * (1.0 - 1.0 / factor), 1.0 / factor)


@public
def reverse(model: Model) -> Model:
    """Reverse a model in time, with the same start and end times."""
    return map_times(model, model.start + model.end, -1.0)
