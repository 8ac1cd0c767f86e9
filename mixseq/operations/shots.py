r"""Several shots of one character: models in one pose space, and the moments at which motions meet.

`fit_shots` fits one model to the frames of all shots, with cuts between them, and takes it apart. So the shots have the
same parts, key shapes and pose space: blends of them add no key shapes, and distances between poses of different shots
are those of one shot.

Moments are found as in motion graphs (Kovar, Gleicher and Pighin 2002): the distance of the moments t of a and u of b
is the root mean square over a window d,

.. math:: D(t, u)^2 = \frac{1}{d} \int_0^d | c_a(t + x) - c_b(u + x) |^2 \, dx ,

so that poses and velocities are alike where it is small. The norm is that of shapes, in diagonals. It depends neither
on the place nor on the heading of bodies. A small distance does not exclude that a blend of both strains the mesh where
parts are turned differently. So the strain S(t, u) is measured in the middle of the window: the root mean square over
the edges of what their length in a blend of equal weights is longer or shorter than in both, relative to these. Moments
are local minima of :math:`\sqrt{D^2 + S^2}` over the frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.spatial.distance import cdist

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.measures import edge_lengths, element_blocks
from mixseq.mesh.topology import Topology
from mixseq.operations.timeline import cut
from mixseq.operations.transitions import match_spaces
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, Seconds
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float

WINDOW_SAMPLES = 5  # number of poses that are compared in a window
MAX_BLENDED_VERTICES = 1 << 21  # vertices of all blends whose strain is measured, nearest first, in about a second
MIN_EDGE_LENGTH = 1e-6  # length in diagonals below which edges of blends are not measured


class Moment(NamedTuple):
    """A moment at which two motions are alike."""

    leave: float  # time in the first motion, in seconds
    enter: float  # time in the second motion, in seconds
    distance: float  # root mean square distance of both in the window that follows, in diagonals
    strain: float  # root mean square relative change of edge lengths by a blend in the middle of the window


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
        section = cut(model, start, start + duration, at=shot.times[0])
        sections.append(replace(section, header=replace(section.header, name=shot.name, fps=shot.fps)))
    return tuple(sections)


@public
def find_moments(
    a: FileOr[Model], b: FileOr[Model] | None = None, duration: Seconds = 0.25, count: int = 8
) -> tuple[Moment, ...]:
    """Find the moments to leave one motion and enter another, or to go back in the same motion, best first.

    ``transition(a, b, at=moment.leave, enter=moment.enter, duration=duration)`` goes from one to the other.
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
    strains = _blend_strains(a, b, leave + duration / 2, enter + duration / 2, distances)
    costs = np.hypot(distances, strains)
    rows, columns = np.nonzero(np.isfinite(costs) & (costs <= minimum_filter(costs, size=3, mode="nearest")))
    order = np.argsort(costs[rows, columns], kind="stable")
    moments: list[Moment] = []
    for i, j in zip(rows[order], columns[order], strict=True):
        moment = Moment(float(leave[i]), float(enter[j]), float(distances[i, j]), float(strains[i, j]))
        near = (max(abs(moment.leave - each.leave), abs(moment.enter - each.enter)) < duration for each in moments)
        if not any(near):
            moments.append(moment)
        if len(moments) == count:
            break
    return tuple(moments)


def _blend_strains(a: Model, b: Model, times: Float, other_times: Float, distances: Float) -> Float:
    """Return the strains ``(n, m)`` of blends of two models at times ``(n,)``, ``(m,)``; infinite if not measured."""
    space, edges = a.space, Topology(a.header.faces, a.header.vertex_count).edges
    placed = slice(space.shape_dim, space.shape_dim + space.placement_dim)

    def measure(vectors: Float) -> Float:
        return np.maximum(edge_lengths(space.decode(vectors), edges) / space.scale, MIN_EDGE_LENGTH)

    vectors, other_vectors = a.curve(times), b.curve(other_times)
    vectors[:, placed] = other_vectors[:, placed] = vectors[0, placed]
    strains = np.full(distances.shape, np.inf)
    pairs = np.argsort(distances, axis=None, kind="stable")[: np.isfinite(distances).sum()]
    pairs = pairs[: max(1, MAX_BLENDED_VERTICES // a.header.vertex_count)]
    with one_blas_thread():
        lengths, other_lengths = measure(vectors), measure(other_vectors)
        for block in element_blocks(len(pairs), len(edges)):
            i, j = np.unravel_index(pairs[block], strains.shape)
            blended = measure(0.5 * (vectors[i] + other_vectors[j]))
            longer = blended / np.maximum(lengths[i], other_lengths[j]) - 1.0
            shorter = 1.0 - blended / np.minimum(lengths[i], other_lengths[j])
            excess = np.maximum(0.0, np.maximum(longer, shorter))
            strains[i, j] = np.sqrt(np.square(excess).mean(axis=1))
    return strains


def _windows(model: Model, duration: float) -> tuple[Float, Float]:
    """Return frame times ``(n,)`` and the poses in windows after them ``(n, K r)``, with distances in diagonals."""
    slack = FRAME_TOLERANCE / model.header.fps
    times = model.times[model.times + duration <= model.end + slack]
    samples = np.minimum(times[:, None] + np.linspace(0.0, duration, WINDOW_SAMPLES), model.end)
    jacobian = model.pose.matrix @ (model.shapes - model.shapes[0]) * model.space.shape_weights
    sizes, axes = np.linalg.eigh(jacobian @ jacobian.T / model.header.vertex_count)
    points = model.time(samples.reshape(-1)) @ (axes * np.sqrt(np.maximum(sizes, 0.0)))
    return times, points.reshape(len(times), -1)
