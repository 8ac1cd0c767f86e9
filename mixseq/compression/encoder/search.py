"""Find the quantisation step, the kind of basis and the parts with the fewest bytes.

The error grows with the step, the number of bytes shrinks; the step is found by secants on logarithms, because both are
nearly powers of it. A bound on every vertex trades few residuals of an accurate basis for many of a coarse one; the
cheapest of some steps is taken.

At the first step several numbers of parts are tried, and both kinds of basis unless the norms of the components exclude
one. Every part has coefficients of its own, so that long sequences of few vertices are one part. Every trial corrects
the guess of the step, from which the next one begins.

On large meshes candidates are compared on a coarse one. Its vertices are those coded first, its edges those that close
the holes of the others (`mixseq.compression.bitstream.signal_graph`): its streams resemble the first ones of the whole
mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.signal_graph import (
    MOST,
    SignalGraph,
    coarser_levels,
    mesh_graph,
    mesh_neighbours,
)
from mixseq.compression.bitstream.spatial_basis import BasisKind
from mixseq.compression.encoder.components import PrincipalComponents, shapes, trajectories
from mixseq.compression.encoder.parts import refined, vertex_parts
from mixseq.compression.encoder.trial import Candidate, Trial, squared_error, try_step, with_residuals
from mixseq.errors import SettingsError
from mixseq.runtime.progress import StagedProgress
from mixseq.sequence.sequence import FrameStore, largest_coordinate, rounding_error
from mixseq.types import Index


def coarse_mesh(faces: NDArray[np.integer], vertex_count: int, most: int) -> tuple[Index, Index]:
    """Remove vertices until at most `most` are left: faces ``(F, 3)``; result ``(n,)``, ``(E, 3)``."""
    starts, beside = mesh_neighbours(faces, vertex_count)
    left = np.ones(vertex_count, dtype=bool)
    scratch = np.zeros((vertex_count, MOST), dtype=np.int64), np.zeros(vertex_count, dtype=np.int64)
    for level in coarser_levels(starts, beside, *scratch):
        left[level.gone] = False
        starts, beside = level.new_starts, level.new_beside
        if np.count_nonzero(left) <= most:
            break
    edges = np.stack([np.repeat(np.arange(vertex_count), np.diff(starts)), beside], axis=1)
    vertices = np.flatnonzero(left)
    edges = np.searchsorted(vertices, edges[edges[:, 0] < edges[:, 1]])
    return vertices, edges[:, [0, 1, 1]]


SHAPES = 1.65
"""Ratio of unpredicted bits up to which shapes are tried against trajectories, as they are predicted better."""

PARTS = (3, 6, 12)
"""Numbers of parts that are tried."""

NODES, LARGE = 8000, 1.5
"""Vertices of the coarse mesh for comparing candidates, used if the mesh has more than `LARGE` times as many."""

KINDS: tuple[BasisKind, ...] = ("trajectories", "shapes")

Way = tuple[BasisKind, int]
"""Kind of basis, and number of parts."""


class Ways:
    """Candidates on a coarse mesh and on the whole one."""

    def __init__(
        self,
        sequence: FrameStore,
        graph: SignalGraph,
        components: PrincipalComponents,
        least: float,
        error: float,
    ) -> None:
        faces, one_part = sequence.header.faces, np.zeros(graph.size, dtype=np.int64)
        self._components, self._least, self._error = components, least, error
        self._mesh = _Mesh(np.arange(graph.size), faces, graph, 1.0)
        self._coarse_mesh = self._mesh
        if graph.size > LARGE * NODES:
            vertices, coarse_faces = coarse_mesh(faces, graph.size, NODES)
            coarse_graph = mesh_graph(coarse_faces, len(vertices))
            self._coarse_mesh = _Mesh(vertices, coarse_faces, coarse_graph, len(vertices) / graph.size)
        self._labels = {1: one_part}
        if "trajectories" in KINDS:
            self._labels |= vertex_parts(sequence, PARTS)
        self._one = self._candidate(components, one_part, self._mesh)
        self._step = step_of(self._one, error)

    @property
    def numbers(self) -> list[int]:
        """Numbers of parts, increasing."""
        return list(self._labels)

    @cached_property
    def _shapes(self) -> PrincipalComponents:
        return shapes(self._components, 3**0.5 * self._least)

    def shapes_may_pay(self) -> bool:
        """Return whether shapes are not clearly worse than trajectories."""
        other = self._candidate(self._shapes, self._labels[1], self._mesh)
        return _bits(other, step_of(other, self._error)) < SHAPES * _bits(self._one, self._step)

    def coarse(self, way: Way) -> Candidate:
        """Return a candidate on the coarse mesh."""
        return self._on(self._coarse_mesh, way)

    def whole(self, way: Way) -> Candidate:
        """Return a candidate on the whole mesh."""
        return self._on(self._mesh, way)

    def _on(self, mesh: _Mesh, way: Way) -> Candidate:
        kind, number = way
        components = self._components if kind == "trajectories" else self._shapes
        components, labels = _at(components, mesh.vertices), self._labels[number][mesh.vertices]
        if number > 1:
            labels = refined(components, labels, mesh.faces, self._step)
        return self._candidate(components, labels, mesh)

    def _candidate(self, components: PrincipalComponents, labels: Index, mesh: _Mesh) -> Candidate:
        least = self._least * mesh.share**0.5
        return Candidate.of(components, labels, mesh.faces, mesh.graph, least, mesh.share)


class _Mesh(NamedTuple):
    """Some vertices ``(n,)`` of a mesh, triangles of these, their graph, and their share of all vertices."""

    vertices: Index
    faces: NDArray[np.integer]
    graph: SignalGraph
    share: float


def _at(components: PrincipalComponents, vertices: Index) -> PrincipalComponents:
    """Return components ``(K, c, V)`` at some vertices."""
    if len(vertices) == components.vectors.shape[2]:
        return components
    mean = components.mean if components.kind == "trajectories" else components.mean[:, vertices]
    return replace(components, mean=mean, vectors=components.vectors[..., vertices])


def expected_error(candidate: Candidate, step: float) -> float:
    """Return the root of the expected squared error: s^2 / 12 per number of a vector, or all of it if that is less."""
    squares, rows = 0.0, candidate.components.curves[0].size
    for part in candidate.parts:
        numbers = part.width / candidate.share + rows
        squares += float(np.minimum(np.square(part.norms) / candidate.share, numbers * step**2 / 12).sum())
    return float(np.sqrt(squares))


def step_of(candidate: Candidate, error: float) -> float:
    """Return the step with a given expected error."""
    low, high = 1e-12 * error, error
    for _ in range(60):
        step = float(np.sqrt(low * high))
        low, high = (step, high) if expected_error(candidate, step) < error else (low, step)
    return low


def _bits(candidate: Candidate, step: float) -> float:
    """Return the bits of one part if only the norms of its components are known."""
    [part] = candidate.parts
    return float(part.width * np.log2(np.maximum(part.norms / (step * part.width**0.5), 1.0)).sum())


ROUNDS = 6
"""Largest number of steps that are tried."""

CLOSE = 0.01
"""Share by which an error, or a size, may stay below the target."""

SLOPE = 0.4
"""Approximate power of the error with which sizes fall."""

FIRST = 0.002
"""Initial error of the search for a size, relative to the deviation."""

RATIO = 0.42
"""Initial error of the search for a bound: root mean square, relative to the bound."""

RESTARTS, FAR, FARTHEST = 3, 3.0, 100.0
"""Limits of new comparisons for a size: their number, the ratio of errors that causes one, the largest ratio."""

FACTOR = 1.5
"""Ratio of the steps that are tried for a bound."""

NEARLY = 1.02
"""Ratio of sizes at the first step up to which the best two candidates are tried with several steps."""

START = 6
"""Number of parts tried first; more or fewer are tried while bytes decrease."""

LONG = 0.75
"""Ratio of the bytes of coefficients to basis, of `START` parts, above which one part is tried next. Of 23 sequences
those above had the fewest bytes with one part, the others, below 0.61, with several or nearly so.
"""

GUESS = 0.9
"""Error of the first step, relative to its expected error."""

UNSEEN = 1e-5
"""Relative distance from the target below which errors are measured on frames, as algebra lacks the digits."""

TINY = 1e-9
"""Share of the target to which smaller errors are clamped."""


class Search:
    """Trials with several steps."""

    def __init__(self, sequence: FrameStore, graph: SignalGraph, stages: StagedProgress, chunk: int) -> None:
        self._sequence = sequence
        self._graph = graph
        self._stages = stages
        self._chunk = chunk
        self._count = len(sequence.points) * sequence.points.shape[1]
        self._finest = rounding_error(largest_coordinate(sequence.points)) * sequence.points.shape[1] ** 0.5
        self._rounds = 0
        self._wrong = GUESS

    def _try(self, candidate: Candidate, step: float) -> Trial:
        self._stages.at(1 + min(self._rounds, ROUNDS - 1))(0, 1, "choosing the step")
        self._rounds += 1
        return try_step(self._sequence, candidate, max(step, self._finest), self._chunk)

    def _first_trials(self, error: float) -> list[Trial]:
        """Try candidates with steps of an expected error; return the possible best ones, best first."""
        least = 0.1 * error / float(np.sqrt(3 * len(self._sequence.points)))
        ways = Ways(self._sequence, self._graph, trajectories(self._sequence, least), least, error)
        found: list[tuple[float, Way, Trial]] = []

        @cache
        def tried(way: Way) -> float:
            candidate = ways.coarse(way)
            trial = self._try(candidate, step_of(candidate, error / self._wrong))
            self._wrong *= float(np.clip(trial.error / error, 0.5, 2.0))
            found.append((_size_at(trial, error), way, trial))
            return found[-1][0]

        if "trajectories" in KINDS:
            numbers: list[Way] = [("trajectories", number) for number in ways.numbers]
            start: Way = ("trajectories", START) if START in ways.numbers else numbers[-1]
            size = tried(start)
            first = found[0][2]
            if first.size - first.basis_size <= LONG * first.basis_size or tried(numbers[0]) >= size:
                _lowest(tried, numbers, start)
        if "shapes" in KINDS and (not found or ways.shapes_may_pay()):
            tried(("shapes", 1))
        found.sort(key=lambda each: each[0])
        return [
            trial
            if trial.candidate.share == 1
            else self._try(ways.whole(way), _next_step(trial.step, error / trial.error, _slope(trial)))
            for size, way, trial in found[:2]
            if size <= NEARLY * found[0][0]
        ]

    def with_error(self, error: float) -> Trial:
        """Find the coarsest step with an error below a given one (root of the sum of squares)."""
        best: Trial | None = None
        trials = self._first_trials(error)
        while trials and (best is None or best.size > _size_at(trials[0], error)):
            found = _closest(self._try, lambda one: error / max(one.error, TINY * error), trials.pop(0))
            if found is not None and (best is None or found.size < best.size):
                best = found
        for _ in range(ROUNDS):
            if best is None or best.error < (1 - UNSEEN) * error:
                break
            if squared_error(self._sequence, best.basis, best.coefficients) <= error**2:
                break
            best = self._try(best.candidate, (1 - CLOSE / 3) * best.step)
        if best is None:  # skipped frames have errors, which the residual layer corrects
            return self.within(error / self._count**0.5)
        return best

    def with_size(self, size: int, deviation: float) -> Trial:
        """Find the finest step that fits a number of bytes, starting from an error of 0.2 % of the deviation."""
        error = FIRST * deviation
        trials = self._first_trials(error)
        for _ in range(RESTARTS):
            aim = trials[0].error * (trials[0].size / size) ** (1 / SLOPE)
            if FAR * aim > error > aim / FAR:
                break
            error *= float(np.clip(aim / error, 1 / FARTHEST, FARTHEST))
            trials = self._first_trials(error)
        found: list[Trial] = []
        while trials:
            best = _closest(self._try, lambda one: size / one.size, trials.pop(0), -SLOPE)
            if best is not None:
                found.append(best)
        if not found:
            raise SettingsError(f"the signals do not fit into {size} bytes; give more")
        return min(found, key=lambda one: one.error)

    def within(self, bound: float) -> Trial:
        """Find the cheapest of some steps whose residual layer keeps a bound, in the units of the sequence."""
        first = self._first_trials(RATIO * bound * self._count**0.5)[0]
        best = with_residuals(self._sequence, first, bound)
        power = SLOPE * _slope(first)
        for factor in (FACTOR, 1 / FACTOR):
            start = best
            # A finer step does not pay if the signals alone would be larger.
            while self._rounds < 2 * ROUNDS and best.signals * factor**-power < best.size:
                other = with_residuals(self._sequence, self._try(best.candidate, best.step * factor), bound)
                power = abs(float(np.log(other.signals / best.signals))) / float(np.log(FACTOR))
                if other.size >= best.size:
                    break
                best = other
            if best is not start:
                break
        return best


def _lowest(value: Callable[[Way], float], numbers: list[Way], start: Way) -> None:
    """Evaluate values from `start` to the right, or else to the left, while they fall."""
    first = place = numbers.index(start)
    value(numbers[place])
    for direction in (1, -1):
        while 0 <= place + direction < len(numbers) and value(numbers[place + direction]) < value(
            numbers[place]
        ):
            place += direction
        if place != first:
            break


def _next_step(step: float, room: float, slope: float) -> float:
    """Return the step that should use up the room, which is about the power -`slope` of steps."""
    return step * float(np.clip((room / (1 + CLOSE / 3)) ** (1 / slope), 0.05, 20.0))


def _closest(
    try_with: Callable[[Candidate, float], Trial],
    room: Callable[[Trial], float],
    last: Trial,
    power: float = 1.0,
) -> Trial | None:
    """Return the trial with least room of at least one, by secants; room falls as a power of the error."""
    slope, candidate = power * _slope(last), last.candidate
    best: Trial | None = None
    before: tuple[float, float] | None = None  # step and room
    for number in range(ROUNDS):
        left, step = room(last), last.step
        if left >= 1 and (best is None or left < room(best)):
            best = last
        if number == ROUNDS - 1 or 1 <= left < 1 + CLOSE:
            break
        if before is not None and step != before[0] and left != before[1]:
            measured = np.log(before[1] / left) / np.log(step / before[0])
            if 0.2 * abs(slope) < measured * np.sign(slope) < 5 * abs(slope):
                slope = float(measured)
        before = step, left
        del last
        last = try_with(candidate, _next_step(step, left, slope))
        if last.step == step:  # there is no finer one
            break
    return best


def _size_at(trial: Trial, error: float) -> float:
    """Return the approximate number of bytes of a trial at an error."""
    return float(trial.size * (max(trial.error, TINY * error) / error) ** SLOPE)


def _slope(trial: Trial) -> float:
    """Return the approximate power of the step with which the error grows."""
    finer, coarser = (expected_error(trial.candidate, trial.step * factor) for factor in (0.9, 1.1))
    return float(max(np.log(coarser / finer) / np.log(1.1 / 0.9), 0.1)) if finer > 0 else 1.0
