r"""Body shift and limb moves that keep resting feet in place.

Let x be the transferred path of the middle of a contact. In every stance s it should stay at an anchor, and misses it
by :math:`d = \bar x - x`, with the mean :math:`\bar x` over the stance. The common shift r of the whole body minimises

.. math::

    \min_{r, b} \sum_{s} \sum_{t \in s} |d_{st} + b_s - r_t|^2
    + \alpha \sum_t |r_{t+1} - 2 r_t + r_{t-1}|^2 + \beta \sum_t |r_{t+1} - r_t|^2 .

Along the ground the anchor is :math:`\bar x + b`, with free b, so that strides that do not fit the legs lengthen or
shorten the path, and the body moves evenly; upwards b is zero and :math:`\gamma \sum_t |r_t|^2` is added against
climbing and sinking. :math:`\alpha` leaves what is quicker than `PERIOD` to the limbs, and :math:`\beta` lets the shift
come to rest within about `MEMORY` where no foot is on the ground. The limbs move by :math:`e = d + b - r`. Before and
after a stance e fades by cubic Hermite splines with its value and slope, so that feet land and lift smoothly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.retargeting.stance import Stance

Knot = tuple[int, Float, Float]
"""A frame, the value there and the slope per frame."""

PERIOD = 0.5
"""Shortest period of the body's shift, in seconds."""

MEMORY = 2.0
"""Time in which a shift without feet on the ground decays, in seconds."""

UPRIGHT = 0.05
r"""Weight :math:`\gamma` of the body's own height, where that of a foot on the ground is 1."""

FADE = 0.25
"""Longest time before and after a stance in which a foot moves to and from its place, in seconds."""


def misses(paths: Float, found: Sequence[Sequence[Stance]], negligible: float) -> Float:
    """Return the shifts ``(g, T, 3)`` of contacts to their mean in each stance; zero in the air or if negligible."""
    result = np.zeros_like(paths)
    for miss, path, some in zip(result, paths, found, strict=True):
        for stance in some:
            away = path[stance.frames].mean(axis=0) - path[stance.frames]
            if np.abs(away).max() > negligible:
                miss[stance.frames] = away
    return result


def body_shift(
    missed: Float, found: Sequence[Sequence[Stance]], axis: int, fps: float
) -> tuple[Float, Float]:
    """Return the body's shift ``(T, 3)``, and remaining moves of contacts, from misses, both ``(g, T, 3)``."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    count = missed.shape[1]
    stances = [(group, stance) for group, some in enumerate(found) for stance in some]
    lengths = [stance.stop - stance.start for _, stance in stances]
    frames = np.concatenate([np.arange(stance.start, stance.stop) for _, stance in stances])
    groups = np.repeat([group for group, _ in stances], lengths)
    numbers = np.repeat(np.arange(len(stances)), lengths)
    wanted = missed[groups, frames]

    def picked(columns: Index, size: int) -> sparse.csr_array:
        rows = np.arange(len(columns))
        return sparse.csr_array((np.ones(len(columns)), (rows, columns)), shape=(len(columns), size))

    step = (sparse.eye_array(count - 1, count, k=1) - sparse.eye_array(count - 1, count)).tocsr()
    curvature = step[:-1, :-1] @ step
    alpha = (fps * PERIOD / (2 * np.pi)) ** 4
    beta = alpha / (fps * MEMORY) ** 2
    calm = alpha * curvature.T @ curvature + beta * step.T @ step
    body = picked(frames, count)
    both = sparse.hstack([body, -picked(numbers, len(stances))])
    # Along the ground body and anchors may shift together: so far the first frame stays, and in the end the mean.
    first = sparse.coo_array(([1.0], ([0], [0])), shape=(count, count))
    calmer = sparse.block_diag([calm + first, sparse.coo_array((len(stances), len(stances)))])

    ground = np.arange(3) != axis
    shift, anchors = np.zeros((count, 3)), np.zeros((len(stances), 3))
    along = splu((both.T @ both + calmer).tocsc()).solve(both.T @ wanted[:, ground])
    along -= along[:count].mean(axis=0)
    shift[:, ground], anchors[:, ground] = along[:count], along[count:]
    upright = body.T @ body + calm + UPRIGHT * sparse.eye_array(count)
    shift[:, axis] = splu(upright.tocsc()).solve(body.T @ wanted[:, axis])
    left = np.zeros_like(missed)
    left[groups, frames] = wanted + anchors[numbers] - shift[frames]
    return shift, left


def faded(wanted: Float, some: Sequence[Stance], fps: float) -> Float:
    """Return moves ``(T, 3)`` of a contact, as given in its stances and smooth in between.

    They fade from zero before a stance and to zero after it, or to the next stance if that is near.
    """
    result = np.zeros_like(wanted)
    fade = max(2, round(FADE * fps))
    still = np.zeros(3)

    def lead(start: Knot, stop: Knot) -> None:
        frames = np.arange(max(start[0], 0), min(stop[0] + 1, len(result)))
        result[frames] = _hermite(frames, start, stop)

    last: Knot | None = None
    for stance in some:
        first = _knot(wanted, stance.start, min(stance.start + 1, stance.stop - 1))
        if last is not None and first[0] - last[0] <= 2 * fade:
            lead(last, first)
        else:
            if last is not None:
                lead(last, (last[0] + fade, still, still))
            lead((first[0] - fade, still, still), first)
        result[stance.frames] = wanted[stance.frames]
        last = _knot(wanted, stance.stop - 1, max(stance.stop - 2, stance.start))
    if last is not None:
        lead(last, (last[0] + fade, still, still))
    return result


def _knot(values: Float, frame: int, beside: int) -> Knot:
    slope = (values[beside] - values[frame]) / (beside - frame or 1)
    return frame, values[frame], slope


def _hermite(frames: Index, start: Knot, stop: Knot) -> Float:
    """Return a cubic ``(n, 3)`` between two knots."""
    (first, a, slope_a), (last, b, slope_b) = start, stop
    span = last - first
    s = ((frames - first) / span)[:, None]
    bows = span * (s * (1 - s) ** 2 * slope_a - s * s * (1 - s) * slope_b)
    return np.asarray(a + s * s * (3 - 2 * s) * (b - a) + bows)
