r"""Several shots of one character: models in one pose space, and the moments at which motions meet.

`fit_shots` fits one model to the frames of all shots, with cuts between them, and takes it apart. So the shots have the
same parts, key shapes and pose space: blends of them add no key shapes, and distances between poses of different shots
are those of one shot.

Moments are found as in motion graphs (Kovar, Gleicher and Pighin 2002): the distance of the moments t of a and u of b
is the root mean square over a window d,

.. math:: D(t, u)^2 = \frac{1}{d} \int_0^d | c_a(t + x) - c_b(u + x) |^2 \, dx ,

so that poses and velocities are alike where it is small. The norm is that of shapes, in diagonals. It depends neither
on the place nor on the heading of bodies. Moments are local minima of D over the frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.spatial.distance import cdist

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.operations.timeline import cut, shift
from mixseq.operations.transitions import match_spaces
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, Seconds
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float

WINDOW_SAMPLES = 5
"""Number of poses that are compared in a window."""


class Moment(NamedTuple):
    """A moment at which two motions are alike."""

    leave: float  # time in the first motion, in seconds
    enter: float  # time in the second motion, in seconds
    distance: float  # root mean square distance of both in the window that follows, in diagonals


@public
def fit_shots(shots: Sequence[MeshSequence], **settings: Any) -> tuple[Model, ...]:
    """Fit models to several shots of one character, with the same parts, key shapes and pose space.

    Parameters
    ----------
    shots : sequence of MeshSequence
        Animations of one mesh, each of two frames or more.
    **settings
        Settings of `mixseq.fit`, but for `cuts` and `knots`; tolerances hold for all shots, in diagonals of the first.

    Returns
    -------
    tuple of Model
        A model of every shot, at the times of its frames.

    Raises
    ------
    InvalidSequenceError
        If the meshes or units differ, or a shot has a single frame.
    SettingsError
        If there are no shots, or as raised by `mixseq.fit`.

    Examples
    --------
    >>> from mixseq.creature import walk_cycle
    >>> walk = walk_cycle(frames=8)
    >>> start, end = fit_shots([walk[:5], walk[3:]], space="vertex")
    >>> len(start.times), len(end.times), np.array_equal(start.shapes, end.shapes)
    (5, 5, True)
    """
    if not shots:
        raise SettingsError("there are no shots; give one or more")
    first = shots[0]
    for shot in shots:
        same_units = (shot.up_axis, shot.metres_per_unit) == (first.up_axis, first.metres_per_unit)
        if shot.vertex_count != first.vertex_count or not np.array_equal(shot.faces, first.faces) or not same_units:
            raise InvalidSequenceError(f"{shot.name!r} has another mesh or other units than {first.name!r}")
        if len(shot) < 2:
            raise InvalidSequenceError(f"{shot.name!r} has a single frame; a shot has two or more")
    step = 1.0 / first.fps
    starts = np.cumsum([0.0, *(shot.times[-1] - shot.times[0] + step for shot in shots)])
    times = np.concatenate([shot.times - shot.times[0] + start for shot, start in zip(shots, starts, strict=False)])
    joined = replace(
        first, points=np.concatenate([shot.points for shot in shots]), velocities=None, times=times, keys=None
    )
    cuts = np.cumsum([len(shot) for shot in shots])[:-1].tolist()
    model = fit(joined, cuts=cuts, **settings)
    sections = []
    for shot, start in zip(shots, starts, strict=False):
        duration = shot.times[-1] - shot.times[0]
        section = shift(cut(model, start, start + duration), shot.times[0] - start)
        sections.append(replace(section, header=replace(section.header, name=shot.name, fps=shot.fps)))
    return tuple(sections)


@public
def find_moments(
    a: FileOr[Model], b: FileOr[Model] | None = None, duration: Seconds = 0.25, count: int = 8
) -> tuple[Moment, ...]:
    """Find the moments to leave one motion and enter another, or to go back in the same motion, best first.

    ``transition(a, cut(b, moment.enter, b.end), at=moment.leave, duration=duration)`` goes from one to the other.
    Within a motion, the section from `enter` to `leave` is a cycle for `loop` and `repeat`.

    Parameters
    ----------
    a, b : Model
        Motions of one mesh, best from `fit_shots`; without b, moments of a at which it returns to an earlier pose.
    duration : float
        Seconds after the moments in which both motions are compared: those of the transition.
    count : int
        Largest number of moments.

    Returns
    -------
    tuple of Moment
        Different moments are at least `duration` apart in one of the motions; cycles last twice as long or longer.

    Raises
    ------
    InvalidSequenceError
        If the meshes differ.
    SettingsError
        If the duration or the count is not positive, or a motion is not longer than the duration.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.creature import walk_cycle
    >>> walk = mixseq.fit(walk_cycle(frames=8))
    >>> [moment] = find_moments(walk, walk, duration=0.1, count=1)
    >>> moment.leave == moment.enter, moment.distance < 1e-9
    (True, True)
    """
    a, b = cast("Model", a), cast("Model | None", b)
    if not (np.isfinite(duration) and duration > 0 and count >= 1):
        raise SettingsError(f"duration is {duration} and count {count}; positive numbers are expected")
    is_cycle = b is None
    a, b = (a, a) if b is None else match_spaces(a, b)
    for model in (a, b):
        if not model.end - model.start > duration:
            raise SettingsError(
                f"{model.header.name!r} lasts {model.end - model.start:g} s; give a duration shorter than that"
            )
    (leave, first), (enter, second) = _windows(a, duration), _windows(b, duration)
    distances = cdist(first, second) / np.sqrt(WINDOW_SAMPLES)
    if is_cycle:
        distances[leave[:, None] - enter < 2 * duration] = np.inf
    is_minimum = np.isfinite(distances) & (distances <= minimum_filter(distances, size=3, mode="nearest"))
    rows, columns = np.nonzero(is_minimum)
    order = np.argsort(distances[rows, columns], kind="stable")
    moments: list[Moment] = []
    for i, j in zip(rows[order], columns[order], strict=True):
        moment = Moment(float(leave[i]), float(enter[j]), float(distances[i, j]))
        near = (max(abs(moment.leave - each.leave), abs(moment.enter - each.enter)) < duration for each in moments)
        if not any(near):
            moments.append(moment)
        if len(moments) == count:
            break
    return tuple(moments)


def _windows(model: Model, duration: float) -> tuple[Float, Float]:
    """Return frame times ``(n,)`` and the poses in windows after them ``(n, K r)``, with distances in diagonals."""
    slack = FRAME_TOLERANCE / model.header.fps
    times = model.times[model.times + duration <= model.end + slack]
    samples = np.minimum(times[:, None] + np.linspace(0.0, duration, WINDOW_SAMPLES), model.end)
    jacobian = model.pose.matrix @ (model.shapes - model.shapes[0]) * model.space.shape_weights
    sizes, axes = np.linalg.eigh(jacobian @ jacobian.T / model.header.vertex_count)
    points = model.time(samples.reshape(-1)) @ (axes * np.sqrt(np.maximum(sizes, 0.0)))
    return times, points.reshape(len(times), -1)
