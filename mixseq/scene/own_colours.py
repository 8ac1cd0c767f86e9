"""The colours of a mesh as entries of a palette, as viewers of glTF show them on a plain white material.

They are linear, as in glTF and USD, and converted to opaque sRGB, clipped to 0..1. Up to 256 colours are kept to 8 bits
a channel. Of more a palette is made: starting with one box, the box with the largest sum of squared distances from its
mean is cut there, across the side of largest share, until there are 256 (as Wu 1991, without a search for the best
cuts). A colour then is the mean of its box.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.scene.palettes import srgb
from mixseq.sequence import SequenceHeader
from mixseq.surface import WHITE

ENTRIES = 256
"""Largest number of colours of a palette."""


def own_colours(header: SequenceHeader) -> tuple[NDArray[np.uint8], Index]:
    """Return a palette ``(n, 3)`` and entries ``(V,)`` of vertices, those of their first corners."""
    assert header.surface.colours is not None
    linear = header.surface.colours.at_vertices(header.polygons.indices, header.vertex_count, WHITE)[:, :3]
    shown = np.rint(255 * srgb(np.clip(np.nan_to_num(linear), 0, 1))).astype(np.uint8)
    kinds, entries, counts = np.unique(shown, axis=0, return_inverse=True, return_counts=True)
    if len(kinds) <= ENTRIES:
        return kinds, entries.reshape(-1)
    palette, of_kind = _boxes(kinds.astype(np.float64), counts)
    return np.rint(palette).astype(np.uint8), of_kind[entries.reshape(-1)]


def _boxes(colours: Float, counts: Index) -> tuple[Float, Index]:
    """Return the means ``(256, 3)`` of boxes of different colours ``(n, 3)``, and the box ``(n,)`` of each."""
    heap = [_box(colours, counts, np.arange(len(colours)))]
    heapify(heap)
    while len(heap) < ENTRIES:
        _, _, inside, mean, side = heappop(heap)
        beyond = colours[inside, side] > mean[side]
        for some in (inside[~beyond], inside[beyond]):
            heappush(heap, _box(colours, counts, some))
    box = np.empty(len(colours), dtype=np.int64)
    for number, (_, _, inside, _, _) in enumerate(heap):
        box[inside] = number
    return np.stack([mean for _, _, _, mean, _ in heap]), box


def _box(colours: Float, counts: Index, inside: Index) -> tuple[float, int, Index, Float, int]:
    """Return a box of some colours, sortable: the largest sum of squares first, then by its first colour."""
    own, weights = colours[inside], counts[inside]
    mean = weights @ own / weights.sum()
    squares = weights @ np.square(own - mean)
    return -float(squares.sum()), int(inside[0]), inside, mean, int(squares.argmax())
