"""Read a run of frames of the residual layer as model versions 4 and 7 have it.

Which vertices have a residual is coded frame by frame, in contexts of the vertices around them and of the frame before.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/bounded.npz``,
``tests/formats/golden/model-v4-coded.h5``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index, Mask
from mixseq.coding.bitstream.entropy import Reader, Tables
from mixseq.coding.bitstream.revision_1.signal_kernels import smooth, surroundings
from mixseq.coding.bitstream.signal_graph import SignalGraph

_LEVELS = (0.0, 0.08, 0.2, 0.4, 0.7)
"""Bounds between contexts: shares of displaced vertices that are expected. Frozen: other bounds break old files."""

_BEFORE = 3
"""Contexts by the frame before: the vertex had a residual, some around it had, none had. Frozen: breaks old files."""

_FLAG_MAGNITUDES = (0.02, 0.08, 0.2, 0.4, 0.7, 0.9)
"""What is expected of flags in the contexts, to begin with. Frozen: other magnitudes break old files."""

_NUMBER_MAGNITUDES = (0.6, 0.6, 1.0, 2.0)
"""The same of displacements, by their magnitude in the frame before. Frozen: other magnitudes break old files."""


def read_run(stream: bytes, count: int, graph: SignalGraph) -> list[tuple[Index, Index]]:
    """Return the residuals of so many frames: vertices ``(n,)``, and their numbers ``(n, 3)``."""
    reader, contexts = Reader(stream), _Contexts(graph)
    frames = []
    for _ in range(count):
        nodes, numbers = np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int64)
        contexts.begin()
        if reader.get_flat(1, 2)[0]:
            for batch in graph.batches:
                contexts.displaced[batch] = reader.get(contexts.of(batch), contexts.tables)
            nodes = np.flatnonzero(contexts.displaced)
            numbers = reader.get(contexts.of_numbers(nodes), contexts.number_tables).reshape(-1, 3)
        frame = np.zeros((graph.size, 3), dtype=np.int64)
        frame[nodes] = numbers
        contexts.finish(frame)
        frames.append((graph.order[nodes], numbers))
    return frames


class _Contexts:
    """What is known around a node when it is coded whether it has a residual."""

    def __init__(self, graph: SignalGraph) -> None:
        self._graph = graph
        self.tables = Tables(np.tile(_FLAG_MAGNITUDES, _BEFORE), 1)
        self.number_tables = Tables(list(_NUMBER_MAGNITUDES), 15)
        self._last = np.zeros((graph.size, 3), dtype=np.int64)
        self._before = np.zeros(graph.size, dtype=np.int64)
        self.displaced = np.zeros(graph.size)

    def begin(self) -> None:
        self.displaced = np.zeros(self._graph.size)

    def of(self, batch: slice) -> Index:
        """Contexts ``(n,)``: by the neighbours that are known, and by the frame before."""
        graph, flags = self._graph, self.displaced
        beside = surroundings(batch.start, batch.stop, flags, flags, graph.neighbours, graph.counts)
        levels = np.searchsorted(_LEVELS, beside).astype(np.int64)
        return levels + len(_FLAG_MAGNITUDES) * self._before[batch]

    def of_numbers(self, nodes: Index) -> Index:
        """Contexts ``(3 n,)`` of the coordinates: by their size in the frame before."""
        return np.asarray(np.abs(self._last[nodes].clip(-3, 3)).reshape(-1))

    def finish(self, frame: Index) -> None:
        graph = self._graph
        own: Mask = np.any(frame, axis=1)
        around = smooth(np.asarray(own, dtype=np.float64), graph.ring, graph.ring_starts) > 0
        self._before = np.where(own, 2, around.astype(np.int64))
        self._last = frame
