"""Find the quantisation step, the kind of basis and the parts with the fewest bytes.

A larger step gives a larger error and fewer bytes. Error and bytes are nearly powers of the step, so the step is found
by the secant method on logarithms. If every vertex has a bound, a coarse basis takes few bytes but needs many
residuals, so several steps are tried and the cheapest is used.

With the first step, several numbers of parts are tried, and both kinds of basis unless the norms of the components rule
out shapes. Every part has separate coefficients, which favours one part for long sequences of few vertices.
The ratio of actual to expected error of a trial corrects the first step of the next trial.

Candidates of large meshes are compared on a coarse mesh. It has the vertices that are coded first, and the edges that
close the holes of removed vertices (`mixseq.compression.bitstream.signal_graph`). So its signals resemble the first
values of the signals over the whole mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.signal_graph import (
    SignalGraph,
    coarser_levels,
    mesh_graph,
    mesh_neighbours,
    new_neighbours,
)
from mixseq.compression.bitstream.spatial_basis import BasisKind
from mixseq.compression.encoder.components import (
    PrincipalComponents,
    initial_parts,
    refine_parts,
    shape_components,
    trajectory_components,
)
from mixseq.compression.encoder.trial import Candidate, Trial, add_residuals, squared_error, try_step
from mixseq.errors import SizeError
from mixseq.runtime.low_memory import return_freed_memory
from mixseq.runtime.progress import StagedProgress
from mixseq.sequence.sequence import FrameStore, largest_coordinate, rounding_error
from mixseq.types import Index


def coarsen_mesh(faces: NDArray[np.integer], vertex_count: int, max_vertices: int) -> tuple[Index, Index]:
    """Remove levels of vertices of a mesh ``(F, 3)``; return the vertices ``(n,)`` and edges ``(E, 3)`` that remain."""
    starts, adjacent = mesh_neighbours(faces, vertex_count)
    remaining_mask = np.ones(vertex_count, dtype=bool)
    for level in coarser_levels(starts, adjacent, *new_neighbours(vertex_count)):
        remaining_mask[level.removed] = False
        starts, adjacent = level.new_starts, level.new_adjacent
        if np.count_nonzero(remaining_mask) <= max_vertices:
            break
    edges = np.stack([np.repeat(np.arange(vertex_count), np.diff(starts)), adjacent], axis=1)
    vertices = np.flatnonzero(remaining_mask)
    edges = np.searchsorted(vertices, edges[edges[:, 0] < edges[:, 1]])
    return vertices, edges[:, [0, 1, 1]]


MAX_SHAPES_BIT_RATIO = 1.65  # ratio of bits before prediction, shapes to trajectories, up to which shapes are tried
PART_COUNTS = (3, 6, 12)  # numbers of parts that are tried
COARSE_VERTICES, LARGE_MESH_RATIO = 8000, 1.5  # vertices of the coarse mesh, and multiple above which it is used

BASIS_KINDS: tuple[BasisKind, ...] = ("trajectories", "shapes")

Layout = tuple[BasisKind, int]
"""Kind of basis, and number of parts."""


class TrialMesh(NamedTuple):
    """The whole or the coarse mesh: its vertices ``(n,)``, triangles, graph, and share of all vertices."""

    vertices: Index
    faces: NDArray[np.integer]
    graph: SignalGraph
    share: float


class Candidates:
    """Candidates for coding a sequence with an expected error; components with norms below `min_norm` are dropped."""

    def __init__(
        self,
        faces: NDArray[np.integer],
        graph: SignalGraph,
        labels: dict[int, Index],
        components: PrincipalComponents,
        min_norm: float,
        error: float,
    ) -> None:
        self._components, self._min_norm, self._error = components, min_norm, error
        self.whole_mesh = self.coarse_mesh = TrialMesh(np.arange(graph.size), faces, graph, 1.0)
        if graph.size > LARGE_MESH_RATIO * COARSE_VERTICES:
            vertices, edges = coarsen_mesh(faces, graph.size, COARSE_VERTICES)
            share = len(vertices) / graph.size
            self.coarse_mesh = TrialMesh(vertices, edges, mesh_graph(edges, len(vertices)), share)
        self._labels = {1: np.zeros(graph.size, dtype=np.int64)} | labels
        self.part_counts = list(self._labels)  # increasing
        self._one_part = self._candidate(components, self._labels[1], self.whole_mesh)
        self._step = step_for_error(self._one_part, error)

    @cached_property
    def _shapes(self) -> PrincipalComponents:
        return shape_components(self._components, 3**0.5 * self._min_norm)

    def are_shapes_competitive(self) -> bool:
        """Return whether shapes may take fewer bytes than trajectories, judged by the norms of the components."""
        shapes = self._candidate(self._shapes, self._labels[1], self.whole_mesh)
        bits = _unpredicted_bits(shapes, step_for_error(shapes, self._error))
        if bits < MAX_SHAPES_BIT_RATIO * _unpredicted_bits(self._one_part, self._step):
            return True
        del self._shapes  # three times as large as trajectories
        return False

    def on_mesh(self, mesh: TrialMesh, layout: Layout) -> Candidate:
        """Return the candidate with a kind of basis and number of parts, on the coarse or the whole mesh."""
        kind, part_count = layout
        components = self._components if kind == "trajectories" else self._shapes
        components, labels = _restrict(components, mesh.vertices), self._labels[part_count][mesh.vertices]
        if part_count > 1:
            labels = refine_parts(components, labels, mesh.faces, self._step)
        return self._candidate(components, labels, mesh)

    def _candidate(self, components: PrincipalComponents, labels: Index, mesh: TrialMesh) -> Candidate:
        min_norm = self._min_norm * mesh.share**0.5
        return Candidate.from_labels(components, labels, mesh.faces, mesh.graph, min_norm, mesh.share)


def _restrict(components: PrincipalComponents, vertices: Index) -> PrincipalComponents:
    """Restrict components ``(K, c, V)`` to the vertices ``(n,)``."""
    if len(vertices) == components.vectors.shape[2]:
        return components
    mean = components.mean if components.kind == "trajectories" else components.mean[:, vertices]
    return replace(components, mean=mean, vectors=components.vectors[..., vertices])


def expected_error(candidate: Candidate, step: float) -> float:
    """Return the root of the expected squared error: a vector adds step^2 / 12 per number, at most its squared norm."""
    squares, curve_size = 0.0, candidate.components.curves[0].size
    for part in candidate.parts:
        number_count = part.width / candidate.share + curve_size
        rounding = number_count * step**2 / 12
        squares += float(np.minimum(np.square(part.norms) / candidate.share, rounding).sum())
    return float(np.sqrt(squares))


def step_for_error(candidate: Candidate, error: float) -> float:
    """Find the step with a given expected error by bisection."""
    low, high = 1e-12 * error, error
    for _ in range(60):
        step = float(np.sqrt(low * high))
        low, high = (step, high) if expected_error(candidate, step) < error else (low, step)
    return low


def _unpredicted_bits(candidate: Candidate, step: float) -> float:
    """Estimate the bits of a one-part candidate before prediction, from the norms of its components."""
    [part] = candidate.parts
    return float(part.width * np.log2(np.maximum(part.norms / (step * part.width**0.5), 1.0)).sum())


MAX_ROUNDS = 6  # largest number of steps that are tried
TARGET_TOLERANCE = 0.01  # largest relative amount by which an error, or a size, may stay below the target

STEP_TOLERANCE = 1e-3
"""Relative distance of steps, one that meets the target and one that does not, at which the search ends."""

SIZE_EXPONENT = 0.4  # approximate exponent e of the sizes: size is proportional to error^-e
INITIAL_ERROR = 0.002  # initial error of the search for a size, relative to the deviation of vertices from centroids
INITIAL_RMS_ERROR = 0.42  # initial root mean square error of the search for a bound, relative to the bound
MAX_ERROR = 0.2  # largest error at which candidates are compared in the search for a size, relative to that deviation

MAX_RESTARTS, RESTART_RATIO, MAX_RESTART_RATIO = 4, 3.0, 100.0
"""Restarts of the search for a size: largest number, smallest ratio of errors for one, largest change of the error."""

STEP_FACTOR = 1.5  # ratio of successive steps that are tried for a bound

RUNNER_UP_RATIO, SIZE_RUNNER_UP_RATIO = 1.02, 1.1
"""Ratio of the two smallest sizes at the first step up to which both candidates are tried with further steps.

