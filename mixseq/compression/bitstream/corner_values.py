"""Code texture coordinates (multiples of 1 / n) and hard edges on the polygons of a mesh, without loss.

First the seams (`mixseq.compression.bitstream.uv_seams`): which corners at a vertex have the same coordinates, or share
a normal, and so are one *node*. Then the coordinates of nodes (`mixseq.compression.bitstream.uv_values`), predicted
from the polygons on nodes. Both are bits in contexts of `mixseq.compression.bitstream.arithmetic`, followed by the
check of the coordinates at all corners, or of the numbers of normals.

The coordinate k is the float32 next to the float64 k / n. All decisions use integers.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/uvs.npz``, and the digest in
``tests/compression/bitstream/test_hard_edges.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.compression.bitstream.arithmetic import (
    Bits,
    bits_to_read,
    bits_to_write,
    check_of,
    with_check,
    with_room_for_bits,
    without_check,
    written,
)
from mixseq.compression.bitstream.connectivity import Corners, corners_of, growing_order
from mixseq.compression.bitstream.uv_seams import (
    MOST_SEAM_BITS,
    SEAM_KINDS,
    Copies,
    Known,
    no_copies,
    no_guess,
    walk_seams,
)
from mixseq.compression.bitstream.uv_values import LARGEST, LONGEST, VALUE_KINDS, walk_values
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, renumber_by_first_use
from mixseq.types import FloatArray, Index, IntArray

_MOST_BITS = 2 * (2 * LONGEST + 1)
"""Bits of a pair of numbers at most. Free: memory is allocated ahead."""


def grid_numbers(values: FloatArray, steps: int) -> Index | None:
    """Return coordinates ``(n, 2)`` in units of ``1 / steps``; None if they are too large, or off the grid."""
    with np.errstate(invalid="ignore", over="ignore"):
        rounded = np.rint(values.astype(np.float64) * steps)
        if not (np.abs(rounded) <= LARGEST).all():
            return None
    numbers = rounded.astype(np.int64)
    return numbers if np.array_equal(grid_values(numbers, steps), values) else None


def grid_values(numbers: Index, steps: int) -> FloatArray:
    """Invert `grid_numbers`: return the coordinates of numbers."""
    return (numbers / steps).astype(np.float32)


@dataclass(frozen=True, eq=False)
class CodedUVs:
    """Coded texture coordinates."""

    data: bytes  # input of decode_uvs
    corners: Corners  # corners on nodes: on pairs of coordinates
    copies: Copies  # which polygons have images
    known: Known  # the coordinates of nodes, and their distances from the guesses


def code_uvs(polygons: Polygons, vertex_count: int, numbers: Index, regions: Index | None = None) -> CodedUVs:
    """Code coordinates in steps for `decode_uvs`: numbers ``(sum of counts, 2)``; regions ``(P,)``."""
    keys = np.column_stack([polygons.indices, numbers])
    labels = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    bits = bits_to_write(len(labels) * MOST_SEAM_BITS, SEAM_KINDS + VALUE_KINDS)
    corners = _corners_on_nodes(polygons, _walked_seams(bits, polygons, vertex_count, labels))
    count = len(corners.around_starts) - 1
    bits = with_room_for_bits(bits, (count + len(polygons.counts)) * _MOST_BITS)
    values = np.zeros((count, 2), dtype=np.int64)
    values[corners.node] = numbers
    copies, known = _walked_values(bits, corners, values, regions)
    return CodedUVs(with_check(written(bits.coded), check_of(numbers)), corners, copies, known)


def decode_uvs(data: bytes, polygons: Polygons, vertex_count: int, steps: int) -> CornerValues:
    """Return the texture coordinates written by `code_uvs`, as multiples of ``1 / steps``."""
    stream, expected = without_check(data)
    bits = bits_to_read(stream, SEAM_KINDS + VALUE_KINDS)
    nodes = _walked_seams(bits, polygons, vertex_count, np.zeros(polygons.indices.size, np.int64))
    corners = _corners_on_nodes(polygons, nodes)
    values = np.zeros((len(corners.around_starts) - 1, 2), dtype=np.int64)
    if not bits.failed[0]:
        _walked_values(bits, corners, values, None)
    if bits.failed[0] or check_of(values[corners.node]) != expected:
        raise FormatError(
            f"texture coordinates at {polygons.indices.size} corners are damaged, or those of another mesh"
        )
    return CornerValues(grid_values(values, steps), corners.node)


def _walked_seams(bits: Bits, polygons: Polygons, vertex_count: int, labels: Index) -> Index:
    """Code the seams by labels ``(C,)``, or decode them; return the node ``(C,)`` of every corner."""
    corners = corners_of(polygons, vertex_count)
    nodes = np.full(len(labels), -1, dtype=np.int64)
    walk_seams(bits, corners, growing_order(corners), labels, nodes)
    return nodes


def _corners_on_nodes(polygons: Polygons, nodes: Index) -> Corners:
    """Return the corners on nodes ``(C,)``; those without one, of damaged files, are on the first."""
    return corners_of(Polygons(polygons.counts, np.maximum(nodes, 0)), int(nodes.max(initial=-1)) + 1)


def _walked_values(
    bits: Bits, corners: Corners, values: Index, regions: Index | None
) -> tuple[Copies, Known]:
    """Code the values ``(N, 2)``, or decode them in place; return the copies and the known nodes."""
    order = growing_order(corners)
    copies = no_copies(corners, order)
    known = Known(values, np.zeros(len(values), dtype=np.bool_), np.zeros(len(values), dtype=np.int64))
    begin = np.zeros(len(order), dtype=np.int64) if regions is None else regions
    walk_values(bits, corners, order, copies, begin, known, no_guess())
    return copies, known


def encode_hard_edges(polygons: Polygons, vertex_count: int, numbers: IntArray) -> bytes | None:
    """Code which corners share a normal for `decode_hard_edges`: numbers ``(sum of counts,)``."""
    bits = bits_to_write(len(numbers) * MOST_SEAM_BITS, SEAM_KINDS)
    wanted = renumber_by_first_use(numbers)
    nodes = _walked_seams(bits, polygons, vertex_count, wanted)
    if not np.array_equal(renumber_by_first_use(nodes), wanted):
        return None
    return with_check(written(bits.coded), check_of(wanted))


def decode_hard_edges(data: bytes, polygons: Polygons, vertex_count: int) -> Index:
    """Return numbers ``(sum of counts,)`` of normals at the corners: 0, 1, 2, ... in order of first use."""
    stream, expected = without_check(data)
    bits = bits_to_read(stream, SEAM_KINDS)
    nodes = _walked_seams(bits, polygons, vertex_count, np.zeros(polygons.indices.size, dtype=np.int64))
    numbers = renumber_by_first_use(nodes)
    if bits.failed[0] or check_of(numbers) != expected:
        raise FormatError(
            f"hard edges at {polygons.indices.size} corners are damaged, or those of another mesh"
        )
    return numbers
