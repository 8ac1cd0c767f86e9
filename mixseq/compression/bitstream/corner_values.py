"""Code texture coordinates (multiples of 1 / n) and hard edges on the polygons of a mesh, without loss.

Seams are coded first (`mixseq.compression.bitstream.uv_seams`): corners at a vertex with the same coordinates, or the
same normal, are one *node*. Then the coordinates of nodes (`mixseq.compression.bitstream.uv_values`) are predicted from
the polygons on nodes. Both are coded with hashed contexts (`mixseq.compression.bitstream.arithmetic`). The checksum of
the coordinates at all corners, or of the numbers of normals, follows.

The number k codes the coordinate k / n, computed in float64 and rounded to float32. All decisions use integers.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/uvs.npz``, and the digest in
``tests/compression/bitstream/test_hard_edges.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.compression.bitstream.arithmetic import (
    DAMAGE_CURE,
    HashedBits,
    append_checksum,
    checksum_of,
    finish_stream,
    new_hashed_bits,
    new_hashed_output,
    new_input_stream,
    reserve_bits,
    split_checksum,
)
from mixseq.compression.bitstream.connectivity import Corners, corners_on_nodes, growing_order
from mixseq.compression.bitstream.uv_seams import (
    MAX_SEAM_BITS,
    SEAM_KINDS,
    Copies,
    KnownNodes,
    code_seams,
    new_copies,
    new_guess,
)
from mixseq.compression.bitstream.uv_values import MAX_COORDINATE, MAX_NUMBER_BITS, VALUE_KINDS, code_values
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, renumber_by_first_use
from mixseq.types import FloatArray, Index, IntArray

_MAX_PAIR_BITS = 2 * (2 * MAX_NUMBER_BITS + 1)
"""Largest number of bits of a pair of numbers. Free: memory is allocated ahead."""


def to_grid(values: FloatArray, steps: int) -> Index | None:
    """Return coordinates ``(n, 2)`` in steps of the grid, or None if they are too large or off the grid."""
    with np.errstate(invalid="ignore", over="ignore"):
        rounded = np.rint(values.astype(np.float64) * steps)
        if not (np.abs(rounded) <= MAX_COORDINATE).all():
            return None
    numbers = rounded.astype(np.int64)
    return numbers if np.array_equal(from_grid(numbers, steps), values) else None


def from_grid(numbers: Index, steps: int) -> FloatArray:
    """Return the coordinates of numbers of steps ``(n, 2)``, the inverse of `to_grid`."""
    return (numbers / steps).astype(np.float32)


@dataclass(frozen=True, eq=False)
class CodedUVs:
    """Coded texture coordinates."""

    data: bytes  # stream for decode_uvs
    corners: Corners  # corners on nodes, which are pairs of coordinates
    copies: Copies  # images of the polygons
    known: KnownNodes  # coordinates of nodes, and their distances from the guesses


def code_uvs(polygons: Polygons, vertex_count: int, numbers: Index, regions: Index | None = None) -> CodedUVs:
    """Code the coordinates `numbers` ``(sum of counts, 2)``, in steps, with copied `regions` ``(P,)``."""
    keys = np.column_stack([polygons.indices, numbers])
    labels = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    bits = new_hashed_output(len(labels) * MAX_SEAM_BITS, SEAM_KINDS + VALUE_KINDS)
    corners = _corners_of_nodes(polygons, _code_seams(bits, polygons, vertex_count, labels))
    values = np.zeros((len(corners.around_starts) - 1, 2), dtype=np.int64)
    bits = reserve_bits(bits, (len(values) + len(polygons.counts)) * _MAX_PAIR_BITS)
    values[corners.node] = numbers
    copies, known = _code_values(bits, corners, values, regions)
    return CodedUVs(append_checksum(finish_stream(bits.stream), checksum_of(numbers)), corners, copies, known)


def decode_uvs(data: bytes, polygons: Polygons, vertex_count: int, steps: int) -> CornerValues:
    """Decode the texture coordinates written by `code_uvs`, multiples of ``1 / steps``."""
    stream, expected = split_checksum(data)
    bits = new_hashed_bits(new_input_stream(stream), SEAM_KINDS + VALUE_KINDS)
    nodes = _code_seams(bits, polygons, vertex_count, np.zeros(polygons.indices.size, np.int64))
    corners = _corners_of_nodes(polygons, nodes)
    values = np.zeros((len(corners.around_starts) - 1, 2), dtype=np.int64)
    if not bits.failed[0]:
        _code_values(bits, corners, values, None)
    if bits.failed[0] or checksum_of(values[corners.node]) != expected:
        raise FormatError(f"coded texture coordinates at {polygons.indices.size} corners are damaged; {DAMAGE_CURE}")
    return CornerValues(from_grid(values, steps), corners.node)


def _code_seams(bits: HashedBits, polygons: Polygons, vertex_count: int, labels: Index) -> Index:
    """Code the seams between labels ``(C,)``, or decode seams; return the node ``(C,)`` of every corner."""
    corners = corners_on_nodes(polygons, vertex_count)
    nodes = np.full(len(labels), -1, dtype=np.int64)
    code_seams(bits, corners, growing_order(corners), labels, nodes)
    return nodes


def _corners_of_nodes(polygons: Polygons, nodes: Index) -> Corners:
    """Return the corners on nodes ``(C,)``; in damaged files, corners without a node are put on the first node."""
    return corners_on_nodes(Polygons(polygons.counts, np.maximum(nodes, 0)), int(nodes.max(initial=-1)) + 1)


def _code_values(bits: HashedBits, corners: Corners, values: Index, regions: Index | None) -> tuple[Copies, KnownNodes]:
    """Code the values ``(N, 2)``, or decode them in place; return the copies and the known nodes."""
    order = growing_order(corners)
    copies = new_copies(corners, order)
    known = KnownNodes(values, np.zeros(len(values), dtype=np.bool_), np.zeros(len(values), dtype=np.int64))
    regions = np.zeros(len(order), dtype=np.int64) if regions is None else regions
    code_values(bits, corners, order, copies, regions, known, new_guess())
    return copies, known


def encode_hard_edges(polygons: Polygons, vertex_count: int, numbers: IntArray) -> bytes | None:
    """Code which corners share a normal, by normal numbers ``(sum of counts,)``; return None if this is impossible."""
    bits = new_hashed_output(len(numbers) * MAX_SEAM_BITS, SEAM_KINDS)
    normal_ids = renumber_by_first_use(numbers)
    nodes = _code_seams(bits, polygons, vertex_count, normal_ids)
    if not np.array_equal(renumber_by_first_use(nodes), normal_ids):
        return None
    return append_checksum(finish_stream(bits.stream), checksum_of(normal_ids))


def decode_hard_edges(data: bytes, polygons: Polygons, vertex_count: int) -> Index:
    """Decode the numbers ``(sum of counts,)`` of normals at the corners: 0, 1, 2, ... in order of first use."""
    stream, expected = split_checksum(data)
    bits = new_hashed_bits(new_input_stream(stream), SEAM_KINDS)
    nodes = _code_seams(bits, polygons, vertex_count, np.zeros(polygons.indices.size, dtype=np.int64))
    numbers = renumber_by_first_use(nodes)
    if bits.failed[0] or checksum_of(numbers) != expected:
        raise FormatError(f"coded hard edges at {polygons.indices.size} corners are damaged; {DAMAGE_CURE}")
    return numbers