The second is for a size, of which the error must not grow with it.
"""

INITIAL_PART_COUNT = 6  # number of parts tried first; more or fewer are tried while bytes decrease

MAX_COEFFICIENT_RATIO = 0.75
"""Ratio of coefficient bytes to basis bytes, with `INITIAL_PART_COUNT` parts, above which one part is tried next.
Of 23 sequences, one part was smallest above this ratio; several parts were smallest, or nearly, below 0.61.
"""

INITIAL_ERROR_RATIO = 0.9  # assumed ratio of actual to expected error in the first trial
ALGEBRAIC_PRECISION = 1e-5  # relative distance from the target below which errors are measured on frames: more accurate
MIN_RELATIVE_ERROR = 1e-9  # smallest error relative to the target; smaller errors are clamped to this value


class Search:
    """Search for the trial that meets a target with the fewest bytes."""

    def __init__(self, sequence: FrameStore, stages: StagedProgress, chunk: int) -> None:
        self._sequence, faces = sequence, sequence.header.faces
        self._labels = initial_parts(sequence, PART_COUNTS) if "trajectories" in BASIS_KINDS else {}
        self._graph = mesh_graph(faces, sequence.header.vertex_count)  # after parts, as both take much memory
        self._stages = stages
        self._chunk = chunk
        self._point_count = len(sequence.points) * sequence.points.shape[1]
        self._min_step = rounding_error(largest_coordinate(sequence.points)) * sequence.points.shape[1] ** 0.5
        self._rounds = 0
        self._tried = ""  # size of the last trial, for progress
        self._error_ratio = INITIAL_ERROR_RATIO  # actual to expected error

    def _try_step(self, candidate: Candidate, step: float) -> Trial:
        self._stages.at(1 + min(self._rounds, MAX_ROUNDS - 1))(0, 1, f"choosing the step{self._tried}")
        self._rounds += 1
        return_freed_memory()
        trial = try_step(self._sequence, candidate, max(step, self._min_step), self._chunk)
        self._tried = f", after {trial.size / 1000:,.3g} kB"
        return trial

    def _compare_candidates(self, error: float, runner_up_ratio: float = RUNNER_UP_RATIO) -> list[Trial]:
        """Try candidates, each with the step for an expected error; return one or two whole-mesh trials, best first."""
        min_norm = 0.1 * error / float(np.sqrt(3 * len(self._sequence.points)))
        components = trajectory_components(self._sequence, min_norm)
        faces = self._sequence.header.faces
        candidates = Candidates(faces, self._graph, self._labels, components, min_norm, error)
        tried: list[tuple[float, Layout, Trial]] = []

        @cache
        def size_of(layout: Layout) -> float:
            candidate = candidates.on_mesh(candidates.coarse_mesh, layout)
            trial = self._try_step(candidate, step_for_error(candidate, error / self._error_ratio))
            self._error_ratio *= float(np.clip(trial.error / error, 0.5, 2.0))
            tried.append((_size_at_error(trial, error), layout, trial))
            return tried[-1][0]

        if "trajectories" in BASIS_KINDS:
            layouts: list[Layout] = [("trajectories", count) for count in candidates.part_counts]
            first: Layout = ("trajectories", INITIAL_PART_COUNT)
            first = first if first in layouts else layouts[-1]
            size, trial = size_of(first), tried[0][2]
            coefficient_size = trial.size - trial.basis_size
            if coefficient_size <= MAX_COEFFICIENT_RATIO * trial.basis_size or size_of(layouts[0]) >= size:
                _descend(size_of, layouts, first)
        if "shapes" in BASIS_KINDS and (not tried or candidates.are_shapes_competitive()):
            size_of(("shapes", 1))
        tried.sort(key=lambda entry: entry[0])
        trials = []
        for size, layout, trial in tried[:2]:
            if size <= runner_up_ratio * tried[0][0]:
                if trial.candidate.share < 1:
                    step = _next_step(trial.step, error / trial.error, _error_exponent(trial))
                    trial = self._try_step(candidates.on_mesh(candidates.whole_mesh, layout), step)
                trials.append(trial)
        return trials

    def find_for_error(self, error: float) -> Trial:
        """Find the coarsest step whose error (root of the sum of squares) is at most `error`."""
        best: Trial | None = None
        trials, least = self._compare_candidates(error), MIN_RELATIVE_ERROR * error
        while trials and (best is None or best.size > _size_at_error(trials[0], error)):
            found = _find_step(self._try_step, lambda trial: error / max(trial.error, least), trials.pop(0))
            if found is not None and (best is None or found.size < best.size):
                best = found
        for _ in range(MAX_ROUNDS):
            if best is None or best.error < (1 - ALGEBRAIC_PRECISION) * error:
                break
            if squared_error(self._sequence, best.basis, best.coefficients) <= error**2:
                break
            best = self._try_step(best.candidate, (1 - TARGET_TOLERANCE / 3) * best.step)
        if best is None:  # no step removes the errors of skipped frames, the residual layer does
            return self.find_for_bound(error / self._point_count**0.5)
        return best

    def find_for_size(self, size: int, deviation: float) -> Trial:
        """Find the finest step whose signals fit into `size` bytes, beginning at `INITIAL_ERROR` * `deviation`."""
        error, best = INITIAL_ERROR * deviation, None
        known: list[tuple[float, float]] = []  # sizes and errors of trials
        for restart in range(MAX_RESTARTS + 1 if size > 0 else 0):
            trials = self._compare_candidates(error, SIZE_RUNNER_UP_RATIO)
            known.append((trials[0].size, trials[0].error))
            target = min(_error_at_size(size, known), MAX_ERROR * deviation)
            if restart == MAX_RESTARTS or _is_near(target, error):
                while trials:
                    found = _find_step(
                        self._try_step, lambda trial: size / trial.size, trials.pop(0), -SIZE_EXPONENT, 2 * MAX_ROUNDS
                    )
                    if found is not None and (best is None or found.error < best.error):
                        best = found
                if best is not None and _is_near(best.error, error):
                    break  # otherwise, candidates were compared at another error than that of the result
                target = MAX_ERROR * deviation if best is None else best.error
            error *= float(np.clip(target / error, 1 / MAX_RESTART_RATIO, MAX_RESTART_RATIO))
        if best is None or best.error >= deviation:
            raise SizeError("the size is too few bytes for any motion; give more")
        return best

    def find_for_bound(self, bound: float) -> Trial:
        """Find the step that takes the fewest bytes with a residual layer for a bound, in the units of the sequence."""
        first = self._compare_candidates(INITIAL_RMS_ERROR * bound * self._point_count**0.5)[0]
        best = add_residuals(self._sequence, first, bound)
        exponent = SIZE_EXPONENT * _error_exponent(first)
        del first  # its basis is as large as the sequence
        for factor in (STEP_FACTOR, 1 / STEP_FACTOR):
            start = best
            # The next step is skipped if its signals alone are expected to exceed the best size.
            while self._rounds < 2 * MAX_ROUNDS and best.signal_size * factor**-exponent < best.size:
                trial = self._try_step(best.candidate, best.step * factor)
                trial = add_residuals(self._sequence, trial, bound)
                size_ratio = trial.signal_size / best.signal_size
                exponent = abs(float(np.log(size_ratio))) / float(np.log(STEP_FACTOR))
                if trial.size >= best.size:
                    break
                best = trial
            if best is not start:
                break
        return best


def _descend(size_of: Callable[[Layout], float], layouts: list[Layout], start: Layout) -> None:
    """Try the layouts after `start`, or before it if the next layout is not smaller, while sizes decrease."""
    first = place = layouts.index(start)
    size_of(start)
    for direction in (1, -1):
        while 0 <= place + direction < len(layouts):
            if size_of(layouts[place + direction]) >= size_of(layouts[place]):
                break
            place += direction
        if place != first:
            break


def _error_at_size(size: float, known: Sequence[tuple[float, float]]) -> float:
    """Interpolate the error at a size from sizes and errors of trials, as powers; beyond them, by `SIZE_EXPONENT`."""
    larger = min((each for each in known if each[0] >= size), default=None)
    smaller = max((each for each in known if each[0] < size), default=None)
    if larger is None or smaller is None:
        nearest, error = larger or smaller or (size, 0.0)
        return float(error * (nearest / size) ** (1 / SIZE_EXPONENT))
    fraction = np.log(larger[0] / size) / np.log(larger[0] / smaller[0])
    return float(larger[1] * (smaller[1] / larger[1]) ** fraction)


def _is_near(error: float, other: float) -> bool:
    """Whether candidates that were compared at one error are those for another one."""
    return 1 / RESTART_RATIO < error / other < RESTART_RATIO


def _next_step(step: float, room: float, exponent: float) -> float:
    """Return the step at which room (target / actual) should be just above one: room ~ step^-exponent."""
    return step * float(np.clip((room / (1 + TARGET_TOLERANCE / 3)) ** (1 / exponent), 0.05, 20.0))


def _find_step(
    try_with: Callable[[Candidate, float], Trial],
    room_of: Callable[[Trial], float],
    trial: Trial,
    power: float = 1.0,
    rounds: int = MAX_ROUNDS,
) -> Trial | None:
    """Find the trial with the least room (target / actual >= 1) by the secant method: room ~ error^-power.

    The step stays between the last one that meets the target and the last one that does not.
    """
    exponent, candidate = power * _error_exponent(trial), trial.candidate
    best: Trial | None = None
    previous: tuple[float, float] | None = None  # step and room of the last trial
    ends: dict[bool, float] = {}  # last steps that meet the target, and that do not
    for number in range(rounds):
        room, step = room_of(trial), trial.step
        ends[room >= 1] = step
        if room >= 1 and (best is None or room < room_of(best)):
            best = trial
        if number == rounds - 1 or 1 <= room < 1 + TARGET_TOLERANCE:
            break
        if previous is not None and step != previous[0] and room != previous[1]:
            measured = np.log(previous[1] / room) / np.log(step / previous[0])
            if 0.2 * abs(exponent) < measured * np.sign(exponent) < 5 * abs(exponent):
                exponent = float(measured)
        previous = step, room
        del trial  # free its memory before the next trial
        next_step = _next_step(step, room, exponent)
        if len(ends) == 2:
            low, high = sorted(ends.values())
            if high / low < 1 + STEP_TOLERANCE:
                break
            next_step = next_step if low < next_step < high else (low * high) ** 0.5
        trial = try_with(candidate, next_step)
        if trial.step == step:  # the smallest step is reached
            break
    return best


def _size_at_error(trial: Trial, error: float) -> float:
    """Estimate the number of bytes that a trial would take at another error."""
    return float(trial.size * (max(trial.error, MIN_RELATIVE_ERROR * error) / error) ** SIZE_EXPONENT)


def _error_exponent(trial: Trial) -> float:
    """Estimate the exponent e of a trial's error: error is proportional to step^e."""
    finer, coarser = (expected_error(trial.candidate, trial.step * factor) for factor in (0.9, 1.1))
    return float(max(np.log(coarser / finer) / np.log(1.1 / 0.9), 0.1)) if finer > 0 else 1.0
