r"""PC2 point caches (3ds Max, Blender, Maya): all frames in one binary file, the mesh beside it.

Little-endian throughout:

=======================  ===========================================================
``"POINTCACHE2\0"``       12 bytes
version                  int32, 1
number of points         int32
first frame              float32
frames between samples   float32
number of samples        int32
points                   float32, x, y, z of all points, sample after sample
=======================  ===========================================================

Times are evenly spaced frame numbers; `fps`, missing in the file, converts them to seconds. PC2 has no place for
uneven times, units, the up axis and velocities; see `mixseq_io.pointcache.cache` for the mesh.

Specification: http://www.footools.com/plugins/docs/PointCache2_README.html
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray
from mixseq.errors import SettingsError
from mixseq.sequence import DEFAULT_FPS, SequenceHeader
from mixseq_io.pointcache.cache import Layout, MeshPath, Timing, open_cache, write_cache
from mixseq_io.reader import SequenceReader

_MAGIC = b"POINTCACHE2\0"
_START = struct.Struct("<12siiffi")
_FRAME_ERROR = 1e-3
"""Largest unreported error of a time, in frames."""


def open_pc2(path: Path, mesh: MeshPath = None, fps: float = DEFAULT_FPS) -> SequenceReader:
    """Open a PC2 file."""
    if not (np.isfinite(fps) and fps > 0):
        raise SettingsError(f"fps is {fps}; a positive number is expected")

    def read_start(file: IO[bytes]) -> tuple[Layout, Timing]:
        start = file.read(_START.size)
        if len(start) < _START.size or not start.startswith(_MAGIC):
            raise ValueError("it does not begin with POINTCACHE2 and a header")
        _, version, points, first, step, samples = _START.unpack(start)
        if version != 1:
            raise ValueError(f"its version is {version}, not 1")
        layout = Layout(_START.size, samples, points, "<")
        layout.check_size(file)
        with np.errstate(all="ignore"):
            return layout, Timing(_seconds(first, step, samples, fps), fps)

    return open_cache(path, "PC2", mesh, read_start)


def write_pc2(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
) -> None:
    """Write a PC2 file, and its mesh beside it; parameters and errors are those of `write_cache`."""
    frames = header.times * header.fps
    first, step = np.float32(frames[0]), np.float32(1)
    lost = []
    if header.frame_count > 1:
        step = np.float32((frames[-1] - frames[0]) / (header.frame_count - 1))
        even = _seconds(float(first), float(step), header.frame_count, 1.0)
        if np.abs(even - frames).max() > _FRAME_ERROR:
            lost.append("uneven times (they are written as if they were even)")
        if header.fps != DEFAULT_FPS:
            lost.append(f"{header.fps:g} frames per second (read it with fps={header.fps:g})")
    start = _START.pack(_MAGIC, 1, header.vertex_count, first, step, header.frame_count)
    write_cache(path, "PC2", header, blocks, velocities, start, "<", lost)


def _seconds(first: float, step: float, count: int, fps: float) -> NDArray[np.float64]:
    return (first + np.arange(count, dtype=np.float64) * step) / fps
