"""Code the residual layer: corrections of decoded frames that bring every vertex within a bound.

A residual is the displacement of a vertex at a frame, in whole units :math:`w` per coordinate. Nearly all vertices have
no residual. Residuals are coded frame by frame, in contexts of adjacent vertices and of the frame before, because the
errors of a truncated basis persist over frames. All values are integers.

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
    DAMAGE_CURE,
    EVEN_PROBABILITY,
    BitModels,
    BitStream,
    CoderState,
    bit_length,
    code_bit,
    code_modelled_bit,
    code_raw_bits,
    load_state,
    new_bit_models,
    store_state,
)
from mixseq.compression.bitstream.signal_coder import Reader, Writer
from mixseq.compression.bitstream.signal_graph import NEIGHBOUR_COUNTS, SignalGraph, mesh_graph
from mixseq.errors import FormatError
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.parallel import two_thread_executor
from mixseq.types import Float, Index, Int32

CONTEXTS_PER_BIT, CONTEXT_VALUES = 3, 3 * NEIGHBOUR_COUNTS * NEIGHBOUR_COUNTS  # of a bit, and values of each; frozen

_MAX_MODELLED_NUMBER, _MAX_EXCESS_BITS = 8, 62
"""Largest magnitude coded with models only, and largest bit length of the excess over it. Frozen: breaks old files."""

POSITION_COUNT = 4 + _MAX_MODELLED_NUMBER
"""Questions: any vertex displaced, this one displaced, coordinate not 0, sign, above 1, 2, ... Frozen: breaks files."""


@compiled
def code_residuals(
    stream: BitStream,
    models: BitModels,
    neighbours: Int32,
    counts: Int32,
    ring: Int32,
    starts: Index,
    last: Index,
    numbers: Index,
) -> None:
    """Write or read the residuals `numbers` ``(N, 3)`` of a frame, in contexts of the `last` frame's residuals.

    `neighbours`, `counts`, `ring` and `starts` are arrays of a `SignalGraph`.
    """
    state = load_state(stream)
    any_displaced = 0
    for node in range(len(numbers)):
        any_displaced |= _is_displaced(numbers, node)
    any_displaced, state = code_modelled_bit(stream, state, models, (0, 0, 0), 0, any_displaced)
    for node in range(len(numbers) if any_displaced else 0):
        displaced, count = 0, counts[node]  # number of displaced neighbours, and of all
        for i in range(count):
            displaced += _is_displaced(numbers, neighbours[node, i])
        last_displaced = 0  # number of adjacent nodes displaced in the last frame
        for place in range(starts[node], starts[node + 1]):
            last_displaced += _is_displaced(last, ring[place])
        was_displaced = _is_displaced(last, node)
        around = 2 if was_displaced else min(last_displaced, 1)
        last_displaced = min(last_displaced, NEIGHBOUR_COUNTS - 1)
        contexts = (
            (displaced * NEIGHBOUR_COUNTS + count) * 3 + around,
            (last_displaced * NEIGHBOUR_COUNTS + min(displaced, 3)) * 2 + was_displaced,
            min(displaced, 3) * 3 + around,
        )
        bit, state = code_modelled_bit(stream, state, models, contexts, 1, _is_displaced(numbers, node))
        if not bit:
            for k in range(3):
                numbers[node, k] = 0
            continue
        nonzero_axes = 0
        for k in range(3):
            total = 0
            for i in range(count if displaced else 0):
                total += min(max(numbers[neighbours[node, i], k], -1), 1)
            here, around = min(max(last[node, k], -3), 3) + 3, min(max(total, -3), 3) + 3
            contexts = (here * 7 + around, (nonzero_axes * 7 + around) * 3 + k, (nonzero_axes * 7 + here) * 3 + k)
            numbers[node, k], state = _code_coordinate(stream, state, models, contexts, numbers[node, k])
            nonzero_axes |= (1 if numbers[node, k] else 0) << k
    store_state(stream, state)


@force_inlined
def _is_displaced(numbers: Index, node: int) -> int:
    return 1 if numbers[node, 0] or numbers[node, 1] or numbers[node, 2] else 0


@force_inlined
def _code_coordinate(
    stream: BitStream, state: CoderState, models: BitModels, contexts: tuple[int, ...], number: int
) -> tuple[int, CoderState]:
    bit, state = code_modelled_bit(stream, state, models, contexts, 2, 1 if number else 0)
    if not bit:
        return 0, state
    sign, state = code_modelled_bit(stream, state, models, contexts, 3, 1 if number < 0 else 0)
    rest, value = abs(number) - 1, 0
    while bit and value < _MAX_MODELLED_NUMBER:
        bit, state = code_modelled_bit(stream, state, models, contexts, 4 + value, 1 if rest > value else 0)
        value += bit
    if bit:
        excess, length = max(rest - _MAX_MODELLED_NUMBER, 0), 0
        bits = bit_length(excess)
        while bit and length < _MAX_EXCESS_BITS:
            bit, state = code_bit(stream, state, EVEN_PROBABILITY, 1 if bits > length else 0)
            length += bit
        excess, state = code_raw_bits(stream, state, length, excess)
        value += excess
    return -(value + 1) if sign else value + 1, state


Residuals = tuple[Index, Index]
"""Displaced vertices ``(n,)`` of a frame, and their displacements ``(n, 3)`` in units of the layer."""

FRAMES_PER_RUN = 16  # number of frames coded together; frozen
_MAX_CACHED_RUNS = 8  # number of cached decoded runs; free: not in files

_NO_RESIDUALS: Residuals = np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class CodedResidualLayer(PickledWithoutCaches):
    """The residual layer of a compressed sequence, decoded on demand."""

    times: Float  # (T,) times of frames in seconds; residuals are interpolated linearly between frames
    chunks: tuple[tuple[int, bytes], ...]  # number of frames of every chunk, and its stream
    faces: NDArray[np.int32]  # (F, 3) triangles of the mesh
    vertex_count: int  # number V of vertices
    unit: float  # length of the unit w, in the units of the sequence
    graph: InitVar[SignalGraph | None] = None  # graph of the mesh, if already built

    def __post_init__(self, graph: SignalGraph | None) -> None:
        if graph is not None:
            object.__setattr__(self, "_graph", graph)
        _ = self._lock, self._cache  # create both before threads start, so that none is created twice

    def at(self, times: Float) -> Float:
        """Return the displacements ``(N, V, 3)`` of vertices at times ``(N,)`` in seconds."""
        displacements = np.zeros((len(times), self.vertex_count, 3))
        for row, (frame, fraction) in enumerate(zip(*self._locate_times(times), strict=True)):
            for frame_id, weight in ((frame, 1.0 - fraction), (frame + 1, fraction)):
                if weight > 0:
                    vertices, numbers = self._frame_residuals(int(frame_id))
                    displacements[row, vertices] += weight * self.unit * numbers
        return displacements

    def rates(self, times: Float) -> Float:
        """Return the time derivatives ``(N, V, 3)`` of the displacements, per second."""
        displacements = np.zeros((len(times), self.vertex_count, 3))
        if len(self.times) == 1:
            return displacements
        frames, _ = self._locate_times(times)
        for row, frame in enumerate(np.minimum(frames, len(self.times) - 2)):
            for frame_id, sign in ((frame, -1.0), (frame + 1, 1.0)):
                vertices, numbers = self._frame_residuals(int(frame_id))
                duration = self.times[frame + 1] - self.times[frame]
                displacements[row, vertices] += sign * self.unit * numbers / duration
        return displacements

    def _locate_times(self, times: Float) -> tuple[Index, Float]:
        """Return the frames at or before times ``(N,)``, and the fractions of the intervals to the next frames."""
        positions = np.interp(times, self.times, np.arange(len(self.times)))
        nearest = np.rint(positions)
        at_frame_mask = np.abs(positions - nearest) < 1e-9  # up to rounding
        positions = np.where(at_frame_mask, nearest, positions)
        frames = np.floor(positions).astype(np.int64)
        return frames, positions - frames

    def _frame_residuals(self, frame: int) -> Residuals:
        chunk = int(np.searchsorted(self._chunk_starts, frame, side="right")) - 1
        run, place = divmod(frame - int(self._chunk_starts[chunk]), FRAMES_PER_RUN)
        with self._lock:
            if (chunk, run) not in self._cache:
                count, stream = self.chunks[chunk]
                self._cache[chunk, run] = read_residuals(stream, count, run, self._graph)
                # Threads read frames in order, so a cache of the last few runs suffices.
                if len(self._cache) > _MAX_CACHED_RUNS:
                    self._cache.pop(next(iter(self._cache)))
                if len(self._cache) == sum(-(-frames // FRAMES_PER_RUN) for frames, _ in self.chunks):
                    self.__dict__.pop("_graph", None)  # all is decoded, and the graph is large
            return self._cache[chunk, run][place]

    @cached_property
    def _chunk_starts(self) -> Index:
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
    """Code the residuals ``(V, 3)`` of consecutive frames; return no bytes if all are zero.

    Runs of `FRAMES_PER_RUN` frames are coded independently, two at a time, so that single frames decode quickly. The
    stream has the sizes of all runs in bytes, as four-byte integers, then the runs.
    """
    spans = (frames[start : start + FRAMES_PER_RUN] for start in range(0, len(frames), FRAMES_PER_RUN))
    runs = list(two_thread_executor()(_write_run, (residuals, graph), spans))
    if not any(runs):
        return b""
    return np.array([len(run) for run in runs], dtype="<u4").tobytes() + b"".join(runs)


def read_residuals(stream: bytes, frame_count: int, run: int, graph: SignalGraph) -> list[Residuals]:
    """Read the residuals of every frame in one run of a stream that has `frame_count` frames."""
    frames, data = min(FRAMES_PER_RUN, frame_count - run * FRAMES_PER_RUN), b""
    if stream:
        run_count = -(-frame_count // FRAMES_PER_RUN)
        head, size = stream[: 4 * run_count], len(stream) - 4 * run_count
        lengths = np.frombuffer(head if size >= 0 else b"", dtype="<u4").astype(np.int64)
        if size < 0 or lengths.sum() != size:
            raise FormatError(f"the residual layer is damaged, its length is not the stated one; {DAMAGE_CURE}")
        start = 4 * run_count + int(lengths[:run].sum())
        data = stream[start : start + int(lengths[run])]
    return _read_run(data, frames, graph) if data else [_NO_RESIDUALS] * frames


def _write_run(shared: tuple[Callable[[int], Index], SignalGraph], frames: range) -> bytes:
    residuals, graph = shared
    writer, models, last = Writer(), _new_models(), np.zeros((graph.size, 3), dtype=np.int64)
    has_residuals = False
    for frame in frames:
        numbers = residuals(frame)[graph.order]
        has_residuals |= bool(numbers.any())
        code_residuals(writer.reserve(3 * graph.size), models, *_graph_arrays(graph), last, numbers)
        writer.add_to_checksum(numbers)
        last = numbers
    return writer.finish() if has_residuals else b""


def _read_run(stream: bytes, frame_count: int, graph: SignalGraph) -> list[Residuals]:
    reader, models, last = Reader(stream), _new_models(), np.zeros((graph.size, 3), dtype=np.int64)
    frames = []
    for _ in range(frame_count):
        numbers = np.zeros((graph.size, 3), dtype=np.int64)
        code_residuals(reader.stream(), models, *_graph_arrays(graph), last, numbers)
        reader.add_to_checksum(numbers)
        nodes = np.flatnonzero(numbers.any(axis=1))
        frames.append((graph.order[nodes], numbers[nodes]))
        last = numbers
    reader.finish()
    return frames


def _new_models() -> BitModels:
    return new_bit_models(CONTEXTS_PER_BIT, CONTEXT_VALUES, POSITION_COUNT)


def _graph_arrays(graph: SignalGraph) -> tuple[Int32, Int32, Int32, Index]:
    return graph.neighbours, graph.counts, graph.ring, graph.ring_starts
