r"""One curve from pieces of curves, exactly.

A piece of a cubic spline is a cubic spline. Where pieces meet, value, slope and curvature jump by
:math:`d_0, d_1, d_2`. Half of the jump is taken up before the *seam* and half after it, by corrections that are cubic
splines themselves, of three cubics on a window next to the seam, and two times continuously differentiable:

.. math:: p(u) = \sum_{j=1}^3 a_j\, (r_j - u)_+^3, \qquad u = |t - t_\text{seam}|, \qquad r_j = j / 3 \cdot \text{fade}

They end smoothly, whatever the coefficients :math:`a_j`, and these follow from the three jumps. So the whole is a cubic
spline again, equal to the pieces outside the windows. Every knot of a piece, a seam or a window is a knot of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float
from mixseq.signals.curve import Curve

REACHES = np.array([1.0, 2.0, 3.0]) / 3.0
"""Where the three cubics of a correction end, as fractions of the fade."""

NEAR = 0.02
"""Ends of corrections that miss a knot by less, as a fraction of the fade, move there: close knots lose digits."""

EQUAL = 1e-8
"""Knots closer than this fraction of their mean distance are one, but for rounding."""


class Piece(NamedTuple):
    """What a curve does from `start` to `end`, in seconds."""

    curve: Curve
    start: float
    end: float


class Fade(NamedTuple):
    """How a jump is taken up.

    Attributes
    ----------
    seconds : float
        Length of the windows before and after the seam, not longer than the pieces are there.
    share : float
        Fraction of the jump that is taken up before the seam.
    """

    seconds: float
    share: float = 0.5


def breakpoints(curve: Curve) -> Float:
    """Return the times ``(n,)`` where the curve passes from one cubic to another: all but two knots at each end."""
    return curve.times[2:-2]


def between(times: Float, start: float, end: float) -> Float:
    """Return those of the times that are after the start and before the end."""
    return times[(times > start) & (times < end)]


def join(pieces: Sequence[Piece], fades: Sequence[Fade]) -> Curve:
    """Make one curve of pieces that follow each other.

    Parameters
    ----------
    pieces : sequence of n Piece
        Each starts where the one before ends, up to rounding, and lasts.
    fades : sequence of n - 1 Fade
        How the jumps between them are taken up.

    Returns
    -------
    Curve
        From the first start to the last end, two times continuously differentiable.
    """
    seams = np.array([piece.end for piece in pieces[:-1]])
    edges = np.concatenate([[pieces[0].start], seams, [pieces[-1].end]])
    corrections: list[list[_Correction]] = [[] for _ in pieces]
    for number, (before, after, fade) in enumerate(zip(pieces, pieces[1:], fades, strict=False)):
        jump = _jet(after.curve, after.start) - _jet(before.curve, before.end)
        for piece, side, part in ((before, -1, fade.share), (after, 1, fade.share - 1)):
            if part:
                correction = _Correction.closing(part * jump, piece, seams[number], side, fade.seconds)
                corrections[number + (side > 0)].append(correction)
    inner = [
        between(knots, start, end)
        for piece, own, start, end in zip(pieces, corrections, edges, edges[1:], strict=False)
        for knots in (breakpoints(piece.curve), *(correction.knots for correction in own))
    ]
    sites = sites_of(edges, np.concatenate(inner))
    of_site = np.searchsorted(seams, sites, side="left")
    values = np.concatenate(
        [
            piece.curve(at) + sum((correction(at) for correction in own), start=np.zeros(()))
            for number, (piece, own) in enumerate(zip(pieces, corrections, strict=True))
            for at in (sites[of_site == number],)
        ]
    )
    return Curve(sites, values)


def sites_of(edges: Float, inner: Float) -> Float:
    """Return times that a spline with given breakpoints must be known at: these, and one in its first and last piece.

    Parameters
    ----------
    edges : (n,) float64
        Breakpoints that stay, increasing: the first and the last are the ends of the spline.
    inner : (m,) float64
        Others, in any order, between the ends; those that equal another one up to rounding are left out.
    """
    inner = np.unique(inner)
    close = EQUAL * (edges[-1] - edges[0]) / (len(edges) + len(inner))
    after = np.clip(np.searchsorted(edges, inner), 1, len(edges) - 1)
    nearest = np.minimum(np.abs(inner - edges[after - 1]), np.abs(inner - edges[after]))
    inner = inner[nearest > close]
    inner = inner[np.diff(inner, prepend=-np.inf) > close]
    breaks = np.sort(np.concatenate([edges, inner]))
    if len(breaks) == 2:
        return np.linspace(breaks[0], breaks[1], 4)
    return np.sort(np.concatenate([breaks, (breaks[[0, -2]] + breaks[[1, -1]]) / 2]))


def refined(times: Float, parts: int) -> Float:
    """Return times with every interval between them cut into so many parts."""
    steps = np.arange(parts) / parts
    between = times[:-1, None] + steps * np.diff(times)[:, None]
    return np.append(between.reshape(-1), times[-1])


def moved(curve: Curve, scale: float, offset: float) -> Curve:
    """Return the curve with its times t moved to ``scale * t + offset``; backwards where the scale is negative."""
    times, values = scale * curve.times + offset, curve.values
    return Curve(times, values) if scale > 0 else Curve(times[::-1], values[::-1])


def _jet(curve: Curve, time: float) -> Float:
    """Value, slope and curvature ``(3, k)`` at a time."""
    return np.concatenate([curve([time]), curve.derivative([time]), curve.derivative([time], 2)])


class _Correction(NamedTuple):
    """A spline ``(3, k)`` of three truncated cubics on one side of a seam: -1 before it, 1 after it."""

    seam: float
    side: int
    reaches: Float
    coefficients: Float

    @classmethod
    def closing(cls, jet: Float, piece: Piece, seam: float, side: int, fade: float) -> _Correction:
        """Make the correction with given value, slope and curvature ``(3, k)`` at the seam."""
        knots = between(breakpoints(piece.curve), piece.start, piece.end)
        reaches = fade * REACHES
        away = side * (np.concatenate([knots, [piece.start, piece.end]]) - seam)
        for number, reach in enumerate(reaches):
            near = away[np.abs(away - reach) < NEAR * fade]
            if len(near):
                reaches[number] = near[np.abs(near - reach).argmin()]
        r = reaches / fade
        system = np.stack([r**3, -3.0 * r**2, 6.0 * r])
        scaled = jet * np.array([1.0, side * fade, fade**2])[:, None]
        return cls(seam, side, reaches, np.linalg.solve(system, scaled) / fade**3)

    @property
    def knots(self) -> Float:
        """Where its cubics end ``(3,)``."""
        return self.seam + self.side * self.reaches

    def __call__(self, times: Float) -> Float:
        left = np.maximum(self.reaches - self.side * (times - self.seam)[:, None], 0.0)
        return np.asarray(left**3 @ self.coefficients)
