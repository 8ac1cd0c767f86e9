r"""A mesh of a page: its poses gathered, then packed as integers.

Positions are stored in 16 bits. Of poses :math:`x_{tv}` in a box with the middle c and the longest side a,

.. math::
    q_{tv} = \left[ (x_{tv} - c) / s \right] \in [-32767, 32767]^3, \qquad s = a / 65534,

with :math:`[\cdot]` the nearest integers, so that no coordinate is off by more than s / 2. Numbers that colours show
are stored in 8 bits, as places in a palette (`mixseq.viewing.colouring`). `packing` makes text of both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.plots.camera import View, broadside, y_up
from mixseq.progress import Progress
from mixseq.sequence import FloatArray, SequenceHeader, check_block
from mixseq.stored import blocks_of
from mixseq.table import Table, new_table
from mixseq.viewing.framing import Extent, extent_of
from mixseq.viewing.packing import Packer, Unsigned

if TYPE_CHECKING:
    from mixseq.viewing.colouring import Colouring

Float = NDArray[np.float64]

FARTHEST = 32767
"""The largest of the integers that stand for positions."""


@dataclass(frozen=True, eq=False)
class Exported:
    """A mesh in a page.

    Attributes
    ----------
    name : str
        What stands above it.
    header : SequenceHeader
        Everything but the points.
    poses : callable
        Takes times ``(n,)`` as `elapsed` has them, yields points ``(B, V, 3)`` in blocks; see `poses_of`.
    elapsed : (n,) float64
        Times that have poses, in seconds since the first of them; increasing.
    colourings : mapping of str to Colouring
        What colours may show, the first one first.
    signals : mapping, optional
        The signals of a model, for its charts (`mixseq.viewing.signals.signals_of`).
    """

    name: str
    header: SequenceHeader
    poses: Callable[[Float], Iterable[FloatArray]]
    elapsed: Float
    colourings: Mapping[str, Colouring]
    signals: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class ExportedItem:
    """What became of a mesh in a page.

    Attributes
    ----------
    name : str
        What stands above it.
    frames : int
        Stored poses.
    error : float
        No coordinate is off by more, in units of the mesh.
    positions, colours : int
        Characters of the file that its positions and its colours take.
    """

    name: str
    frames: int
    error: float
    positions: int
    colours: int


class Budget:
    """How much has been written, and how far the work is."""

    def __init__(self, frames: int, largest: float, progress: Progress) -> None:
        self._frames, self._largest, self._progress = frames, largest, progress
        self._gathered = self._packed = self._size = 0

    def gathered(self, frames: int) -> None:
        """Tell that there are so many more frames."""
        self._gathered += frames
        self._progress(self._gathered + self._packed, 2 * self._frames, "decoding frames")

    def packed(self, frames: int, size: int) -> None:
        """Tell that so many more frames made so many more characters.

        Raises
        ------
        SettingsError
            If there are too many.
        """
        self._packed, self._size = self._packed + frames, self._size + size
        if self._size > 1e6 * self._largest:
            expected = self._size / max(self._packed, 1) * self._frames / 1e6
            raise SettingsError(
                f"the page would have about {expected:.3g} MB, more than {self._largest:g} MB; take fewer frames "
                "(--every 2, or a lower --fps) or fewer meshes, or allow more with --largest"
            )
        self._progress(self._gathered + self._packed, 2 * self._frames, "packing frames")


@dataclass(frozen=True, eq=False)
class Gathered:
    """The poses of a mesh.

    Attributes
    ----------
    poses : (n, V, 3) table
        As they were given.
    extent : Extent
        Where they are, from their own view and from that of the first mesh of the page.
    views : (View, View)
        Their own view, and that of the first mesh of the page.
    like_first : bool
        Whether they have the triangles of the first mesh, and so its view.
    """

    poses: Table
    extent: Extent
    views: tuple[View, View]
    like_first: bool


def gather(
    item: Exported, elapsed: Float, first: tuple[SequenceHeader, View] | None, budget: Budget
) -> Gathered:
    """Ask for the poses of a mesh once.

    Parameters
    ----------
    item : Exported
        The mesh.
    elapsed : (n,) float64
        Times of its poses.
    first : (SequenceHeader, View), optional
        The first mesh of the page; None for itself.
    budget : Budget
        Told about all frames.

    Raises
    ------
    InvalidSequenceError
        If there are more or fewer poses than times, or poses of another mesh.
    """
    header = item.header
    like_first = first is None or np.array_equal(header.faces, first[0].faces)
    views: tuple[View, View] | None = None
    table: Table | None = None
    extent: Extent | None = None
    done = 0
    for block in item.poses(elapsed):
        check_block(header, block, done)
        if done + len(block) > len(elapsed):
            raise InvalidSequenceError(f"{item.name} has more poses than the {len(elapsed)} times asked for")
        if table is None or views is None:
            table = new_table((len(elapsed), header.vertex_count, 3), block.dtype)
            own = first[1] if first and like_first else broadside(block[0], header.up_axis)
            views = own, first[1] if first else own
        table[done : done + len(block)] = block
        done += len(block)
        extent = extent_of(y_up(block, header.up_axis), views).joined(extent)
        budget.gathered(len(block))
    if table is None or extent is None or views is None or done < len(elapsed):
        raise InvalidSequenceError(f"{item.name} has {done} poses but {len(elapsed)} times were asked for")
    return Gathered(table, extent, views, like_first)


@dataclass(frozen=True, eq=False)
class Packed:
    """A mesh in a page.

    Attributes
    ----------
    description : dict
        What the page must know, as JSON takes it.
    streams : list of Packer
        Triangles, positions, and each of the colourings.
    report : ExportedItem
        What is told of it.
    """

    description: dict[str, Any]
    streams: list[Packer]
    report: ExportedItem


def pack(
    item: Exported,
    elapsed: Float,
    gathered: Gathered,
    tops: Mapping[str, float],
    budget: Budget,
) -> Packed:
    """Pack the poses of `gather`, with scales of colours that end at `tops`.

    Raises
    ------
    SettingsError
        If the page becomes too large.
    """
    header, poses, extent, views = item.header, gathered.poses, gathered.extent, gathered.views
    step = (extent.side or 1.0) / (2 * FARTHEST)
    count = header.vertex_count
    colourings = [
        colouring if colouring.constant else colouring.scaled(tops[name])
        for name, colouring in item.colourings.items()
    ]
    faces, positions = Packer(3 * len(header.faces), np.uint32), Packer(3 * count, np.uint16)
    colours = [Packer(count, np.uint8) for _ in colourings]
    faces.add(header.faces.reshape(1, -1).astype(np.uint32))
    for colouring, packer in zip(colourings, colours, strict=True):
        if colouring.constant:
            packer.add(colouring.indices(poses[0:1][0], 0.0)[None])
    packers, size, done = [faces, positions, *colours], 0, 0
    for block in blocks_of(poses):
        positions.add(integers(y_up(block, header.up_axis), extent.centre, step))
        at = elapsed[done : done + len(block)].tolist()
        for colouring, packer in zip(colourings, colours, strict=True):
            if not colouring.constant:
                packer.add(
                    np.stack([colouring.indices(pose, time) for pose, time in zip(block, at, strict=True)])
                )
        done += len(block)
        now = sum(packer.size for packer in packers)
        budget.packed(len(block), now - size)
        size = now
    for packer in packers:
        packer.finish()
    budget.packed(0, sum(packer.size for packer in packers) - size)
    description = {
        "name": item.name,
        "vertices": count,
        "triangles": len(header.faces),
        "times": np.round(elapsed, 9).tolist(),
        "centre": extent.centre.tolist(),
        "step": step,
        "low": extent.low.tolist(),
        "high": extent.high.tolist(),
        "likeFirst": gathered.like_first,
        "azimuth": views[0].azimuth,
        "elevation": views[0].elevation,
        "seen": extent.rectangles(views).tolist(),
        "colourings": [
            {
                "name": colouring.name,
                "palette": colouring.palette.reshape(-1).tolist(),
                "constant": colouring.constant,
                "top": colouring.top,
                "unit": colouring.unit,
            }
            for colouring in colourings
        ],
        "signals": item.signals,
    }
    report = ExportedItem(item.name, done, step / 2, positions.size, sum(packer.size for packer in colours))
    return Packed(description, packers, report)


def integers(world: FloatArray, centre: Float, step: float) -> Unsigned:
    """Return :math:`q` of poses ``(B, V, 3)`` as rows ``(B, 3 V)`` of uint16: all x, then all y, then all z."""
    places = np.clip(np.rint((world - centre) / step), -FARTHEST, FARTHEST).astype(np.int16)
    return places.transpose(0, 2, 1).reshape(len(world), -1).view(np.uint16)
