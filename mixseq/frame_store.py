"""Sequences that can be looked at in any order: in memory, or copied to a temporary array as they are read once.

Files are read from their first frame to the last, and often slowly. What is learned from a sequence looks at it several
times, and at single frames. So what streams is copied once, and all that follows is the same for both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from mixseq.arrays import FloatArray
from mixseq.disk_array import LargeArray, new_large_array
from mixseq.errors import InvalidSequenceError
from mixseq.progress import Progress, silent
from mixseq.sequence import Frames, MeshSequence, SequenceHeader, check_block

_AT_ONCE = 8, 1 << 20  # frames, and vertices, in a block: at most 24 MB of float64, unless one frame is more


@dataclass(frozen=True, eq=False)
class FrameStore:
    """A sequence whose points can be looked at in any order.

    Attributes
    ----------
    header : SequenceHeader
        Everything but the points.
    points : (T, V, 3) array of float32 or float64
        The points.
    """

    header: SequenceHeader
    points: LargeArray


def frame_store(frames: Frames, progress: Progress = silent) -> FrameStore:
    """Return a sequence with points that can be looked at in any order, a copy unless it is in memory.

    Raises
    ------
    InvalidSequenceError
        If there are more or fewer frames than the header says, or frames of another mesh.
    OutputError
        If there is no room for a copy.
    """
    header = frames.header
    if isinstance(frames, MeshSequence):
        return FrameStore(header, frames.points)
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


def block_size(vertex_count: int) -> int:
    """Return how many frames to work on at once: it depends on the mesh only, so that results do not on others."""
    most, vertices = _AT_ONCE
    return max(1, min(most, vertices // vertex_count))


def blocks_of(points: LargeArray) -> Iterator[FloatArray]:
    """Yield points ``(T, V, 3)`` in blocks of `block_size` frames."""
    size = block_size(points.shape[1])
    for start in range(0, len(points), size):
        yield points[start : start + size]
