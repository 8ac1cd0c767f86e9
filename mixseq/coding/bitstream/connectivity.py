"""Code polygons without loss: the order of vertices and faces, and first corners, are kept.

Users number vertices and faces, so they cannot be renumbered as Edgebreaker does. Corners are coded in their order, and
predicted from the mesh so far, from the polygons before, and from the numbers of their neighbours (in the spirit of the
index codec of *meshoptimizer*). Probabilities of the predictions are learned bit by bit
(`mixseq.coding.bitstream.hashed_contexts`). Meshes in coherent order take 2 to 10 bits per triangle; random order takes
about half a logarithm of V! F!.

**The bits.** For every polygon, its number of corners minus that of the polygon before (3 for the first), then its
corners, as specified in `mixseq.coding.bitstream.connectivity_kernels`. Then the `decoded_check` of both.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

import numpy as np

from mixseq.coding.bitstream.arithmetic import written
from mixseq.coding.bitstream.connectivity_kernels import KINDS, walk
from mixseq.coding.bitstream.corner_guesses import GUESSES, no_past
from mixseq.coding.bitstream.decoded_check import check_of, with_check, without_check
from mixseq.coding.bitstream.half_edges import no_half_edges
from mixseq.coding.bitstream.hashed_contexts import bits_to_read, bits_to_write
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.polygons import Polygons


def encode_polygons(polygons: Polygons, vertex_count: int) -> bytes:
    """Code polygons for `decode_polygons`."""
    if not len(polygons.counts):
        return b""
    lowest, highest = int(polygons.indices.min()), int(polygons.indices.max())
    if lowest < 0 or highest >= vertex_count:
        raise InvalidSequenceError(
            f"corners have vertices {lowest} to {highest}; with {vertex_count} vertices, 0 to {vertex_count - 1} exist"
        )
    counts, indices = polygons.counts.astype(np.int64), polygons.indices.astype(np.int64)
    bits = bits_to_write(_most_bits(len(counts), len(indices), vertex_count), KINDS)
    walk(bits, no_half_edges(len(indices), vertex_count), no_past(vertex_count), counts, indices)
    return with_check(written(bits.coded), check_of(indices, check_of(counts)))


def decode_polygons(data: bytes, polygon_count: int, corner_count: int, vertex_count: int) -> Polygons:
    """Decode the polygons written by `encode_polygons`."""
    mesh = f"{polygon_count} polygons with {corner_count} corners and {vertex_count} vertices"
    if (
        polygon_count < 0
        or not 0 <= vertex_count < 1 << 31
        or not 3 * polygon_count <= corner_count < 1 << 31
    ):
        raise FormatError(f"a mesh cannot have {mesh}; the file is damaged")
    if not polygon_count or not vertex_count:
        if data or corner_count:
            raise FormatError(f"a mesh with {mesh} has no coded corners; the file is damaged")
        return Polygons(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    stream, expected = without_check(data)
    bits = bits_to_read(stream, KINDS)
    counts, indices = np.zeros(polygon_count, dtype=np.int64), np.zeros(corner_count, dtype=np.int64)
    walk(bits, no_half_edges(corner_count, vertex_count), no_past(vertex_count), counts, indices)
    if bits.failed[0] or check_of(indices, check_of(counts)) != expected:
        raise FormatError(f"coded polygons are damaged, or those of another mesh than one of {mesh}")
    return Polygons(counts, indices)


def _most_bits(polygon_count: int, corner_count: int, vertex_count: int) -> int:
    """Return the largest number of bits of a mesh: guesses, and numbers for counts, states (up to 1) and distances."""
    count, state, distance = (2 + 2 * most.bit_length() for most in (corner_count, 1, vertex_count))
    return polygon_count * count + corner_count * (GUESSES + state + distance)
