"""Export meshes as a single self-contained page that plays without network or server.

Meshes are compressed by `mixseq.compress` and decoded by `mixseq.web`. Each pose is shown at its elapsed time since the
first frame of its mesh. Playback repeats after the period, as in films (`mixseq.pictures.scene`).

A page is a small document that unpacks its own data, a list of streams. The first, deflated stream holds style, body,
decoder, scripts and description, separated by NUL. Other streams hold meshes. `export_data` encodes them as text.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.errors import SettingsError
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, StagedProgress, log_progress
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float
from mixseq.version import __version__
from mixseq.viewer.export_data import (
    BYTE_ORDER_MARK,
    PAGE_ENCODING,
    PageItem,
    PageItemReport,
    PagePoses,
    collect_poses,
    encode_mesh,
    encode_text,
)
from mixseq.viewer.page import CHART_SCRIPTS, read_script
from mixseq.web import PAGE_SCRIPTS, bundled, minify

PLAYER_SCRIPTS = (*PAGE_SCRIPTS, "topology.js", "pose_source.js", "player.js")
"""Scripts of the mesh player."""


def page_text(description: Mapping[str, Any], data: Sequence[bytes]) -> bytes:
    """Return the bytes of a page from the description and the data of its meshes."""
    has_charts = any(item["signals"] for item in description["items"])
    sections = (
        _minify(read_script("page.css") + read_script("player.css")),
        _minify(read_script("player.html")),
        decoder_script(),
        page_scripts(has_charts),
        json.dumps(description, ensure_ascii=False, allow_nan=False, separators=(",", ":")),
    )
    code = zlib.compress("\0".join(sections).encode(), 9)
    title, loader = escape(description["title"]), minify(read_script("loader.js"))
    document = _minify(read_script("page.html")).replace("<title>mixseq</title>", f"<title>{title}</title>")
    before, after = document.replace('<script src="loader.js"></script>', f"<script>{loader}</script>").split(
        _DATA_PLACEHOLDER
    )
    page = [BYTE_ORDER_MARK, before.encode(PAGE_ENCODING)]
    for stream in (code, *data):
        opened, closed = f'<script type="text/plain" data-size="{len(stream)}">', "</script>\n"
        page += [opened.encode(PAGE_ENCODING), encode_text(stream), closed.encode(PAGE_ENCODING)]
    return b"".join([*page, after.encode(PAGE_ENCODING)])


@cache
def decoder_script() -> str:
    """Return the script that decodes streams to poses, in a worker or in the page."""
    scripts = ("normals.js", "topology.js", "measures.js", "poses.js")
    decoder = re.sub(r"^export const ?{.*}=(\w+);$", r"return \1;", bundled(), flags=re.MULTILINE)
    return f"var mixseqDecoder = (() => {{\n{decoder}}})();\n" + "".join(minify(read_script(name)) for name in scripts)


@cache
def page_scripts(has_charts: bool) -> str:
    """Return the scripts of a page, with or without charts."""
    names = (*(CHART_SCRIPTS if has_charts else ()), *PLAYER_SCRIPTS)
    return "".join(minify(read_script(name)) for name in names)


_DATA_PLACEHOLDER = "<!-- data -->"


def _minify(text: str) -> str:
    """Remove indentation and comments from HTML or CSS, but keep the comment that marks the place of the data."""
    return re.sub(r"\n\s*", "\n", re.sub(r"<!--(?! data).*?-->|/\*.*?\*/", "", text))


MAX_PAGE_FRAMES = 20_000
"""Largest number of frames of a mesh; a larger number indicates a wrong frame rate."""


@dataclass(frozen=True)
class ExportSettings:
    """Settings of a page."""

    fps: float | None = None  # poses per second, by default the frame rate of each mesh
    every: int = 1  # step between stored poses; the page plays a spline through them
    max_error: float = 1e-3  # bound of vertex errors, in diagonals; compressed meshes keep their own bounds
    inbetweens: bool = True  # whether to fit a model to poses, whose motion between them the page shows
    overlaid: bool = False  # whether meshes are initially overlaid, instead of side by side
    title: str | None = None  # title of the page, by default the names of the meshes
    camera: tuple[float, float] | None = None  # initial view, see `mixseq.pictures.scene.resolve_view`
    following: bool = False  # whether the camera initially follows moving bodies

    def __post_init__(self) -> None:
        for name, value in (("fps", self.fps), ("max_error", self.max_error)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise SettingsError(f"{name} is {value}; a positive number is expected")
        if self.every < 1:
            raise SettingsError(
                f"every {self.every} frames cannot be stored; give 1 for all frames, 2 for every other one"
            )


def export_page(
    target: Path,
    items: Sequence[PageItem],
    settings: ExportSettings | None = None,
    progress: Progress = log_progress,
    workers: Executor | None = None,
) -> list[PageItemReport]:
    """Write a page that plays meshes, and return a report on each; equal input gives a page of equal bytes."""
    settings = settings or ExportSettings()
    if not items:
        raise SettingsError("there is no mesh to show; give a sequence or a model")
    times = [_times(item, settings) for item in items]
    tops = _tops(items)
    stages = StagedProgress(progress, 2 * len(items), 100)
    first: tuple[SequenceHeader, PagePoses] | None = None
    meshes = []
    for number, (item, elapsed) in enumerate(zip(items, times, strict=True)):
        page_poses = collect_poses(item.mesh, elapsed, first, stages.at(2 * number), workers, settings.camera)
        first = first or (item.mesh.header, page_poses)
        stage = stages.at(2 * number + 1)
        meshes.append(encode_mesh(item, elapsed, page_poses, tops, settings.max_error, settings.inbetweens, stage))
        stage(1, 1, "compressing")
    descriptions, data, reports = zip(*meshes, strict=True)
    description = {
        "title": settings.title or ", ".join(item.mesh.name for item in items),
        "version": __version__,
        "overlaid": settings.overlaid,
        "following": settings.following,
        "period": _period(items, times),
        "items": descriptions,
    }
    target.write_bytes(page_text(description, list(chain.from_iterable(data))))
    return list(reports)


def _times(item: PageItem, settings: ExportSettings) -> Float:
    """Return the elapsed times ``(n,)`` of stored poses."""
    elapsed = np.asarray(item.mesh.elapsed, dtype=np.float64).reshape(-1)
    if not (elapsed.size and np.isfinite(elapsed).all() and elapsed[0] >= 0 and (np.diff(elapsed) > 0).all()):
        raise SettingsError(f"the times of {item.mesh.name} do not increase from zero; give it regular frame times")
    if not item.colourings:
        raise SettingsError(f"{item.mesh.name} has no colouring; give it one, such as clay")
    if settings.fps is not None:
        rate = snap_to_ntsc(settings.fps)
        # The tolerance prevents rounding from removing the last frame.
        count = np.floor(elapsed[-1] * rate + 1e-6) + 1
        _check_count(item, count)
        elapsed = np.minimum(np.arange(int(count)) / rate, elapsed[-1])
    stored = elapsed[:: settings.every]
    _check_count(item, len(stored))
    return np.asarray(stored)


def _check_count(item: PageItem, count: float) -> None:
    if count > MAX_PAGE_FRAMES:
        raise SettingsError(
            f"{item.mesh.name} would have {count:,.0f} frames, a page at most {MAX_PAGE_FRAMES:,}; give a lower "
            "--fps, or --every 2"
        )


def _period(items: Sequence[PageItem], times: Sequence[Float]) -> float:
    """Return the period in seconds: the duration of the longest mesh plus one frame, or 0 if all meshes are still."""
    return max(
        float(item.mesh.elapsed[-1]) + 1 / item.mesh.header.fps if len(elapsed) > 1 else 0.0
        for item, elapsed in zip(items, times, strict=True)
    )


def _tops(items: Sequence[PageItem]) -> dict[str, float]:
    """Return, for each colouring, the upper end of the colour scale that all meshes share."""
    tops: dict[str, float] = {}
    for item in items:
        for name, colouring in item.colourings.items():
            if not colouring.is_constant:
                tops[name] = max(tops.get(name, 0.0), colouring.top)
    return tops
