"""A compressed mesh of a page: its streams, stored colours, and description.

Vertices are numbered for the smallest size, and texture coordinates and other undrawn data are left out. The page
computes strain and curvature; parts and errors are stored as palette entries.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.coding.bitstream.compressed_sequence import CompressedSequence
from mixseq.coding.encoder.compress import compress
from mixseq.coding.encoder.numbering import cheapest_numbering
from mixseq.frame_store import blocks_of
from mixseq.progress import Progress, silent
from mixseq.scene.camera import y_up
from mixseq.scene.colouring import Bytes, Colouring
from mixseq.scene.vertex_measures import MEASURES
from mixseq.sequence import SequenceHeader
from mixseq.surface import Surface
from mixseq.viewing.gathering import Extent, Gathered, PageItem
from mixseq.viewing.packing import deflated_rows
from mixseq_io.coded.packing import pack

STOP = 15
"""Step between stored colours of a palette of 256; the page interpolates between them."""

DIGITS = 5
"""Digits of places relative to the side of a mesh's box, the resolution of a screen."""


@dataclass(frozen=True)
class PageItemReport:
    """Report on a mesh in a page."""

    name: str  # what stands above it
    frames: int  # its poses
    # No vertex is farther from where it was, in diagonals of the bounding box of the first pose.
    max_error: float
    error: float  # the same in units of the mesh
    positions: int  # size of its mesh and motion in bytes, before conversion to text
    colours: int  # size of its colours in bytes, before conversion to text


@dataclass(frozen=True, eq=False)
class PageMesh:
    """A mesh in a page."""

    description: dict[str, Any]  # data for the page, ready for JSON
    data: list[bytes]  # the streams, and colours that are stored
    report: PageItemReport  # how exact it is, and how large


def page_mesh(
    shown: PageItem,
    elapsed: Float,
    gathered: Gathered,
    tops: Mapping[str, float],
    max_error: float,
    progress: Progress = silent,
) -> PageMesh:
    """Compress poses at `elapsed` ``(n,)`` within `max_error` diagonals; `tops` are ends of colour scales."""
    header = shown.mesh.header
    if shown.coded is None:
        centre = gathered.poses[:1][0].mean(axis=0, dtype=np.float64)
        coded, vertices = _compressed(header, elapsed, gathered, centre, max_error, progress)
    else:
        centre, vertices = np.zeros(3), np.arange(header.vertex_count)
        coded = _bare(shown.coded)
    container = pack(coded)
    colourings: list[dict[str, Any]] = []
    stored: list[bytes] = []
    for name, colouring in shown.colourings.items():
        description, data = _colours(colouring, tops.get(name, 1.0), elapsed, gathered, vertices)
        colourings.append(description if data is None else {**description, "data": 1 + len(stored)})
        stored += [] if data is None else [data]
    parameters, own = coded.parameters, _own_times(coded.header, elapsed)
    error = parameters.max_error * parameters.diagonal
    description = {
        "name": shown.mesh.name,
        "coding": container.text.decode("ascii"),
        "times": None if own else np.round(elapsed, 9).tolist(),
        "start": float(header.times[0]),
        "fps": header.fps,
        "centre": y_up(centre, header.up_axis).tolist(),
        "likeFirst": gathered.like_first,
        "azimuth": gathered.views[0].azimuth,
        "elevation": gathered.views[0].elevation,
        "still": _extent(gathered.still, gathered),
        "following": _extent(gathered.following, gathered),
        "error": float(f"{error:.3g}"),
        "colourings": colourings,
        "signals": shown.signals,
    }
    sizes = len(container.streams), sum(map(len, stored))
    report = PageItemReport(shown.mesh.name, len(elapsed), parameters.max_error, error, *sizes)
    return PageMesh(description, [container.streams, *stored], report)


@dataclass(frozen=True, eq=False)
class _Centred:
    """Gathered poses as a sequence around the origin, as the page computes in single precision."""

    header: SequenceHeader
    gathered: Gathered
    centre: Float

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Yield blocks of points ``(B, V, 3)``."""
        poses = self.gathered.poses
        for start in range(0, len(poses), size):
            yield poses[start : start + size].astype(np.float64) - self.centre


def _compressed(
    header: SequenceHeader,
    elapsed: Float,
    gathered: Gathered,
    centre: Float,
    max_error: float,
    progress: Progress,
) -> tuple[CompressedSequence, Index]:
    """Return compressed poses, and the original index of every vertex."""
    regular, rate = _regular(elapsed, header.fps)
    plain = replace(header.with_times(regular, rate), surface=Surface(), name="")
    numbering = cheapest_numbering(plain, "free")
    frames = numbering.of_frames(_Centred(plain, gathered, centre))
    return compress(frames, max_error=max_error, progress=progress, uvs=False), numbering.vertices


def _regular(elapsed: Float, fps: float) -> tuple[Float, float]:
    """Return times at a constant rate, which take no bytes, if they have one; else unchanged."""
    if len(elapsed) > 1:
        rate = (len(elapsed) - 1) / float(elapsed[-1])
        times = np.arange(len(elapsed)) / rate
        if np.allclose(times, elapsed, rtol=0, atol=1e-6 / rate):
            return times, rate
    return elapsed, fps


def _bare(coded: CompressedSequence) -> CompressedSequence:
    parameters = replace(coded.parameters, uv_steps=None, uv_error=None)
    return replace(coded, header=replace(coded.header, surface=Surface(), name=""), parameters=parameters)


def _own_times(header: SequenceHeader, elapsed: Float) -> bool:
    """Whether the poses of a page are the frames of the compressed sequence."""
    own = header.times - header.times[0]
    return len(own) == len(elapsed) and np.allclose(own, elapsed, rtol=0, atol=1e-6 / header.fps)


def _extent(extent: Extent, gathered: Gathered) -> dict[str, Any]:
    digits = DIGITS - int(np.ceil(np.log10(extent.side or 1.0)))
    low, high, seen = (
        np.round(each, digits).tolist()
        for each in (extent.low, extent.high, extent.rectangles(gathered.views))
    )
    return {"low": low, "high": high, "seen": seen}


# Colours --------------------------------------------------------------------------------------------------


def _colours(
    colouring: Colouring, top: float, elapsed: Float, gathered: Gathered, vertices: Index
) -> tuple[dict[str, Any], bytes | None]:
    """Return the description of a colouring for a page, and its stored data."""
    if not colouring.constant:
        palette = colouring.palette[::STOP]
        scaled = {"name": colouring.name, "palette": palette.tolist(), "top": top, "unit": colouring.unit}
        if colouring.name in MEASURES:
            return scaled, None
        return scaled, deflated_rows(_rows(colouring.scaled(top), elapsed, gathered, vertices))
    entries = colouring.indices(gathered.poses[:1][0], 0.0)
    used, places = np.unique(entries, return_inverse=True)
    fixed = {"name": colouring.name, "palette": colouring.palette[used].tolist()}
    if len(used) == 1:
        return fixed, None
    return fixed, deflated_rows([places.astype(np.uint8)[vertices]])


def _rows(colouring: Colouring, elapsed: Float, gathered: Gathered, vertices: Index) -> Iterator[Bytes]:
    times = iter(elapsed.tolist())
    for block in blocks_of(gathered.poses):
        for pose in block:
            yield colouring.indices(pose, next(times))[vertices]
