r"""A mesh of a page as streams of integers.

Positions are stored in 16 bits. Of poses :math:`x_{tv}` in a box with the middle c and the longest side a,

.. math::
    q_{tv} = \left[ (x_{tv} - c) / s \right] \in [-32767, 32767]^3, \qquad s = a / 65534,

with :math:`[\cdot]` the nearest integers, so that no coordinate is off by more than s / 2. Numbers that colours show
are stored in 8 bits, as places in a palette (`mixseq.scene.colouring`). `packing` makes text of both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.frame_store import blocks_of
from mixseq.scene.camera import y_up
from mixseq.scene.colouring import Colouring
from mixseq.viewing.budget import Budget
from mixseq.viewing.gathering import Gathered, PageItem
from mixseq.viewing.packing import Packer, Unsigned
from mixseq.viewing.template import script_json, tags_around

FARTHEST = 32767
"""The largest of the integers that stand for positions."""


@dataclass(frozen=True)
class PageItemReport:
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


@dataclass(frozen=True, eq=False)
class Packed:
    """A mesh in a page.

    Attributes
    ----------
    description : dict
        What the page must know, as JSON takes it.
    streams : list of Packer
        Triangles, positions, and each of the colourings.
    report : PageItemReport
        How exact it is, and how large.
    """

    description: dict[str, Any]
    streams: list[Packer]
    report: PageItemReport


def pack(
    shown: PageItem,
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
    item, header, extent = shown.mesh, shown.mesh.header, gathered.extent
    step = (extent.side or 1.0) / (2 * FARTHEST)
    colourings = [
        colouring if colouring.constant else colouring.scaled(tops[name])
        for name, colouring in shown.colourings.items()
    ]
    description = _description(shown, elapsed, gathered, step, colourings)
    faces, positions = Packer(3 * len(header.faces), np.uint32), Packer(3 * header.vertex_count, np.uint16)
    colours = [Packer(header.vertex_count, np.uint8) for _ in colourings]
    packers = [faces, positions, *colours]
    budget.described(len(script_json(description).encode()) + len(", "))
    faces.add(header.faces.reshape(1, -1).astype(np.uint32))
    for colouring, packer in zip(colourings, colours, strict=True):
        if colouring.constant:
            packer.add(colouring.indices(gathered.poses[0:1][0], 0.0)[None])
    size = done = 0
    for block in blocks_of(gathered.poses):
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
    budget.described(sum(len(text) for packer in packers for text in tags_around(packer)))
    report = PageItemReport(item.name, done, step / 2, positions.size, sum(packer.size for packer in colours))
    return Packed(description, packers, report)


def _description(
    shown: PageItem, elapsed: Float, gathered: Gathered, step: float, colourings: Sequence[Colouring]
) -> dict[str, Any]:
    item, extent, views = shown.mesh, gathered.extent, gathered.views
    return {
        "name": item.name,
        "vertices": item.header.vertex_count,
        "triangles": len(item.header.faces),
        "times": np.round(elapsed, 9).tolist(),
        "start": float(item.header.times[0]),
        "fps": item.header.fps,
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
        "signals": shown.signals,
    }


def integers(world: FloatArray, centre: Float, step: float) -> Unsigned:
    """Return :math:`q` of poses ``(B, V, 3)`` as rows ``(B, 3 V)`` of uint16: all x, then all y, then all z."""
    places = np.clip(np.rint((world - centre) / step), -FARTHEST, FARTHEST).astype(np.int16)
    return places.transpose(0, 2, 1).reshape(len(world), -1).view(np.uint16)
