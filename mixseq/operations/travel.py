r"""Travel: how far a body gets along the ground; what engines call root motion.

A body is where its parts are on the mean, :math:`m(t) = \sum_i r_i^2\, c_i(t) / \sum_i r_i^2`, with their centres
:math:`c_i`, and with their radii of gyration :math:`r_i` squared, which stand for their areas: hands that swing do not
count as much as the trunk. Only what is along the ground counts, at right angles to the axis that points up.

Where one motion passes over into another with the weight w, rising from 0 to 1, the body shall go at the speed that is
between both,

.. math:: m' = (1 - w)\, m_a' + w\, m_b' .

The mean of both places, :math:`(1 - w)\, m_a + w\, m_b`, does so but for :math:`\int w' (m_a - m_b)\, dt`, which is
added to it. It comes to nothing by the end if the second motion is moved by that integral over all of the transition.
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
"""Points for each knot through which integrals are splines."""


@public
def travel_of(model: Model, even: bool = False) -> Curve:
    """Return how far the body has got along the ground since the start of a model.

    Parameters
    ----------
    model : Model
        The motion.
    even : bool
        At one speed from the start to the end, as engines move a character that walks; by default as it is.

    Returns
    -------
    Curve
        Three coordinates, those of the model's points, in its units: zeros at the start, and along the axis that points
        up. What `in_place` takes away.

    Raises
    ------
    SettingsError
        If the space has no placement that could travel.

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

    It still turns, and goes up and down. `travel_of` tells what is taken away.
    The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion, such as a character that walks.
    even : bool
        Take away one speed, from the start to the end; so a cycle sways to and fro as it did. By default the middle of
        the body stands still.

    Raises
    ------
    SettingsError
        If the space has no placement that could travel.
    """
    return carried(model, -travel_of(model, even).values / model.space.scale)


def place_of(model: Model) -> Curve:
    """Return where the body is along the ground, three coordinates in the space's unit; see `travel_of`."""
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
    """Return how far the body gets ``(3,)`` from one time to another, in the space's unit."""
    first, last = place_of(model)([start, end])
    return np.asarray(last - first)


def carried(model: Model, offset: Float) -> Model:
    """Return the model with all parts moved by offsets ``(3,)``, or ``(m, 3)`` for the placement's knots.

    They are in the space's unit.
    """
    placement = model.placement
    values = placement.values.copy()
    values[:, centre_columns(model.space)] += offset if offset.ndim == 1 else offset[:, None]
    return replace(model, placement=Curve(placement.times, values))


def drift(
    a: Model, b: Model, ends: tuple[float, float], slope: Callable[[Float], Float]
) -> Callable[[Float], Float]:
    r"""Return the integral :math:`\int w' (m_a - m_b)\, dt` from the start of a transition."""
    start, end = ends
    one, other = place_of(a), place_of(b)
    inner = between(np.concatenate([breakpoints(one), breakpoints(other)]), start, end)
    sites = refined(sites_of(np.array(ends), inner), FINE)
    grown = Curve(sites, slope(sites) * (one(sites) - other(sites))).spline.antiderivative()
    return lambda times: np.asarray(grown(times) - grown(start))


def _sizes(space: ShapeSpace) -> Float:
    """Return how much parts ``(g,)`` count, in all 1; quaternions move vertices by twice a radius of gyration."""
    turns = space.weights[space.shape_dim :][: 4 * space.rotation_count].reshape(-1, 4)[:, 0]
    return np.asarray(np.square(turns) / np.square(turns).sum())
