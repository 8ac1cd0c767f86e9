r"""Compression: the coarsest step that keeps an error, or fits into a size.

What is spoiled grows with the step, what is said shrinks; the step is found by secants on logarithms, because both are
nearly powers of it. With a bound on every vertex there is a choice: few corrections of an accurate basis, or many
of a coarse one; the cheapest of some steps is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mixseq.coding.attempt import Attempt, attempt
from mixseq.coding.coded import Coded, CodingParameters, FactorName
from mixseq.coding.corrections import width
from mixseq.coding.decode import to_model
from mixseq.coding.factors import Factors, factor
from mixseq.coding.graph import SignalGraph, mesh_graph
from mixseq.coding.joining import vertex_parts
from mixseq.coding.parts import Part, parts_of, whole
from mixseq.errors import ReconstructionError, SettingsError
from mixseq.progress import Progress, Stages, silent
from mixseq.sequence import Frames, bounding_diagonal, check_frames
from mixseq.stored import Stored, blocks_of, stored
from mixseq.threads import one_blas_thread

Float = NDArray[np.float64]

ROUNDS = 8
"""Steps that are tried at most."""

CLOSE = 0.01
"""An error, or a size, may be below what was asked for by this share."""

SLOPE = 0.6
"""About the power of the error with which sizes fall."""

RATIO = 0.3
"""Error with which the search for a bound begins: root mean square, relative to the bound."""

FACTOR = 1.5
"""Ratio of the steps that are tried for a bound."""

SHAPES = 2.0
"""Shapes are tried unless they have so many more bits, unpredicted: they are predicted better, but not that much."""

NEARLY = 1.15
"""Where sizes of both kinds of factors are so near, both are tried with several steps."""

PARTS = (3, 6, 12)
"""So many parts are tried, one number after the other, as long as bytes become fewer."""

FACTORS: tuple[FactorName, ...] = ("trajectories", "shapes")


def compress(
    sequence: Frames,
    max_error: float | None = None,
    kg: float | None = None,
    size: int | None = None,
    progress: Progress = silent,
) -> Coded:
    """Compress a sequence.

    Parameters
    ----------
    sequence : MeshSequence or SequenceReader
        The animation.
    max_error : float, optional
        Largest distance of a vertex from the original at any frame, as a fraction of the bounding box's diagonal in
        the first frame: a promise.
    kg : float, optional
        KG error in percent: root mean square distance, relative to that of the vertices from their centroid.
    size : int, optional
        Number of bytes of the signals.
    progress : callable, optional
        Told about every stage.

    Returns
    -------
    Coded
        `mixseq.save` writes it, `mixseq.load` makes a model of it.

    Raises
    ------
    SettingsError
        If not exactly one of `max_error`, `kg` and `size` is given, or it is out of range, or `size` cannot be reached.
    """
    check_frames(sequence)
    _check(max_error, kg, size)
    stages = Stages(progress, 2 + ROUNDS, sequence.header.frame_count)
    with one_blas_thread():
        frames = stored(sequence, stages.at(0))
        unit = bounding_diagonal(frames.points[:1][0]) or 1.0
        search = _Search(frames, mesh_graph(sequence.header.faces, sequence.header.vertex_count), stages)
        if max_error is not None:
            best = search.within(_with_margin(max_error * unit, frames))
        elif kg is not None:
            best = search.with_error(kg / 100 * _spread(frames))
        else:
            best = search.with_size(int(size or 0))
        stages.at(1 + ROUNDS)(0, 1, "checking")
        return _checked(frames, best, unit, max_error)


def _check(max_error: float | None, kg: float | None, size: int | None) -> None:
    given = {"max_error": max_error, "kg": kg, "size": size}
    values = {name: value for name, value in given.items() if value is not None}
    if len(values) != 1:
        raise SettingsError(
            f"{' and '.join(values) or 'nothing'} is given; give one of max_error, kg and size"
        )
    [(name, value)] = values.items()
    least = 1 if name == "size" else 0
    if not (np.isfinite(value) and value > 0 and value >= least):
        raise SettingsError(f"{name} is {value}; a positive number{' of bytes' * least} is expected")


def _with_margin(bound: float, sequence: Stored) -> float:
    """Leave room for the last digits, which are not the same on every machine, and for files of single precision."""
    largest = max(float(np.abs(block).max(initial=0.0)) for block in blocks_of(sequence.points))
    last = largest * 2.0**-40
    if bound < last:
        raise SettingsError(
            f"max_error is {bound:.3g} in units of the sequence, beyond the digits of coordinates of up to "
            f"{largest:.3g}; give at least {last:.3g} of these units, or move the sequence to the origin"
        )
    single = sequence.points.dtype == np.float32
    rounding = largest * 2.0**-24 * 3**0.5 if single else last
    return bound - min(1e-9 * bound + rounding, bound / 2)


def _spread(sequence: Stored) -> float:
    """Root of the sum of all squared distances from the centroids of the frames."""
    squares = largest = 0.0
    for block in blocks_of(sequence.points):
        points = block.astype(np.float64)
        squares += float(np.square(points - points.mean(axis=1, keepdims=True)).sum())
        largest = max(largest, float(np.abs(points).max()))
    if squares <= np.prod(sequence.points.shape) * (2.0**-40 * largest) ** 2:
        raise SettingsError("all vertices are at one place, and have no KG error; give max_error")
    return float(np.sqrt(squares))


@dataclass(frozen=True, eq=False)
class _Tried:
    """Factors of the parts of a sequence, all of one kind, and the first attempt with them."""

    factors: tuple[Factors, ...]
    parts: tuple[Part, ...]
    last: Attempt


class _Search:
    """Attempts with several steps."""

    def __init__(self, sequence: Stored, graph: SignalGraph, stages: Stages) -> None:
        self._sequence = sequence
        self._graph = graph
        self._stages = stages
        self._count = len(sequence.points) * sequence.points.shape[1]
        self._rounds = 0

    def _try(self, tried: _Tried, step: float, bound: float | None = None, dry: bool = False) -> Attempt:
        return self._attempt(tried.factors, tried.parts, step, bound, dry)

    def _attempt(
        self,
        factors: tuple[Factors, ...],
        parts: tuple[Part, ...],
        step: float,
        bound: float | None,
        dry: bool = False,
    ) -> Attempt:
        self._stages.at(1 + min(self._rounds, ROUNDS - 1))(0, 1, "choosing the step")
        self._rounds += 1
        return attempt(self._sequence, factors, step, parts, self._graph, bound, dry)

    def _first(self, error: float, bound: float | None = None) -> list[_Tried]:
        """Try factors of both kinds, and of several parts, with steps that should make an error.

        Returns
        -------
        list of _Tried
            Those that may be the best.
        """
        tried: list[_Tried] = []
        bits = np.inf
        for name in FACTORS:
            factors = (factor(self._sequence, name, _least(self._sequence, name, error)),)
            step = _guess(factors, error)
            if _bits(factors[0], step) < SHAPES * bits:
                parts = whole(self._graph)
                tried.append(_Tried(factors, parts, self._attempt(factors, parts, step, bound)))
            bits = _bits(factors[0], step)

        def size(one: _Tried) -> float:
            # With corrections errors are the same, without them sizes are as they would be if errors were.
            return one.last.size * (1.0 if bound else (one.last.error / error) ** SLOPE)

        best = min(map(size, tried))
        for several in self._several(error, bound):
            tried.append(several)
            if size(several) > best:
                break
            best = size(several)
        return [one for one in tried if size(one) <= NEARLY * best]

    def _several(self, error: float, bound: float | None) -> Iterator[_Tried]:
        """Try more and more parts, each with trajectories of its own."""
        for labels in vertex_parts(self._sequence, PARTS).values():
            parts = parts_of(labels, self._sequence.header.faces)
            least = _least(self._sequence, "trajectories", error)
            factors = tuple(factor(self._sequence, "trajectories", least, part.vertices) for part in parts)
            yield _Tried(factors, parts, self._attempt(factors, parts, _guess(factors, error), bound))

    def with_error(self, error: float) -> Attempt:
        """Find the coarsest step whose error is below a given one (root of the sum of squares)."""
        found: list[Attempt] = []
        for tried in self._first(error):
            attempt_with, room = (
                partial(self._try, tried, dry=True),
                lambda one: error / max(one.error, 1e-9 * error),
            )
            best = _closest(attempt_with, room, tried.last, 1.0)
            if best is not None:
                found.append(best if best is tried.last else self._try(tried, best.step))
        if not found:  # frames were left out of the factors: corrections make good for them
            return self.within(error / self._count**0.5)
        return min(found, key=lambda one: one.size)

    def with_size(self, size: int) -> Attempt:
        """Find the finest step that fits into a number of bytes."""
        found: list[Attempt] = []
        for tried in self._first(0.002 * _spread(self._sequence)):
            attempt_with, room = partial(self._try, tried), lambda one: size / one.size
            best = _closest(attempt_with, room, tried.last, -SLOPE)
            if best is not None:
                found.append(best)
        if not found:
            raise SettingsError(f"the signals do not fit into {size} bytes; give more")
        return min(found, key=lambda one: one.error)

    def within(self, bound: float) -> Attempt:
        """Find the cheapest of some steps with corrections that keep a bound, in the units of the sequence."""
        tried = min(self._first(RATIO * bound * self._count**0.5, bound), key=lambda one: one.last.size)
        best = tried.last
        for direction in (FACTOR, 1 / FACTOR):
            found = False
            while self._rounds < ROUNDS + len(PARTS):
                other = self._try(tried, best.step * direction, bound)
                if other.size >= best.size:
                    break
                best, found = other, True
            if found:
                break
        return best


def _closest(
    attempt_with: Callable[[float], Attempt], room: Callable[[Attempt], float], first: Attempt, slope: float
) -> Attempt | None:
    """Return the attempt with least room that is not below one, after some secants."""
    best, last, before = None, first, None
    for number in range(ROUNDS):
        left = room(last)
        if left >= 1 and (best is None or left < room(best)):
            best = last
        if number == ROUNDS - 1 or 1 <= left < 1 + CLOSE:
            break
        if before is not None and last.step != before.step and room(before) != left:
            measured = np.log(room(before) / left) / np.log(last.step / before.step)
            if 0.2 * abs(slope) < measured * np.sign(slope) < 5 * abs(slope):
                slope = float(measured)
        aim = left / (1 + CLOSE / 3)
        before, last = last, attempt_with(last.step * float(np.clip(aim ** (1 / slope), 0.05, 20.0)))
    return best


def _least(sequence: Stored, name: FactorName, error: float) -> float:
    """Norm of fields that are not worth looking at, if all of them together shall make an error."""
    rows = 3 if name == "trajectories" else 1
    return 0.1 * error / float(np.sqrt(rows * len(sequence.points)))


def _guess(factors: Sequence[Factors], error: float) -> float:
    """Return the step whose error is about a given one: s^2 / 12 for every number above it, all of those below."""
    counts = np.repeat(
        [one.fields.shape[1] * one.fields.shape[2] for one in factors], [len(one.sizes) for one in factors]
    )
    squares = np.square(np.concatenate([one.sizes for one in factors]))
    low, high = 1e-12 * error, error
    for _ in range(60):
        step = float(np.sqrt(low * high))
        expected = np.minimum(squares, counts * step**2 / 12).sum()
        low, high = (step, high) if expected < error**2 else (low, step)
    return low


def _bits(factors: Factors, step: float) -> float:
    """Return how many bits fields would cost if nothing were known of them but their norms."""
    count = factors.fields.shape[1] * factors.fields.shape[2]
    return float(count * np.log2(np.maximum(factors.sizes / (step * count**0.5), 1.0)).sum())


def _checked(sequence: Stored, best: Attempt, unit: float, bound: float | None) -> Coded:
    """Decode what was coded, and make sure of its errors: nothing is promised that was not seen."""
    coded = Coded(
        sequence.header,
        CodingParameters(
            factors=best.basis.name,
            rank=sum(best.ranks),
            frame_count=len(sequence.points),
            step=best.step,
            diagonal=unit,
            max_error=0.0,
            kg_percent=0.0,
            promised=bound is not None,
            correction=0.0 if best.bound is None else width(best.bound),
            ranks=best.ranks if len(best.ranks) > 1 else (),
        ),
        best.fields,
        best.chunks,
    )
    model = to_model(coded)
    squares = spread = largest = 0.0
    done = 0
    for block in model.blocks(model.times):
        points = sequence.points[done : done + len(block)].astype(np.float64)
        distances = np.square(points - block).sum(axis=2)
        squares, largest = squares + float(distances.sum()), max(largest, float(distances.max()))
        spread += float(np.square(points - points.mean(axis=1, keepdims=True)).sum())
        done += len(block)
    error = float(np.sqrt(largest)) / unit
    if bound is not None and error > bound:
        raise ReconstructionError(
            f"a vertex is off by {error:.3g} diagonals after decoding, more than {bound:g}; please report this"
        )
    rounding = sequence.points.shape[1] * done * (1e-12 * unit) ** 2
    kg_percent = 100 * float(np.sqrt(squares / spread)) if spread > rounding else 0.0
    parameters = replace(coded.parameters, max_error=error if bound is None else bound, kg_percent=kg_percent)
    return replace(coded, parameters=parameters)
