"""Signals of an encoded sequence, with as much detail as is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import SettingsError
from mixseq.mapping import OrderedMap, serially
from mixseq.progress import Progress, silent
from mixseq.sequence import FloatArray, MeshSequence, SequenceHeader
from mixseq.signals.curve import Curve, Measure, fit_curve, least_squares_curve
from mixseq.signals.model import Model
from mixseq.signals.pose import Modes, choose_keys, key_map, principal_modes
from mixseq.spaces.base import ShapeSpace
from mixseq.stored import Stored, blocks_of
from mixseq.table import Table, new_table

Float = NDArray[np.float64]
PoseForm = Literal["modes", "keys"]


@dataclass(frozen=True, eq=False)
class Encoded:
    """A sequence as vectors of a shape space.

    Attributes
    ----------
    header : SequenceHeader
        Mesh and times.
    space : ShapeSpace
        The space.
    shapes : (T, S + O) table of float64
        The vectors of the frames without their placement, and their offsets (`ShapeSpace.offsets`).
    placement : (T, P) float64
        The independent numbers of the placement.
    pose : {"modes", "keys"}
        What key shapes shall be.
    """

    header: SequenceHeader
    space: ShapeSpace
    shapes: Table
    placement: Float
    pose: PoseForm = "modes"

    @cached_property
    def modes(self) -> Modes:
        """All modes of the shapes and their offsets."""
        return principal_modes(self.shapes, self.space.shape_weights)

    @cached_property
    def shape_measure(self) -> Measure:
        """How far deviations of scores are: root mean square over the vertices, in diagonals."""
        root = np.sqrt(self.header.vertex_count)
        return lambda scores: np.asarray(np.linalg.norm(scores, axis=1) / root)

    @cached_property
    def placement_measure(self) -> Measure:
        """How far deviations of the placement are: the largest coordinate, in diagonals."""
        start = self.space.dim - self.space.placement_dim
        weights = self.space.weights[start : start + self.space.stored_placement_dim]
        return lambda deviations: np.asarray(np.abs(deviations * weights).max(axis=1, initial=0.0))


def encode(
    sequence: Stored | MeshSequence,
    space: ShapeSpace,
    pose: PoseForm = "modes",
    workers: OrderedMap = serially,
    progress: Progress = silent,
) -> Encoded:
    """Encode all frames of a sequence in a space.

    Parameters
    ----------
    sequence : Stored or MeshSequence
        The sequence.
    space : ShapeSpace
        The space.
    pose : {"modes", "keys"}
        What key shapes shall be.
    workers : OrderedMap, optional
        Who encodes blocks of frames.
    progress : callable, optional
        Told about every block.

    Raises
    ------
    OutputError
        If there is no room for the vectors, neither in memory nor in a temporary file.
    """
    count, start = len(sequence.points), space.dim - space.placement_dim
    shapes = new_table((count, start + space.offset_dim))
    placement = np.empty((count, space.stored_placement_dim))
    previous, done = None, 0
    for apart, offsets in workers(_encoded, space, blocks_of(sequence.points)):
        vectors = space.without_jumps(apart, previous)
        rows = slice(done, done + len(vectors))
        shapes[rows] = np.concatenate([vectors[:, :start], offsets], axis=1)
        placement[rows] = vectors[:, start : start + placement.shape[1]]
        previous, done = vectors[-1], rows.stop
        progress(done, count, "encoding frames")
    return Encoded(sequence.header, space, shapes, placement, pose)


def _encoded(space: ShapeSpace, points: FloatArray) -> tuple[Float, Float]:
    """Vectors and offsets of a block of frames; nothing of them depends on other frames."""
    vectors = space.encode_apart(points)
    offsets = [space.offsets(points[t : t + 1], vectors[t : t + 1]) for t in range(len(points))]
    return vectors, np.concatenate(offsets)


@dataclass(frozen=True)
class Detail:
    """How detailed signals are.

    Attributes
    ----------
    rank : int, optional
        Number of shape modes; by default all there are.
    slack : float
        How far, in diagonals, the signals may be from the frames (by the measures of `Encoded`); zero to pass
        through them all.
    knots : int or (n,) array_like, optional
        Inner knots of all curves, instead of those that slack chooses.
    """

    rank: int | None = None
    slack: float = 0.0
    knots: int | ArrayLike | None = None


def build(encoded: Encoded, detail: Detail) -> Model:
    """Make the model of an encoded sequence.

    Raises
    ------
    SettingsError
        If there are more knots than frames can tell, or knots are outside the sequence.
    """
    times = encoded.header.times
    rank = _rank(encoded, detail)
    modes = encoded.modes.first(rank)
    if encoded.pose == "modes":
        pose, shapes = modes.pose_map(), modes.key_shapes()
    else:
        frames = choose_keys(modes.scores)
        pose = key_map(modes.scores[frames])
        shapes = encoded.shapes[frames]
    if detail.knots is not None:
        inner = _inner_knots(detail.knots, times)
        time = least_squares_curve(times, modes.scores, inner)
        placement = least_squares_curve(times, encoded.placement, inner)
    elif detail.slack > 0:
        time = fit_curve(times, modes.scores, detail.slack, encoded.shape_measure)
        placement = fit_curve(times, encoded.placement, detail.slack, encoded.placement_measure)
    else:
        time, placement = Curve(times, modes.scores), Curve(times, encoded.placement)
    return Model(encoded.header, encoded.space, time, pose, shapes, placement)


def _rank(encoded: Encoded, detail: Detail) -> int:
    """Return the number of modes: as asked for, or so many that all frames are within the slack."""
    scores = encoded.modes.scores
    if detail.rank is not None:
        return min(detail.rank, len(encoded.modes.sizes))
    tails = np.sqrt(np.cumsum(np.square(scores[:, ::-1]), axis=1)[:, ::-1])  # norm of all modes from each on
    worst = tails.max(axis=0, initial=0.0) / np.sqrt(encoded.header.vertex_count)
    return int(np.count_nonzero(worst > detail.slack))


def _inner_knots(knots: int | ArrayLike, times: Float) -> Float:
    most = max(len(times) - 4, 0)
    if isinstance(knots, int | np.integer):
        if not 0 <= knots <= most:
            raise SettingsError(f"knots is {knots}; {len(times)} frames can tell of 0 to {most} inner knots")
        if knots == most:
            return times[2:-2]
        places = np.linspace(0, len(times) - 1, int(knots) + 2)[1:-1]
        return np.interp(places, np.arange(len(times)), times)
    inner = np.unique(np.asarray(knots, dtype=np.float64).reshape(-1))
    if len(inner) > most:
        raise SettingsError(f"there are {len(inner)} inner knots; {len(times)} frames can tell of {most}")
    if inner.size and not (inner[0] > times[0] and inner[-1] < times[-1]):
        raise SettingsError(
            f"inner knots are from {inner[0]:g} to {inner[-1]:g} s; "
            f"they must be between {times[0]:g} and {times[-1]:g} s"
        )
    ends = np.concatenate([[times[0]] * 4, inner, [times[-1]] * 4])
    for number in range(
        len(inner) + 4
    ):  # Schoenberg and Whitney: every basis function needs a frame of its own
        if not ((times > ends[number]) & (times < ends[number + 4])).any() and 0 < number < len(inner) + 3:
            where = ends[number + 2]
            raise SettingsError(f"there are no frames to tell of the knots near {where:g} s; leave some out")
    return inner
