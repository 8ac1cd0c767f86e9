"""The poses of a mesh of a page, asked for once and kept, and where they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float
from mixseq.disk_array import LargeArray, new_large_array
from mixseq.errors import InvalidSequenceError
from mixseq.plots.camera import View, broadside, y_up
from mixseq.sequence import SequenceHeader, check_block
from mixseq.viewing.budget import Budget
from mixseq.viewing.exporting import Exported
from mixseq.viewing.framing import Extent, extent_of

TOGETHER = 2.0
"""Meshes with the same triangles are compared at one scale, unless the box around them is more than so many times as
large as the smaller one; ours. Metres beside centimetres would be a dot."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """The poses of a mesh.

    Attributes
    ----------
    poses : (n, V, 3) array, perhaps on disk
        As they were given.
    extent : Extent
        Where they are, from their own view and from that of the first mesh of the page.
    views : (View, View)
        Their own view, and that of the first mesh of the page.
    like_first : bool
        Whether they are seen as the first mesh is: they have its triangles, and about its place and size.
    """

    poses: LargeArray
    extent: Extent
    views: tuple[View, View]
    like_first: bool


def gather(
    item: Exported, elapsed: Float, first: tuple[SequenceHeader, Gathered] | None, budget: Budget
) -> Gathered:
    """Ask for the poses of a mesh once.

    Parameters
    ----------
    item : Exported
        The mesh.
    elapsed : (n,) float64
        Times of its poses.
    first : (SequenceHeader, Gathered), optional
        The first mesh of the page; None for itself.
    budget : Budget
        Told about all frames.

    Raises
    ------
    InvalidSequenceError
        If there are more or fewer poses than times, or poses of another mesh.
    """
    header = item.header
    same = first is None or np.array_equal(header.faces, first[0].faces)
    views: tuple[View, View] | None = None
    table: LargeArray | None = None
    extent: Extent | None = None
    done = 0
    for block in item.poses(elapsed):
        check_block(header, block, done)
        if done + len(block) > len(elapsed):
            raise InvalidSequenceError(f"{item.name} has more poses than the {len(elapsed)} times asked for")
        if table is None or views is None:
            table = new_large_array((len(elapsed), header.vertex_count, 3), block.dtype)
            own = first[1].views[0] if first and same else broadside(block[0], header.up_axis)
            views = own, first[1].views[0] if first else own
        table[done : done + len(block)] = block
        done += len(block)
        extent = extent_of(y_up(block, header.up_axis), views).joined(extent)
        budget.gathered(len(block))
    if table is None or extent is None or views is None or done < len(elapsed):
        raise InvalidSequenceError(f"{item.name} has {done} poses but {len(elapsed)} times were asked for")
    like_first = same and (first is None or _together(extent, first[1].extent))
    return Gathered(table, extent, views, like_first)


def _together(one: Extent, other: Extent) -> bool:
    """Whether both can be seen well in a picture that shows both."""
    return one.joined(other).side <= TOGETHER * min(one.side, other.side)
