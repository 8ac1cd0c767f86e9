r"""Corrections: what brings every vertex of every frame below a bound.

Where the frame that a decoder has is further than the bound :math:`\varepsilon` from the original, the difference is
rounded to multiples of

.. math:: w = 2 \varepsilon / \sqrt 3

in every coordinate. What is left is at most :math:`w / 2` in each, so at most :math:`\varepsilon` in all. Everywhere
else there is no correction. Which vertices have one is told frame by frame, in contexts of the vertices around them
and of the frame before: where a few modes too few make an error, it lasts a while.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.coding.entropy import Reader, Tables, Writer
from mixseq.coding.graph import SignalGraph
from mixseq.errors import FormatError

Correction = tuple[Index, Index]
"""Vertices ``(n,)`` of a frame, and their displacements ``(n, 3)`` in units of `width`."""

RUN = 16
"""So many frames are coded together."""

_NOTHING: Correction = np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int64)

_LEVELS = (0.0, 0.08, 0.2, 0.4, 0.7)
"""Bounds between contexts: shares of corrected vertices that are expected."""

_BEFORE = 3
"""Contexts by the frame before: the vertex had a correction, some around it had, none had."""


def width(bound: float) -> float:
    """Return the unit w of corrections for a bound, both in the units of the sequence."""
    return float(2.0 * bound / np.sqrt(3.0))


def needed(apart: Float, bound: float) -> Index:
    """Return corrections in units of `width`.

    Parameters
    ----------
    apart : (T, V, 3) float64
        Originals minus decoded frames.
    bound : float
        The bound.

    Returns
    -------
    (T, V, 3) int64
        Zeros where nothing has to be corrected.
    """
    far = np.einsum("tvi,tvi->tv", apart, apart) > bound * bound
    return np.where(far[..., None], np.rint(apart / width(bound)), 0.0).astype(np.int64)


def write_corrections(frames: Iterable[Index], graph: SignalGraph) -> bytes:
    """Code the corrections of consecutive frames, ``(V, 3)`` each; nothing at all if there are none.

    Runs of `RUN` frames are coded by themselves, so that one frame can be decoded without many others: first the
    lengths of all runs in bytes, four bytes each, then the runs.
    """
    runs = [_write_run(run, graph) for run in _runs(frames)]
    if not any(runs):
        return b""
    return np.array([len(run) for run in runs], dtype="<u4").tobytes() + b"".join(runs)


def read_corrections(stream: bytes, count: int, run: int, graph: SignalGraph) -> list[Correction]:
    """Return the corrections of one run of frames.

    Parameters
    ----------
    stream : bytes
        What `write_corrections` returned.
    count : int
        Number of frames in the stream.
    run : int
        Which run: frames from ``run * RUN`` on.
    graph : SignalGraph
        Of the mesh.

    Returns
    -------
    list of (vertices (n,), numbers (n, 3))
        For every frame of the run, which vertices are displaced, and how far, in units of `width`.

    Raises
    ------
    FormatError
        If the stream is damaged.
    """
    frames = min(RUN, count - run * RUN)
    if not stream:
        return [_NOTHING] * frames
    number = -(-count // RUN)
    head, rest = stream[: 4 * number], len(stream) - 4 * number
    lengths = np.frombuffer(head if rest >= 0 else b"", dtype="<u4").astype(np.int64)
    if rest < 0 or lengths.sum() != rest:
        raise FormatError("coded corrections have another length than they say; the file is damaged")
    start = 4 * number + int(lengths[:run].sum())
    return _read_run(stream[start : start + int(lengths[run])], frames, graph)


def _runs(frames: Iterable[Index]) -> Iterator[list[Index]]:
    rest = iter(frames)
    while run := list(islice(rest, RUN)):
        yield run


def _write_run(frames: Iterable[Index], graph: SignalGraph) -> bytes:
    writer, contexts, something = Writer(), _Contexts(graph), False
    for vertices in frames:
        frame = vertices[graph.order]
        corrected: NDArray[np.bool_] = np.any(frame, axis=1)
        something |= bool(corrected.any())
        writer.put_flat(np.array([int(corrected.any())]), 2)
        contexts.begin()
        if corrected.any():
            for batch in graph.batches:
                flags = corrected[batch]
                writer.put(flags.astype(np.int64), contexts.of(batch), contexts.tables)
                contexts.corrected[batch] = flags
            nodes = np.flatnonzero(corrected)
            writer.put(frame[nodes].reshape(-1), contexts.of_numbers(nodes), contexts.number_tables)
        contexts.finish(frame)
    return writer.finish() if something else b""


def _read_run(stream: bytes, count: int, graph: SignalGraph) -> list[Correction]:
    if not stream:
        return [_NOTHING] * count
    reader, contexts = Reader(stream), _Contexts(graph)
    frames = []
    for _ in range(count):
        nodes, numbers = _NOTHING
        contexts.begin()
        if reader.get_flat(1, 2)[0]:
            for batch in graph.batches:
                contexts.corrected[batch] = reader.get(contexts.of(batch), contexts.tables)
            nodes = np.flatnonzero(contexts.corrected)
            numbers = reader.get(contexts.of_numbers(nodes), contexts.number_tables).reshape(-1, 3)
        frame = np.zeros((graph.size, 3), dtype=np.int64)
        frame[nodes] = numbers
        contexts.finish(frame)
        frames.append((graph.order[nodes], numbers))
    return frames


class _Contexts:
    """What is known around a node when it is told whether it has a correction."""

    def __init__(self, graph: SignalGraph) -> None:
        self._graph = graph
        count = len(_LEVELS) + 1
        shares = np.tile([0.02, *_LEVELS[1:], 0.9], _BEFORE)
        self.tables = Tables(shares, 1)
        self.number_tables = Tables([0.6, 0.6, 1.0, 2.0], 15)
        self._levels = count
        self._last = np.zeros((graph.size, 3), dtype=np.int64)
        self._before = np.zeros(graph.size, dtype=np.int64)
        self.corrected = np.zeros(graph.size)

    def begin(self) -> None:
        self.corrected = np.zeros(self._graph.size)

    def of(self, batch: slice) -> Index:
        """Contexts ``(n,)``: by the neighbours that are known, and by the frame before."""
        from mixseq.coding.prediction_kernels import surroundings

        graph, flags = self._graph, self.corrected
        beside = surroundings(batch.start, batch.stop, flags, flags, graph.neighbours, graph.counts)
        return np.searchsorted(_LEVELS, beside).astype(np.int64) + self._levels * self._before[batch]

    def of_numbers(self, nodes: Index) -> Index:
        """Contexts ``(3 n,)`` of the coordinates: by their size in the frame before."""
        return np.asarray(np.abs(self._last[nodes].clip(-3, 3)).reshape(-1))

    def finish(self, frame: Index) -> None:
        from mixseq.coding.prediction_kernels import smooth

        graph = self._graph
        own: NDArray[np.bool_] = np.any(frame, axis=1)
        around = smooth(np.asarray(own, dtype=np.float64), graph.ring, graph.ring_starts) > 0
        self._before = np.where(own, 2, around.astype(np.int64))
        self._last = frame
