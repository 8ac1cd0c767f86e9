r"""Travel: displacement of a body along the ground, the root motion of game engines.

The place of a body is the mean of the centres :math:`c_i` of its parts,
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

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.operations.placements import centre_columns
from mixseq.operations.splines import between, breakpoints, refined, sites_of
from mixseq.public import public
from mixseq.sequence import UP_AXES
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.base import ShapeSpace

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
    inner = between(np.concatenate([breakpoints(one), breakpoints(other)]), start, end)
    sites = refined(sites_of(np.array(ends), inner), FINE)
    grown = Curve(sites, slope(sites) * (one(sites) - other(sites))).spline.antiderivative()
    return lambda times: np.asarray(grown(times) - grown(start))


def _sizes(space: ShapeSpace) -> Float:
    """Return part weights ``(g,)`` of sum 1; a quaternion's weight in the space is twice the radius of gyration."""
    turns = space.weights[space.shape_dim :][: 4 * space.rotation_count].reshape(-1, 4)[:, 0]
    return np.asarray(np.square(turns) / np.square(turns).sum())
