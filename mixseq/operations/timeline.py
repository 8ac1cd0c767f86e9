r"""Edits of the time line: cut, repeat, loop, shift, change speed, reverse; and travel along the ground.

Travel is the root motion of game engines. The place of a body is the mean of the centres :math:`c_i` of its parts,
:math:`m(t) = \sum_i r_i^2\, c_i(t) / \sum_i r_i^2`, weighted by their squared radii of gyration :math:`r_i` in place of
areas. The component along the up axis is left out.

In a transition with the weight w, rising from 0 to 1, the speed of the body is blended,

.. math:: m' = (1 - w)\, m_a' + w\, m_b' .

This is the derivative of :math:`(1 - w)\, m_a + w\, m_b + \int w' (m_a - m_b)\, dt`. Moving the second motion by the
integral over the whole transition makes the last term vanish at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mixseq.errors import SettingsError
from mixseq.operations.sections import (
    ModelSection,
    Seam,
    affine,
    breakpoints,
    centre_columns,
    concatenated,
    fade_of,
    refined,
    section_of,
    shifted,
    sites_between,
)
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.sequence.header import UP_AXES
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.base import ShapeSpace
from mixseq.types import Float

FINE = 8
"""Sites for each knot of the splines through integrals."""


@public
def travel_of(model: Model, even: bool = False) -> Curve:
    """Return how far the body has got along the ground since the start of a model.

    Parameters
    ----------
    model : Model
        The motion.
    even : bool
        Travel at constant speed from start to end, as engines move walking characters; by default as it is.

    Returns
    -------
    Curve
        Displacement (three coordinates) in the units of the points, removed by `in_place`; zero at the start, and along
        the up axis.

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
    place = place_of(model)
    start, end = place([model.start, model.end]) * model.space.scale
    if not even:
        return Curve(place.times, place.values * model.space.scale - start)
    span = model.end - model.start
    share = (place.times - model.start) / (span if span > 0 else 1.0)
    return Curve(place.times, share[:, None] * (end - start))


@public
def in_place(model: Model, even: bool = False) -> Model:
    """Return the model without its travel: the body stays where it starts, and moves as it did otherwise.

    Turns and vertical motion stay. `travel_of` returns the displacement that is removed. The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion, such as a character that walks.
    even : bool
        Remove a constant speed, so that a cycle keeps its sway; by default the place of the body is fixed.

    Raises
    ------
    SettingsError
        If the space has no placement.
    """
    return carried(model, -travel_of(model, even).values / model.space.scale)


def place_of(model: Model) -> Curve:
    """Return the place of the body along the ground, three coordinates in the space's unit; see `travel_of`."""
    space = model.space
    columns = centre_columns(space)
    if not len(columns):
        raise SettingsError(
            f"the {space.name} space does not say where parts are, so nothing can travel; leave out travel, or use a "
            "model that was fitted with space='mixed'"
        )
    along_ground = np.array([axis != model.header.up_axis for axis in UP_AXES])
    centres = model.placement.values[:, columns]
    return Curve(model.placement.times, np.einsum("g,mgi->mi", _sizes(space), centres) * along_ground)


def step_of(model: Model, start: float, end: float) -> Float:
    """Return the displacement ``(3,)`` of the body along the ground between two times, in the space's unit."""
    first, last = place_of(model)([start, end])
    return np.asarray(last - first)


def carried(model: Model, offset: Float) -> Model:
    """Return the model with parts moved by offsets ``(3,)`` or, per placement knot, ``(m, 3)``, in the space's unit."""
    placement = model.placement
    values = placement.values.copy()
    values[:, centre_columns(model.space)] += offset if offset.ndim == 1 else offset[:, None]
    return replace(model, placement=Curve(placement.times, values))


def drift(
    a: Model, b: Model, ends: tuple[float, float], slope: Callable[[Float], Float]
) -> Callable[[Float], Float]:
    r"""Return the integral :math:`\int w' (m_a - m_b)\, dt` from the start of a transition, as a function of times."""
    start, end = ends
    one, other = place_of(a), place_of(b)
    sites = refined(sites_between(start, end, np.concatenate([breakpoints(one), breakpoints(other)])), FINE)
    grown = Curve(sites, slope(sites) * (one(sites) - other(sites))).spline.antiderivative()
    return lambda times: np.asarray(grown(times) - grown(start))


def _sizes(space: ShapeSpace) -> Float:
    """Return part weights ``(g,)`` of sum 1; a quaternion's weight in the space is twice the radius of gyration."""
    turns = space.weights[space.shape_dim :][: 4 * space.rotation_count].reshape(-1, 4)[:, 0]
    return np.asarray(np.square(turns) / np.square(turns).sum())


