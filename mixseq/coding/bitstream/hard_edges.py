"""Code hard edges: which corners at a vertex share a normal, as is coded which share texture coordinates.

The bits are those of `mixseq.coding.bitstream.uv_seams`, mixed and sorted by `mixseq.coding.bitstream.bit_mixing` with
weights of 11000 to begin with, and packed by `mixseq.coding.bitstream.bit_queues`.

Frozen: changing this breaks old files (golden: the digest in ``tests/coding/bitstream/test_hard_edges.py``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index, IntArray
from mixseq.coding.bitstream.bit_mixing import Bits, bits_to_code
from mixseq.coding.bitstream.bit_queues import all_decoded, pack_queues, unpack_queues
from mixseq.coding.bitstream.growing import corners_of, growing_order
from mixseq.coding.bitstream.uv_seams import MOST_NODES, SEAM_KINDS, walk_seams
from mixseq.errors import FormatError
from mixseq.polygons import Polygons
from mixseq.surface import by_first_use

_FIRST_WEIGHT = 11000
"""Weights to begin with, in units of 2^-16. Frozen: breaks old files."""


def encode_hard_edges(polygons: Polygons, vertex_count: int, numbers: IntArray) -> bytes | None:
    """Code which corners share a normal so that `decode_hard_edges` returns it.

    Parameters
    ----------
    polygons : Polygons
        The mesh, with at least one polygon.
    vertex_count : int
        Number of its vertices.
    numbers : (sum of counts,) int
        Corners with the same number share a normal.

    Returns
    -------
    bytes or None
        None if vertices share a normal, or one has very many: that is not coded.
    """
    bits = bits_to_code(_most_bits(len(numbers)), SEAM_KINDS)
    nodes = _walked(bits, polygons, vertex_count, by_first_use(numbers))
    return pack_queues(bits) if np.array_equal(by_first_use(nodes), by_first_use(numbers)) else None


def decode_hard_edges(data: bytes, polygons: Polygons, vertex_count: int) -> Index:
    """Return numbers ``(sum of counts,)`` of normals at the corners: 0, 1, 2, ... as they come.

    Raises
    ------
    FormatError
        If the data are damaged, or those of another mesh (not all damage is noticed: files have checksums).
    """
    what = f"hard edges at {polygons.indices.size} corners"
    bits = unpack_queues(data, _most_bits(polygons.indices.size), SEAM_KINDS, what)
    nodes = _walked(bits, polygons, vertex_count, np.zeros(polygons.indices.size, dtype=np.int64))
    if not all_decoded(bits):
        raise FormatError(f"{what} are damaged, or those of another mesh")
    return by_first_use(nodes)


def _walked(bits: Bits, polygons: Polygons, vertex_count: int, labels: Index) -> Index:
    bits.weights[:] = _FIRST_WEIGHT
    corners = corners_of(polygons, vertex_count)
    nodes = np.full(len(labels), -1, dtype=np.int64)
    walk_seams(bits, corners, growing_order(corners), labels, nodes)
    return nodes


def _most_bits(corners: int) -> int:
    return corners * (2 + MOST_NODES)
