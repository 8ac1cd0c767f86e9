"""Sequences with random access: in memory, or copied to a temporary array while they are read once.

Files are read sequentially and often slowly, while fitting needs several passes and single frames. Streams are copied
once; all later work is the same for both.

Limits of double precision: as squared lengths are multiplied, meshes must be between `SMALLEST` and `LARGEST`. Small
errors vanish beside large coordinates: `digits_end`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import FloatArray
from mixseq.disk_array import LargeArray, new_large_array
from mixseq.errors import InvalidSequenceError
from mixseq.progress import Progress, silent
from mixseq.sequence import Frames, MeshSequence, SequenceHeader, bounding_diagonal, check_block

_AT_ONCE = 8, 1 << 20  # frames, and vertices, in a block: at most 24 MB of float64, unless one frame is more

SMALLEST, LARGEST = 1e-60, 1e60
"""Bounds of the diagonal of the first frame, and of coordinates, in the units of the sequence."""

_LAST_DIGITS = 2.0**-40
"""Largest relative error of a coordinate in computations without cancellation."""


@dataclass(frozen=True, eq=False)
class FrameStore:
    """A sequence with random access to its points."""

    header: SequenceHeader  # everything but the points
    points: LargeArray  # (T, V, 3) the points


def frame_store(frames: Frames, progress: Progress = silent) -> FrameStore:
    """Return a sequence with random access to its points, a copy unless it is in memory."""
    store = (
        FrameStore(frames.header, frames.points)
        if isinstance(frames, MeshSequence)
        else _copied(frames, progress)
    )
    _check_lengths(store)
    return store


def _copied(frames: Frames, progress: Progress) -> FrameStore:
    header = frames.header
    count, done = header.frame_count, 0
    array: LargeArray | None = None
    for block in frames.blocks(block_size(header.vertex_count)):
        check_block(header, block, done)
        if array is None:
            array = new_large_array((count, header.vertex_count, 3), block.dtype)
        if done + len(block) > count:
            raise InvalidSequenceError(
                f"there are more frames than the {count} times; give one time per frame"
            )
        array[done : done + len(block)] = block
        done += len(block)
        progress(done, count, "reading frames")
    if array is None or done < count:
        raise InvalidSequenceError(f"{done} frames of points but {count} times; give one time per frame")
    return FrameStore(header, array)


def _check_lengths(store: FrameStore) -> None:
    name, points = store.header.name, store.points
    diagonal = bounding_diagonal(points[:1][0])
    cure = f"from {SMALLEST:g} to {LARGEST:g} is expected; scale it, in the program it comes from"
    if diagonal and not SMALLEST <= diagonal <= LARGEST:
        raise InvalidSequenceError(
            f"{name!r}: the mesh is {diagonal:.3g} units across in its first frame, and squares of such lengths do "
            f"not fit into double precision; {cure}"
        )
    largest = largest_coordinate(points)
    if largest > LARGEST:
        raise InvalidSequenceError(
            f"{name!r}: coordinates are up to {largest:.3g} units, and their squares do not fit into double "
            f"precision; {cure}"
        )


def largest_coordinate(points: LargeArray) -> float:
    """Return the largest absolute value of a coordinate of points ``(T, V, 3)``."""
    return max(float(np.abs(block).max(initial=0.0)) for block in blocks_of(points))


def farthest(points: LargeArray) -> float:
    """Return the largest distance along an axis of points ``(T, V, 3)`` from the middle of the first frame."""
    first = points[:1][0].astype(np.float64)
    middle = (first.min(axis=0) + first.max(axis=0)) / 2
    return max(float(np.abs(block - middle).max(initial=0.0)) for block in blocks_of(points))


def digits_end(coordinate: float) -> float:
    """Return the smallest error bound that is computable beside a coordinate, in its units."""
    return coordinate * _LAST_DIGITS


def block_size(vertex_count: int) -> int:
    """Return the number of frames per block; it depends on the mesh only, so results are reproducible."""
    most, vertices = _AT_ONCE
    return max(1, min(most, vertices // vertex_count))


def blocks_of(points: LargeArray) -> Iterator[FloatArray]:
    """Yield points ``(T, V, 3)`` in blocks of `block_size` frames."""
    size = block_size(points.shape[1])
    for start in range(0, len(points), size):
        yield points[start : start + size]
