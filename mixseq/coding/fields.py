"""Signals over a graph as bytes: fields over a mesh, and tracks over time.

A signal is coded batch by batch from coarse to fine: every value is predicted, what is left is rounded to a whole
number of steps, and the number is coded in the context of its expected size. Large numbers are cut in two: few bits at
their end, which are as good as random, and what is left, which the models of the contexts know.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.coding.entropy import Reader, Tables, Writer
from mixseq.coding.graph import SignalGraph
from mixseq.coding.prediction import CONTEXTS, GROWTH, Predictor, bounds

_SMALL = 0.6
"""In contexts of expected sizes up to this, few numbers have symbols of their own, which is quicker."""

_FINEST = 8.0
"""Expected sizes up to this have numbers of their own; above, numbers are halved until they are below."""

_LEAST = 0.15
"""Expected size in the first context, to begin with."""


class NumberModels:
    """Adaptive models of numbers in all contexts; coders of several graphs can share them."""

    def __init__(self) -> None:
        sizes = np.append(bounds(), bounds()[-1] * GROWTH)
        self.small = int(np.count_nonzero(sizes <= _SMALL))
        self.small_tables = Tables(np.maximum(sizes[: self.small], _LEAST), 3)
        self.shifts = np.zeros(CONTEXTS, dtype=np.int64)
        while (sizes > _FINEST).any():
            self.shifts += sizes > _FINEST
            sizes = np.where(sizes > _FINEST, sizes / 2, sizes)
        self.tables = Tables(sizes, 15)


class FieldCoder:
    """Codes signals over one graph, one after another, to one or more streams.

    Parameters
    ----------
    graph : SignalGraph
        The graph.
    coordinates : int
        Number of signals that belong together: coordinates of a field, or of a track.
    models : NumberModels, optional
        Models that are shared with other coders, which write to the same streams.
    """

    def __init__(self, graph: SignalGraph, coordinates: int = 1, models: NumberModels | None = None) -> None:
        self._predictor = Predictor(graph, coordinates)
        self._models = models or NumberModels()

    def write(self, writer: Writer, targets: Float) -> Float:
        """Code a signal ``(N,)`` in steps; return the values ``(N,)`` in steps that a decoder will have."""
        self._predictor.begin()
        nodes = targets[self._predictor.graph.order]
        for batch in self._predictor.graph.batches:
            contexts = self._predictor.contexts(batch)
            numbers = self._predictor.quantise(batch, nodes)
            small = contexts < self._models.small
            writer.put(numbers[small], contexts[small], self._models.small_tables)
            self._write_large(writer, numbers[~small], contexts[~small])
        return self._finished()

    def quantise(self, targets: Float) -> Float:
        """Return what `write` returns, without coding anything."""
        self._predictor.begin()
        graph = self._predictor.graph
        self._predictor.quantise(slice(0, graph.size), targets[graph.order])
        return self._finished()

    def read(self, reader: Reader) -> Float:
        """Return the values ``(N,)`` in steps of the next signal."""
        self._predictor.begin()
        for batch in self._predictor.graph.batches:
            contexts = self._predictor.contexts(batch)
            small = contexts < self._models.small
            numbers = np.empty(len(contexts), dtype=np.int64)
            numbers[small] = reader.get(contexts[small], self._models.small_tables)
            numbers[~small] = self._read_large(reader, contexts[~small])
            self._predictor.restore(batch, numbers)
        return self._finished()

    def _write_large(self, writer: Writer, numbers: Index, contexts: Index) -> None:
        shifts = self._models.shifts[contexts]
        writer.put(numbers >> shifts, contexts, self._models.tables)
        for shift, some in _shifted(shifts):
            writer.put_flat(numbers[some] & ((1 << shift) - 1), 1 << shift)

    def _read_large(self, reader: Reader, contexts: Index) -> Index:
        shifts = self._models.shifts[contexts]
        numbers = reader.get(contexts, self._models.tables) << shifts
        for shift, some in _shifted(shifts):
            numbers[some] |= reader.get_flat(int(some.sum()), 1 << shift)
        return numbers

    def _finished(self) -> Float:
        values = np.empty(self._predictor.graph.size)
        values[self._predictor.graph.order] = self._predictor.finish()
        return values


def _shifted(shifts: Index) -> list[tuple[int, NDArray[np.bool_]]]:
    """Return which shifts ``(n,)`` there are, but zero, and where."""
    if not shifts.any():
        return []
    return [(int(shift), shifts == shift) for shift in np.flatnonzero(np.bincount(shifts)[1:]) + 1]
