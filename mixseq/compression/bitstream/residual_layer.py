"""The residual layer: corrections of decoded frames that bring every vertex within a bound.

A residual is a displacement of a vertex at a frame, in whole units :math:`w` per coordinate; nearly all vertices have
none. Residuals are coded frame by frame, in contexts of adjacent vertices and of the frame before, as errors of
a truncated basis persist over frames. All values are integers.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/bounded.npz``,
``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import InitVar, dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.arithmetic import (
    BitModels,
    Coded,
    bit_length,
    bit_models,
    code,
    code_number,
)
from mixseq.compression.bitstream.signal_coder import Reader, Writer
from mixseq.compression.bitstream.signal_graph import NEIGHBOUR_COUNTS, SignalGraph, mesh_graph
from mixseq.errors import FormatError
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.parallel import two_thread_executor
from mixseq.types import Float, Index

INPUTS = 3
"""Contexts of a bit. Frozen: breaks old files."""

CONTEXTS = 3 * NEIGHBOUR_COUNTS * NEIGHBOUR_COUNTS
"""Number of contexts per input. Frozen: breaks old files."""

_LONGEST = 8
"""Largest number with models for all of its questions. Frozen: breaks old files."""

_MOST = 62
"""Largest bit length of the excess over that. Frozen: breaks old files."""

POSITIONS = 4 + _LONGEST
"""Modelled questions: any vertex displaced, this one, zero coordinate, sign, above 1, 2, ... Frozen: breaks files."""


@compiled
def code_residuals(
    coded: Coded,
    models: BitModels,
    neighbours: Index,
    counts: Index,
    ring: Index,
    starts: Index,
    last: Index,
    numbers: Index,
) -> None:
    """Write or read the numbers ``(N, 3)`` of a frame, in contexts of those of the frame before, `last`.

    A graph of N nodes has `neighbours` (N, n) before every node, ``counts`` (N,) of them, and all nodes adjacent to
    node i in ``ring[starts[i] : starts[i + 1]]``.
    """
    contexts = models.contexts
    displaced = 0
    for node in range(len(numbers)):
        displaced |= _any(numbers, node)
    contexts[:] = 0
    if not code(coded, models, 0, displaced):
        return
    sums = np.zeros(3, dtype=np.int64)
    for node in range(len(numbers)):
        votes, count = 0, counts[node]
        sums[:] = 0
        for i in range(count):
            beside = neighbours[node, i]
            votes += _any(numbers, beside)
            for k in range(3):
                sums[k] += min(max(numbers[beside, k], -1), 1)
        before = 0
        for place in range(starts[node], starts[node + 1]):
            before += _any(last, ring[place])
        own = _any(last, node)
        contexts[0] = (votes * NEIGHBOUR_COUNTS + count) * 3 + (2 * own if own else min(before, 1))
        contexts[1] = (min(before, NEIGHBOUR_COUNTS - 1) * NEIGHBOUR_COUNTS + min(votes, 3)) * 2 + own
        contexts[2] = min(votes, 3) * 3 + (2 * own if own else min(before, 1))
        if not code(coded, models, 1, _any(numbers, node)):
            for k in range(3):
                numbers[node, k] = 0
            continue
        others = 0
        for k in range(3):
            here, around = min(max(last[node, k], -3), 3) + 3, min(max(sums[k], -3), 3) + 3
            contexts[0] = here * 7 + around
            contexts[1] = (others * 7 + around) * 3 + k
            contexts[2] = (others * 7 + here) * 3 + k
            numbers[node, k] = _code_coordinate(coded, models, numbers[node, k])
            others |= (1 if numbers[node, k] else 0) << k


@force_inlined
def _any(numbers: Index, node: int) -> int:
    return 1 if numbers[node, 0] or numbers[node, 1] or numbers[node, 2] else 0


@force_inlined
def _code_coordinate(coded: Coded, models: BitModels, number: int) -> int:
    if not code(coded, models, 2, 1 if number else 0):
        return 0
    sign = code(coded, models, 3, 1 if number < 0 else 0)
    rest, found = abs(number) - 1, 0
    while found < _LONGEST and code(coded, models, 4 + found, 1 if rest > found else 0):
        found += 1
    if found == _LONGEST:
        beyond, length = max(rest - _LONGEST, 0), 0
        bits = bit_length(beyond)
        while length < _MOST and code_number(coded, 1, 1 if bits > length else 0):
            length += 1
        found += code_number(coded, length, beyond)
    return -(found + 1) if sign else found + 1


Residuals = tuple[Index, Index]
"""Vertices ``(n,)`` of a frame, and their displacements ``(n, 3)`` in units of the layer."""

RUN = 16
"""Frames coded together. Frozen: another number breaks old files."""

_KEPT = 8
"""Number of cached decoded runs. Free: not in files."""

_NOTHING: Residuals = np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class CodedResidualLayer(PickledWithoutCaches):
    """The residual layer of a compressed sequence, decoded on demand."""

    times: Float  # (T,) times of the frames in seconds; between them residuals are interpolated
    chunks: tuple[tuple[int, bytes], ...]  # number of frames of every chunk, and its stream
    faces: NDArray[np.int32]  # (F, 3) triangles of the mesh
    vertex_count: int  # number V of vertices
    unit: float  # length of the unit w, in the units of the sequence
    known: InitVar[SignalGraph | None] = None  # the graph of the mesh, if it was built already

    def __post_init__(self, known: SignalGraph | None) -> None:
        if known is not None:
            object.__setattr__(self, "_graph", known)
        _ = self._lock, self._cache  # created before threads start, which might create two

    def at(self, times: Float) -> Float:
        """Return displacements ``(N, V, 3)`` at times ``(N,)`` in seconds."""
        moved = np.zeros((len(times), self.vertex_count, 3))
        for row, (frame, share) in enumerate(zip(*self._places(times), strict=True)):
            for which, weight in ((frame, 1.0 - share), (frame + 1, share)):
                if weight > 0:
                    vertices, numbers = self._frame(int(which))
                    moved[row, vertices] += weight * self.unit * numbers
        return moved

    def rates(self, times: Float) -> Float:
        """Return the derivatives ``(N, V, 3)`` of the displacements by time, per second."""
        moved = np.zeros((len(times), self.vertex_count, 3))
        if len(self.times) == 1:
            return moved
        frames, _ = self._places(times)
        for row, frame in enumerate(np.minimum(frames, len(self.times) - 2)):
            for which, sign in ((frame, -1.0), (frame + 1, 1.0)):
                vertices, numbers = self._frame(int(which))
                duration = self.times[frame + 1] - self.times[frame]
                moved[row, vertices] += sign * self.unit * numbers / duration
        return moved

    def _places(self, times: Float) -> tuple[Index, Float]:
        """Return the frames before or at times, and the fractions of the way to the next."""
        places = np.interp(times, self.times, np.arange(len(self.times)))
        nearest = np.rint(places)
        near = np.abs(places - nearest) < 1e-9  # a frame is a frame, after rounding
        places = np.where(near, nearest, places)
        frames = np.floor(places).astype(np.int64)
        return frames, places - frames

    def _frame(self, frame: int) -> Residuals:
        chunk = int(np.searchsorted(self._starts, frame, side="right")) - 1
        run, place = divmod(frame - int(self._starts[chunk]), RUN)
        return self._run(chunk, run)[place]

    def _run(self, chunk: int, run: int) -> list[Residuals]:
        # Threads read frames in order, so a cache of the last few runs suffices.
        with self._lock:
            decoded = self._cache.get((chunk, run))
            if decoded is None:
                count, stream = self.chunks[chunk]
                decoded = read_residuals(stream, count, run, self._graph)
                self._cache[chunk, run] = decoded
                while len(self._cache) > _KEPT:
                    self._cache.pop(next(iter(self._cache)))
            return decoded

    @cached_property
    def _starts(self) -> Index:
        return np.cumsum([0, *(count for count, _ in self.chunks)])[:-1]

    @cached_property
    def _graph(self) -> SignalGraph:
        return mesh_graph(self.faces, self.vertex_count)

    @cached_property
    def _cache(self) -> dict[tuple[int, int], list[Residuals]]:
        return {}

    @cached_property
    def _lock(self) -> threading.Lock:
        return threading.Lock()


def write_residuals(residuals: Callable[[int], Index], frames: range, graph: SignalGraph) -> bytes:
    """Code the residuals of consecutive frames, ``(V, 3)`` each; empty if there are none.

    Runs of `RUN` frames are coded independently, two at a time, so that single frames decode quickly: first the lengths
    of all runs in bytes, four bytes each, then the runs.
    """
    parts = (frames[start : start + RUN] for start in range(0, len(frames), RUN))
    runs = list(two_thread_executor()(_write_run, (residuals, graph), parts))
    if not any(runs):
        return b""
    return np.array([len(run) for run in runs], dtype="<u4").tobytes() + b"".join(runs)


def read_residuals(stream: bytes, count: int, run: int, graph: SignalGraph) -> list[Residuals]:
    """Return the residuals of one run of frames."""
    frames = min(RUN, count - run * RUN)
    if not stream:
        return [_NOTHING] * frames
    number = -(-count // RUN)
    head, rest = stream[: 4 * number], len(stream) - 4 * number
    lengths = np.frombuffer(head if rest >= 0 else b"", dtype="<u4").astype(np.int64)
    if rest < 0 or lengths.sum() != rest:
        raise FormatError("a coded residual layer has another length than it says; the file is damaged")
    start = 4 * number + int(lengths[:run].sum())
    data = stream[start : start + int(lengths[run])]
    if not data:
        return [_NOTHING] * frames
    return _read_run(data, frames, graph)


def _write_run(known: tuple[Callable[[int], Index], SignalGraph], frames: range) -> bytes:
    residuals, graph = known
    writer, models, last = Writer(), _models(), np.zeros((graph.size, 3), dtype=np.int64)
    something = False
    for frame in frames:
        numbers = residuals(frame)[graph.order]
        something |= bool(numbers.any())
        code_residuals(writer.room(3 * graph.size), models, *_adjacent(graph), last, numbers)
        writer.checked(numbers)
        last = numbers
    return writer.finish() if something else b""


def _read_run(stream: bytes, count: int, graph: SignalGraph) -> list[Residuals]:
    reader, models, last = Reader(stream), _models(), np.zeros((graph.size, 3), dtype=np.int64)
    frames = []
    for _ in range(count):
        numbers = np.zeros((graph.size, 3), dtype=np.int64)
        code_residuals(reader.bits(), models, *_adjacent(graph), last, numbers)
        reader.checked(numbers)
        nodes = np.flatnonzero(numbers.any(axis=1))
        frames.append((graph.order[nodes], numbers[nodes]))
        last = numbers
    reader.finish()
    return frames


def _models() -> BitModels:
    return bit_models(INPUTS, CONTEXTS, POSITIONS)


def _adjacent(graph: SignalGraph) -> tuple[Index, Index, Index, Index]:
    return graph.neighbours, graph.counts, graph.ring, graph.ring_starts
