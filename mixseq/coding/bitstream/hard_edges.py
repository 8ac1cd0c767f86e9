"""Code hard edges: which corners at a vertex share a normal.

The bits are those of `mixseq.coding.bitstream.uv_seams`, followed by the `decoded_check` of the decoded numbers.

Frozen: changing this breaks old files (golden: the digest in ``tests/coding/bitstream/test_hard_edges.py``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index, IntArray
from mixseq.coding.bitstream.arithmetic import written
from mixseq.coding.bitstream.decoded_check import check_of, with_check, without_check
from mixseq.coding.bitstream.growing import corners_of, growing_order
from mixseq.coding.bitstream.hashed_contexts import Bits, bits_to_read, bits_to_write
from mixseq.coding.bitstream.uv_seams import MOST_SEAM_BITS, SEAM_KINDS, walk_seams
from mixseq.errors import FormatError
from mixseq.polygons import Polygons
from mixseq.surface import by_first_use


def encode_hard_edges(polygons: Polygons, vertex_count: int, numbers: IntArray) -> bytes | None:
    """Code which corners share a normal for `decode_hard_edges`: numbers ``(sum of counts,)``."""
    bits = bits_to_write(len(numbers) * MOST_SEAM_BITS, SEAM_KINDS)
    wanted = by_first_use(numbers)
    nodes = _walked(bits, polygons, vertex_count, wanted)
    if not np.array_equal(by_first_use(nodes), wanted):
        return None
    return with_check(written(bits.coded), check_of(wanted))


def decode_hard_edges(data: bytes, polygons: Polygons, vertex_count: int) -> Index:
    """Return numbers ``(sum of counts,)`` of normals at the corners: 0, 1, 2, ... in order of first use."""
    what = f"hard edges at {polygons.indices.size} corners"
    stream, expected = without_check(data)
    bits = bits_to_read(stream, SEAM_KINDS)
    nodes = _walked(bits, polygons, vertex_count, np.zeros(polygons.indices.size, dtype=np.int64))
    numbers = by_first_use(nodes)
    if bits.failed[0] or check_of(numbers) != expected:
        raise FormatError(f"{what} are damaged, or those of another mesh")
    return numbers


def _walked(bits: Bits, polygons: Polygons, vertex_count: int, labels: Index) -> Index:
    corners = corners_of(polygons, vertex_count)
    nodes = np.full(len(labels), -1, dtype=np.int64)
    walk_seams(bits, corners, growing_order(corners), labels, nodes)
    return nodes
