"""Meshes as one page that plays by itself: no network, no server, no other file.

The page plays poses at the times that they are given at, counted from each mesh's first one, and starts again after the
period, as films do (`mixseq.plots.video.timing`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore, block_size
from mixseq.mapping import Executor
from mixseq.plots.video.timing import model_times, nearest_frames
from mixseq.progress import Progress, silent
from mixseq.sequence import SequenceHeader
from mixseq.signals import Model
from mixseq.version import __version__
from mixseq.viewing.budget import Budget
from mixseq.viewing.exporting import Exported, ExportedItem
from mixseq.viewing.gathering import Gathered, gather
from mixseq.viewing.packing import Packer
from mixseq.viewing.streaming import pack
from mixseq.viewing.template import page_around_data, tags_around

__all__ = ["ExportReport", "ExportSettings", "Exported", "ExportedItem", "export_page", "poses_of"]


MOST_FRAMES = 20_000
"""More would be a slip of the rate: browsers hold the poses of all frames in memory."""


@dataclass(frozen=True)
class ExportSettings:
    """How a page is made.

    Parameters
    ----------
    fps : float, optional
        Poses per second; by default all that the meshes have.
    every : int
        Of those, only every so many are stored. The page moves points along straight lines between them.
    largest : float
        The file may have so many megabytes (:math:`10^6` bytes), the page itself among them.
    overlaid : bool
        Whether the meshes stand in one place at first, rather than side by side.
    title : str, optional
        Of the page, by default the names.

    Raises
    ------
    SettingsError
        If a setting is out of range.
    """

    fps: float | None = None
    every: int = 1
    largest: float = 200.0
    overlaid: bool = False
    title: str | None = None

    def __post_init__(self) -> None:
        for name, value in (("fps", self.fps), ("the largest size", self.largest)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise SettingsError(f"{name} is {value}; a positive number is expected")
        if self.every < 1:
            raise SettingsError(
                f"every {self.every} frames are wanted; give 1 for all of them, 2 for every other one"
            )


@dataclass(frozen=True)
class ExportReport:
    """What became of a page.

    Attributes
    ----------
    size : int
        Bytes of the file.
    items : tuple of ExportedItem
        Its meshes.
    """

    size: int
    items: tuple[ExportedItem, ...]


def poses_of(
    motion: Model | FrameStore, workers: Executor | None = None
) -> Callable[[Float], Iterable[FloatArray]]:
    """Return what `Exported.poses` asks for: a model is decoded at any time, of frames the nearest are taken."""

    def decoded(elapsed: Float) -> Iterator[FloatArray]:
        assert isinstance(motion, Model)
        yield from motion.blocks(model_times(motion.header, elapsed), workers=workers)

    def nearest(elapsed: Float) -> Iterator[FloatArray]:
        assert isinstance(motion, FrameStore)
        rows, size = nearest_frames(motion.header, elapsed), block_size(motion.header.vertex_count)
        for start in range(0, len(rows), size):
            yield motion.points[rows[start : start + size]]

    return decoded if isinstance(motion, Model) else nearest


def export_page(
    target: Path,
    items: Sequence[Exported],
    settings: ExportSettings | None = None,
    progress: Progress = silent,
) -> ExportReport:
    """Write a page that plays meshes.

    Poses are asked for once and kept in a temporary table, so memory does not grow with their number. Equal input makes
    equal bytes.

    Parameters
    ----------
    target : path
        The file, which is written as it comes: give a temporary one.
    items : sequence of Exported
        The meshes, from left to right.
    settings : ExportSettings, optional
        How.
    progress : callable, optional
        Told about every frame, twice: when it is there and when it is packed.

    Returns
    -------
    ExportReport
        How large it is, and how exact.

    Raises
    ------
    SettingsError
        If there is nothing to show, times do not increase, something has no colours, or the file would be larger than
        allowed.
    InvalidSequenceError
        If there are more or fewer poses than times, or poses of another mesh.
    OutputError
        If there is no room for temporary files.
    """
    chosen = settings or ExportSettings()
    if not items:
        raise SettingsError("there is nothing to show; give a sequence or a model")
    times = [_times(item, chosen) for item in items]
    description = {
        "title": chosen.title or ", ".join(item.name for item in items),
        "version": __version__,
        "overlaid": chosen.overlaid,
        "period": _period(items, times),
    }
    empty = sum(len(text.encode()) for text in page_around_data({**description, "items": []}))
    budget = Budget(sum(len(elapsed) for elapsed in times), chosen.largest, empty, progress)
    tops = _tops(items)
    first: tuple[SequenceHeader, Gathered] | None = None
    parts = []
    for item, elapsed in zip(items, times, strict=True):
        gathered = gather(item, elapsed, first, budget)
        first = first or (item.header, gathered)
        parts.append(pack(item, elapsed, gathered, tops, budget))
    described = {**description, "items": [part.description for part in parts]}
    size = _write(target, described, [stream for part in parts for stream in part.streams])
    return ExportReport(size, tuple(part.report for part in parts))


def _times(item: Exported, settings: ExportSettings) -> Float:
    """Return the times ``(n,)`` whose poses are stored."""
    elapsed = np.asarray(item.elapsed, dtype=np.float64).reshape(-1)
    if not (elapsed.size and np.isfinite(elapsed).all() and elapsed[0] >= 0 and (np.diff(elapsed) > 0).all()):
        raise SettingsError(f"the times of {item.name} are not numbers from zero on that increase")
    if not item.colourings:
        raise SettingsError(f"{item.name} has no colours; clay at least is needed")
    if settings.fps is not None:
        # the last one may be missed by what rounding does to times
        count = np.floor(elapsed[-1] * settings.fps + 1e-6) + 1
        _check_count(item, count)
        elapsed = np.minimum(np.arange(int(count)) / settings.fps, elapsed[-1])
    chosen = elapsed[:: settings.every]
    _check_count(item, len(chosen))
    return np.asarray(chosen)


def _check_count(item: Exported, count: float) -> None:
    if count > MOST_FRAMES:
        raise SettingsError(
            f"{item.name} would have {count:,.0f} frames, a page has at most {MOST_FRAMES:,}; give a lower --fps, or "
            "--every 2"
        )


def _period(items: Sequence[Exported], times: Sequence[Float]) -> float:
    """Return the seconds after which everything starts again: the longest one's, and one frame; 0 if nothing moves."""
    return max(
        float(item.elapsed[-1]) + 1 / item.header.fps if len(elapsed) > 1 else 0.0
        for item, elapsed in zip(items, times, strict=True)
    )


def _tops(items: Sequence[Exported]) -> dict[str, float]:
    """Return where the scale of each colouring ends: the same for all meshes."""
    tops: dict[str, float] = {}
    for item in items:
        for name, colouring in item.colourings.items():
            if not colouring.constant:
                tops[name] = max(tops.get(name, 0.0), colouring.top)
    return tops


def _write(target: Path, description: Mapping[str, Any], streams: Sequence[Packer]) -> int:
    before, after = page_around_data(description)
    with target.open("wb") as file:
        file.write(before.encode())
        for stream in streams:
            opening, closing = tags_around(stream)
            file.write(opening)
            file.writelines(stream.lines())
            file.write(closing)
        file.write(after.encode())
        return file.tell()