MOST = 10_000
"""Largest number of repetitions of a section."""


@public
def cut(model: Model, start: Seconds, end: Seconds, at: Seconds | None = None) -> Model:
    """Return a section of a model.

    The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion.
    start, end : float
        Section in seconds. The result has its ends and the frames within it.
    at : float, optional
        Start time of the result, in seconds; by default times are kept.

    Raises
    ------
    SettingsError
        If the section is outside the model, has no duration, or has no frame.
    """
    first, last = section_of(model, start, end)
    section = concatenated([ModelSection(model, first, last)], [])
    return section if at is None else shift(section, at - first)


@public
def repeat(
    model: Model,
    start: Seconds,
    end: Seconds,
    times: int = 2,
    fade: Seconds | None = None,
    travel: bool = False,
) -> Model:
    """Show a section of a model several times.

    The motion before and after the section is only moved in time. At seams of the section with itself value, slope and
    curvature of all signals are made continuous by changes within it. The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion.
    start, end : float
        Section in seconds, such as one cycle of a walk.
    times : int
        Number of repetitions.
    fade : float, optional
        Seconds before and after every seam over which jumps are distributed, at most the section; by default a quarter
        of it.
    travel : bool
        Move every repetition along the ground by the travel of the section (`travel_of`), a whole cycle; heading and
        height stay.

    Raises
    ------
    SettingsError
        If the section is outside the model or has no duration, a setting is out of range, or `travel` is set and the
        space has no placement.
    """
    first, last = section_of(model, start, end)
    if not 1 <= times <= MOST:
        raise SettingsError(f"times is {times}; a section is shown 1 to {MOST:,} times")
    seconds = fade_of(fade, last - first)
    step = step_of(model, first, last) if travel else np.zeros(3)
    sections = []
    for number in range(times):
        later = number * (last - first)
        here = shifted(carried(model, number * step), later) if number else model
        start = first + later if number else here.start
        end = last + later if number < times - 1 else here.end
        sections.append(ModelSection(here, start, end))
    return concatenated(sections, [Seam(seconds)] * (times - 1))


@public
def loop(model: Model, fade: Seconds | None = None, travel: bool = False) -> Model:
    """Make the end of a model meet its start: value, slope and curvature of all signals.

    The last frame equals the first. A part that turned by whole turns turns on. The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion, such as one cycle of a walk; `cut` makes one of a longer sequence.
    fade : float, optional
        Seconds at the start and at the end over which jumps are distributed, at most half the model; by default a
        quarter of that.
    travel : bool
        Keep the travel along the ground (`travel_of`): the last frame equals the first except for its place. By default
        the body returns to its start.

    Raises
    ------
    SettingsError
        If the model has no duration, the fade is out of range, or `travel` is set and the space has no placement.
    """
    start, end = section_of(model, model.start, model.end)
    seconds, length = fade_of(fade, (end - start) / 2), end - start
    step = step_of(model, start, end) if travel else np.zeros(3)
    # The model twice: the second pass knows how to start after an end, the first how to end before a start.
    again = shifted(carried(model, step), length)
    twice = concatenated(
        [ModelSection(model, start, end), ModelSection(again, start + length, end + length)], [Seam(seconds)]
    )
    middle = (start + end) / 2
    second = shifted(carried(twice, -step), -length)
    sections = [ModelSection(second, start, middle), ModelSection(twice, middle, end)]
    return concatenated(sections, [Seam(length / 4)])


@public
def shift(model: Model, seconds: Seconds) -> Model:
    """Return the model shifted in time by a number of seconds, earlier if it is negative.

    The residual layer is left out.

    Raises
    ------
    SettingsError
        If `seconds` is not finite.
    """
    if not np.isfinite(seconds):
        raise SettingsError(f"seconds is {seconds}; a number is expected")
    return shifted(model, float(seconds))


@public
def speed(model: Model, factor: float) -> Model:
    """Return the model played faster by a factor, from its start on.

    The frames stay the same; `Model.sample` and `mixseq.operations.resampling` make new ones. The residual layer is
    left out.

    Raises
    ------
    SettingsError
        If the factor is not positive.
    """
    if not (np.isfinite(factor) and factor > 0):
        raise SettingsError(f"factor is {factor}; a positive number is expected (reverse runs backwards)")
    return affine(model, 1.0 / factor, model.start * (1.0 - 1.0 / factor))


@public
def reverse(model: Model) -> Model:
    """Return the model backwards, from the same start to the same end.

    The residual layer is left out.
    """
    return affine(model, -1.0, model.start + model.end)
