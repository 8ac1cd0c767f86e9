"""Choose the numbering of vertices and polygons in a compressed file that takes the fewest bytes."""

from __future__ import annotations

from mixseq.choices import ORDERS, OrderName
from mixseq.coding.bitstream.connectivity import encode_polygons
from mixseq.coding.renumbering import Renumbering, as_it_is, by_walk, object_sizes
from mixseq.errors import SettingsError
from mixseq.sequence_header import SequenceHeader


def cheapest_numbering(header: SequenceHeader, order: OrderName) -> Renumbering:
    """Return the numbering in which polygons take the fewest bytes."""
    if order not in ORDERS:
        raise SettingsError(f"order is {order!r}; one of {', '.join(ORDERS)} is expected")
    polygons, sizes = header.polygons, object_sizes(header)
    kept = as_it_is(polygons, header.vertex_count)
    if order == "keep":
        return kept
    walks = [by_walk(polygons, sizes, vertices=each) for each in (False, True)[: ORDERS.index(order)]]
    return min(
        [kept, *walks],
        key=lambda each: len(encode_polygons(each.of_polygons(polygons), header.vertex_count)),
    )
