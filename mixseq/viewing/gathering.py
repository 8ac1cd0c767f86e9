"""The meshes of a page, and their poses: read once and kept, with their extents in space and on the screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.coding.bitstream.compressed_sequence import CompressedSequence
from mixseq.disk_array import LargeArray, new_large_array
from mixseq.errors import InvalidSequenceError
from mixseq.mapping import Executor
from mixseq.progress import Progress, silent
from mixseq.scene import Colouring, SceneColours, SceneItem
from mixseq.scene.camera import View, seen_from, y_up
from mixseq.sequence import SequenceHeader, check_block
from mixseq.viewing.chart_data import signals_of

TOGETHER = 2.0
"""Ratio of joint to smaller box up to which meshes have one scale: metres beside centimetres would be a dot."""


@dataclass(frozen=True, eq=False)
class PageItem:
    """A mesh in a page, with the poses of its own frames."""

    mesh: SceneItem  # the moving mesh
    colourings: Mapping[str, Colouring]  # available colourings, the initial one first
    # The signals of a model, for its charts (mixseq.viewing.chart_data.signals_of).
    signals: Mapping[str, Any] | None = None
    coded: CompressedSequence | None = None  # the compressed mesh, if there is one


def page_items(
    colours: SceneColours, coded: Sequence[CompressedSequence | None] | None = None
) -> list[PageItem]:
    """Return the meshes of a scene with all their colourings, and the charts of models."""
    items = colours.scene.items
    return [
        PageItem(
            item, colours.each(index), None if item.model is None else signals_of(item.model), compressed
        )
        for index, (item, compressed) in enumerate(zip(items, coded or [None] * len(items), strict=True))
    ]


@dataclass(frozen=True, eq=False)
class Extent:
    """The extent of a mesh over all poses, Y up."""

    low: Float  # (3,) minimum corner of its bounding box
    high: Float  # (3,) maximum corner of its bounding box
    # (views, 5) left, right, bottom and top on the screen of each view, whose middle is the origin of space, and the
    # bottom of what is at height zero below the mesh.
    seen: Float

    @property
    def centre(self) -> Float:
        """Middle of the bounding box."""
        return np.asarray((self.low + self.high) / 2)

    @property
    def side(self) -> float:
        """Longest side of the bounding box."""
        return float((self.high - self.low).max())

    def joined(self, other: Extent | None) -> Extent:
        """Return the extent of both."""
        if other is None:
            return self
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        nearer, farther = np.minimum(self.seen, other.seen), np.maximum(self.seen, other.seen)
        return Extent(low, high, np.where([True, False, True, False, True], nearer, farther))

    def rectangles(self, views: Sequence[View]) -> Float:
        """Return left, right, bottom and top ``(views, 4)`` of the mesh and of its shadow on the ground."""
        floors = [
            view.rows[1, 1] * self.low[1] + seen[4] for view, seen in zip(views, self.seen, strict=True)
        ]
        left, right, bottom, top, _ = self.seen.T
        return np.stack([left, right, np.minimum(bottom, floors), top], axis=1)


@dataclass(frozen=True, eq=False)
class Gathered:
    """The poses of a mesh."""

    poses: LargeArray  # (n, V, 3) as they were given
    still: Extent  # extent in space, in both views
    following: Extent  # extent relative to the mean of the vertices, on the ground, in both views
    views: tuple[View, View]  # (View, View) their own view, and that of the first mesh of the page
    # Whether they are seen as the first mesh is: they have its triangles, and about its place and size.
    like_first: bool


def gather(
    item: SceneItem,
    elapsed: Float,
    first: tuple[SequenceHeader, Gathered] | None,
    progress: Progress = silent,
    workers: Executor | None = None,
    camera: tuple[float, float] | None = None,
) -> Gathered:
    """Read the poses at times `elapsed` ``(n,)`` once; `first` are those of the page's first mesh, None for itself."""
    header = item.header
    same = first is None or np.array_equal(header.faces, first[0].faces)
    views: tuple[View, View] | None = None
    table: LargeArray | None = None
    still: Extent | None = None
    following: Extent | None = None
    done = 0
    for block in item.poses(elapsed, workers):
        check_block(header, block, done)
        if done + len(block) > len(elapsed):
            raise InvalidSequenceError(f"{item.name} has more poses than the {len(elapsed)} times asked for")
        if table is None or views is None:
            table = new_large_array((len(elapsed), header.vertex_count, 3), block.dtype)
            own = first[1].views[0] if first and same else _view(item, block[0], elapsed, camera)
            views = own, first[1].views[0] if first else own
        table[done : done + len(block)] = block
        done += len(block)
        world = y_up(block, header.up_axis)
        still = extent_of(world, views).joined(still)
        following = extent_of(world - path_of(world), views).joined(following)
        progress(done, len(elapsed), "decoding frames")
    if table is None or still is None or following is None or views is None or done < len(elapsed):
        raise InvalidSequenceError(f"{item.name} has {done} poses but {len(elapsed)} times were asked for")
    like_first = same and (first is None or _together(still, first[1].still))
    return Gathered(table, still, following, views, like_first)


def path_of(world: FloatArray) -> Float:
    """Return body places ``(B, 1, 3)`` in poses ``(B, V, 3)``, Y up: the mean of their vertices, on the ground."""
    return np.asarray(world.mean(axis=1, keepdims=True, dtype=np.float64) * [1, 0, 1])


def _view(item: SceneItem, start: FloatArray, elapsed: Float, camera: tuple[float, float] | None) -> View:
    """Return the view of a mesh from its first pose and its travel until the last of the times."""
    end = next(item.poses(elapsed[-1:]))[-1]
    return seen_from(np.stack([start, end]), item.header.up_axis, camera)


def extent_of(world: FloatArray, views: Sequence[View]) -> Extent:
    """Return the extent of poses ``(B, V, 3)``, Y up, in some views."""
    seen = []
    for view in views:
        right, up, _ = view.rows
        # sums in a fixed order: a page has the same bytes on every machine
        x, y, z = world[..., 0], world[..., 1], world[..., 2]
        across, flat = x * right[0] + z * right[2], x * up[0] + z * up[2]
        above = flat + y * up[1]
        seen.append([across.min(), across.max(), above.min(), above.max(), flat.min()])
    return Extent(world.min(axis=(0, 1)), world.max(axis=(0, 1)), np.array(seen))


def _together(one: Extent, other: Extent) -> bool:
    """Whether both are large enough in a common picture."""
    return one.joined(other).side <= TOGETHER * min(one.side, other.side)
