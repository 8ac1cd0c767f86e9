"""The frames of a film: panels side by side, each with a mesh and its name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from mixseq.arrays import Float
from mixseq.plots.raster import Picture, render_mesh
from mixseq.plots.video.backdrop import Rectangle
from mixseq.scene.camera import Camera, y_up
from mixseq.scene.colouring import Bytes, Colouring
from mixseq.scene.items import DecodedItem
from mixseq.sequence import SequenceHeader

HEAT_CONTRAST = 0.25
"""Strength of the shading under measured colours, as on paper."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel of a film."""

    header: SequenceHeader  # the mesh
    colours: ArrayLike  # (3,) RGB in 0..1 of the mesh or of each face, where nothing is measured
    camera: Camera  # from where, in the proportions of the panel
    place: Rectangle  # where it is in the picture


@dataclass(frozen=True, eq=False)
class Layout:
    """The static data of all frames of a film."""

    panels: Sequence[Panel]  # from left to right, and down
    backdrop: Picture  # (H, W, 3) what does not change: names and the colour bar
    frames: int  # number of frames N
    palette: Float | None = None  # (256, 3) colours of what is measured, RGB in 0..1


Moment = tuple[int, list[tuple[Float, Bytes | None]]]
"""A frame number, and for each mesh its points ``(V, 3)`` and, if measured, palette entries ``(V,)``."""


def moments(
    items: Sequence[DecodedItem], colourings: Sequence[Colouring], times: Float, frames: Iterable[int]
) -> Iterator[Moment]:
    """Yield the data of film frames at times ``(N,)``."""
    for frame in frames:
        seen: list[tuple[Float, Bytes | None]] = []
        for item, colouring in zip(items, colourings, strict=True):
            points = item.pose(frame)
            entries = None if colouring.constant else colouring.indices(points, float(times[frame]))
            seen.append((points, entries))
        yield frame, seen


def draw_moment(layout: Layout, moment: Moment) -> Picture:
    """Draw a frame of a film ``(H, W, 3)``."""
    frame, seen = moment
    picture = layout.backdrop.copy()
    for panel, (points, entries) in zip(layout.panels, seen, strict=True):
        faces, camera = panel.header.faces, panel.camera
        colours, contrast = panel.colours, 1.0
        if entries is not None and layout.palette is not None:
            colours, contrast = layout.palette[entries[faces]], HEAT_CONTRAST
        centre = camera.centres[frame]
        world = y_up(points, panel.header.up_axis) - centre
        view = camera.at(frame)
        ground = float(camera.ground - centre[1])
        render_mesh(picture[panel.place], world, faces, view, camera.limits, colours, ground, contrast)
    return picture
