"""Find the quantisation step, the kind of basis and the parts with the fewest bytes.

The error grows with the step, the number of bytes shrinks; the step is found by secants on logarithms, because both are
nearly powers of it. A bound on every vertex trades few residuals of an accurate basis for many of a coarse one; the
cheapest of some steps is taken.

At the first step several numbers of parts are tried, and both kinds of basis unless the norms of the components exclude
one, on the coarse vertices of large meshes. Every part has coefficients of its own, so that long sequences of few
vertices are one part. Every trial corrects the guess of the step, from which the next one begins.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from mixseq.coding.bitstream.signal_graph import SignalGraph
from mixseq.coding.encoder import candidates
from mixseq.coding.encoder.candidates import Way, Ways, expected_error, step_of
from mixseq.coding.encoder.principal_components import trajectories
from mixseq.coding.encoder.residuals import with_residuals
from mixseq.coding.encoder.trial import Candidate, Trial, squared_error, try_step
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore, digits_end, largest_coordinate
from mixseq.progress import Stages

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

    def __init__(self, sequence: FrameStore, graph: SignalGraph, stages: Stages, chunk: int) -> None:
        self._sequence = sequence
        self._graph = graph
        self._stages = stages
        self._chunk = chunk
        self._count = len(sequence.points) * sequence.points.shape[1]
        self._finest = digits_end(largest_coordinate(sequence.points)) * sequence.points.shape[1] ** 0.5
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

        if "trajectories" in candidates.KINDS:
            numbers: list[Way] = [("trajectories", number) for number in ways.numbers]
            start: Way = ("trajectories", START) if START in ways.numbers else numbers[-1]
            size = tried(start)
            first = found[0][2]
            if first.size - first.basis_size <= LONG * first.basis_size or tried(numbers[0]) >= size:
                _lowest(tried, numbers, start)
        if "shapes" in candidates.KINDS and (not found or ways.shapes_may_pay()):
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
