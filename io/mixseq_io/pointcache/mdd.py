"""MDD point caches (LightWave, Blender, Modo): all frames in one binary file, the mesh beside it.

Big-endian throughout:

=================  ===========================================================
number of frames   int32
number of points   int32
times              float32, seconds, one per frame
points             float32, x, y, z of all points, frame after frame
=================  ===========================================================

The frame rate is that of the median step. Times that are whole frames within float32 rounding become exactly that, in
float64. MDD has no place for units, the up axis and velocities; see `mixseq_io.pointcache.cache` for the mesh.

Specification: http://rodolphe-vaillant.fr/?e=134
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray
from mixseq.errors import InvalidSequenceError
from mixseq.sequence import SequenceHeader
from mixseq_io.key_times import on_grid
from mixseq_io.pointcache.cache import Layout, MeshPath, Timing, open_cache, write_cache
from mixseq_io.reader import SequenceReader

_START = struct.Struct(">ii")
_STEP_ERROR = 1e-2
"""Relative error of a single step between rounded times."""
_RATE_ERROR = 2e-4
"""Relative error of a rate from rounded times; less than the gap between 24 and 23.976."""


def open_mdd(path: Path, mesh: MeshPath = None) -> SequenceReader:
    """Open an MDD file; parameters and errors are those of `mixseq_io.pointcache.cache.open_cache`."""
    return open_cache(path, "MDD", mesh, _read_start)


def _read_start(file: IO[bytes]) -> tuple[Layout, Timing]:
    start = file.read(_START.size)
    if len(start) < _START.size:
        raise ValueError("it has no header")
    frames, points = _START.unpack(start)
    layout = Layout(_START.size + 4 * frames, frames, points, ">")
    layout.check_size(file)
    times = np.frombuffer(file.read(4 * frames), ">f4").astype(np.float64)
    rate = _rate(times)
    return layout, Timing(on_grid(times, rate) if rate else times, rate)


def _rate(times: NDArray[np.float64]) -> float | None:
    """Return the frame rate of float32 times ``(T,)``, a whole or NTSC rate if it is near enough; None if unknown."""
    step = float(np.quantile(np.diff(times), 0.5, method="lower")) if times.size > 1 else 0.0
    if not (np.isfinite(step) and step > 0):
        return None
    span = float(times[-1] - times[0])
    if not (np.isfinite(span) and span > 0):
        return None  # non-increasing times are reported where they are used
    overall = (
        max(1, round(span / step)) / span
    )  # more exact than one step, which is rounded, if steps are even
    rate = overall if abs(overall * step - 1) < _STEP_ERROR else 1 / step
    for candidate in (round(rate), round(rate * 1.001) / 1.001):
        if abs(candidate - rate) <= _RATE_ERROR * rate:
            return float(candidate)
    return rate


def write_mdd(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
) -> None:
    """Write an MDD file, and its mesh beside it; parameters and errors are those of `write_cache`."""
    times = header.times.astype(np.float32)
    together = np.flatnonzero(np.diff(times) <= 0)
    if together.size:
        raise InvalidSequenceError(
            f"frames {together[0]} and {together[0] + 1} are both at {times[together[0]]:.9g} s in float32, which MDD "
            "stores; write .npz or .h5"
        )
    rate = _rate(times.astype(np.float64))
    same = rate is None or abs(rate - header.fps) <= _RATE_ERROR * header.fps
    lost = [] if same else [f"{header.fps:g} frames per second"]
    start = _START.pack(header.frame_count, header.vertex_count) + times.astype(">f4").tobytes()
    write_cache(path, "MDD", header, blocks, velocities, start, ">", lost)
