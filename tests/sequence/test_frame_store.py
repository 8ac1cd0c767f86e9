"""What streams is copied once, and checked on the way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from mixseq.errors import InvalidSequenceError
from mixseq.runtime import low_memory
from mixseq.runtime.low_memory import DiskArray
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import (
    MeshSequence,
    block_size,
    blocks_of,
    digits_end,
    farthest,
    frame_store,
    largest_coordinate,
)
from mixseq.types import FloatArray
from tests.meshes import bar

BAR = bar(sides=4, rings=5, frames=7)


@dataclass
class Streamed:
    """A sequence that is given in blocks, and counts how often."""

    header: SequenceHeader
    given: list[FloatArray]
    times: int = 0

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        self.times += 1
        yield from self.given


def test_what_is_in_memory_stays_there() -> None:
    assert frame_store(BAR).points is BAR.points
    assert [len(block) for block in BAR.blocks(3)] == [3, 3, 1]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("limit", [0, 1 << 30])
def test_what_streams_is_read_once(dtype: type, limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(low_memory, "IN_MEMORY", limit)
    points: FloatArray = BAR.points.astype(dtype)
    source = Streamed(BAR.header, [points[:2], points[2:3], points[3:]])
    told: list[tuple[int, int, str]] = []
    copy = frame_store(source, lambda *step: told.append(step))
    assert isinstance(copy.points, DiskArray) == (limit == 0)
    assert copy.points.dtype == dtype
    for _ in range(2):
        np.testing.assert_array_equal(np.concatenate(list(blocks_of(copy.points))), points)
    assert source.times == 1
    assert [done for done, _, _ in told] == [2, 3, 7]


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([BAR.points[:5]], "5 frames of points but 7 times"),
        ([], "0 frames of points but 7 times"),
        ([BAR.points, BAR.points], "more frames than the 7 times"),
        ([BAR.points[:, 1:]], "frame 0 has 21 vertices, the mesh has 22"),
        ([BAR.points[:3], np.full((4, 22, 3), np.nan)], r"frame 3: vertex 0 .* must be finite"),
    ],
)
def test_unsound_streams_are_refused(frames: list[FloatArray], message: str) -> None:
    with pytest.raises(InvalidSequenceError, match=message):
        frame_store(Streamed(BAR.header, frames))


@pytest.mark.parametrize(
    ("factor", "offset", "message"),
    [
        (1e-310, 0.0, "e-310 units across in its first frame, .* from 1e-60 to 1e.60 is expected"),
        (1e-61, 0.0, "e-61 units across"),
        (1e61, 0.0, r"e\+61 units across"),
        (1e307, 0.0, "units across"),
        (1.0, 1e200, r"coordinates are up to 1e\+200 units"),
    ],
)
@pytest.mark.parametrize("streams", [False, True])
def test_lengths_whose_squares_do_not_fit_are_refused(
    factor: float, offset: float, message: str, streams: bool
) -> None:
    points = BAR.points.copy()
    points[3] += offset
    far = BAR.with_points(points * factor)
    with pytest.raises(InvalidSequenceError, match=f"^{far.header.name!r}: .*{message}"):
        frame_store(Streamed(far.header, [far.points]) if streams else far)


def test_a_first_frame_that_is_one_point_may_be_anywhere() -> None:
    point = BAR.with_points(np.full_like(BAR.points, 1e59))
    assert frame_store(point).points is point.points
    assert digits_end(largest_coordinate(point.points)) == 1e59 * 2.0**-40


def test_how_far_vertices_get_does_not_depend_on_the_origin() -> None:
    triangle = np.array([[0.0, 0, 0], [2, 0, 0], [0, 4, 0]])
    points = np.stack([triangle, 10 * triangle]) + np.array([100.0, -1000, 0])
    assert farthest(points) == 38.0
    assert largest_coordinate(points) == 1000.0


def test_blocks_depend_on_the_mesh_only() -> None:
    assert [block_size(count) for count in (3, 100_000, 169_000, 1 << 20, 1 << 24)] == [8, 8, 6, 1, 1]
    long = MeshSequence.from_arrays(np.zeros((20, 3, 3)), [[0, 1, 2]])
    assert [len(block) for block in blocks_of(long.points)] == [8, 8, 4]
