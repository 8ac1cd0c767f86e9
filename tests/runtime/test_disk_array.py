"""Tables that may be larger than memory are tables."""

from __future__ import annotations

import gc
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.errors import OutputError
from mixseq.runtime import low_memory
from mixseq.runtime.low_memory import DiskArray, RunningStatistics, column_blocks, from_columns, new_large_array
from mixseq.runtime.parallel import thread_executor
from tests.meshes import seeds


def on_disk(values: NDArray[Any], step: int = 3) -> DiskArray:
    """The same numbers on disk, written in blocks of rows."""
    made = DiskArray(values.shape, values.dtype)
    for start in range(0, len(values), step):
        made[start : start + step] = values[start : start + step]
    return made


@given(
    rows=st.integers(1, 9),
    width=st.integers(1, 9),
    columns=st.integers(1, 10),
    picked=st.data(),
    step=st.integers(1, 4),
)
def test_rows_and_columns_are_those_of_an_array(
    rows: int, width: int, columns: int, picked: st.DataObject, step: int
) -> None:
    values = np.arange(rows * width, dtype=np.float64).reshape(rows, width)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(low_memory, "_MAX_TILE_COLUMNS", columns)
        made = on_disk(values, step)
        chosen = np.array(picked.draw(st.lists(st.integers(0, rows - 1))), dtype=np.int64)
        np.testing.assert_array_equal(made[chosen], values[chosen])
        np.testing.assert_array_equal(made[1:], values[1:])
        blocks = list(column_blocks(made))
        for (one, ours), (other, theirs) in zip(blocks, column_blocks(values), strict=True):
            assert one == other
            assert ours.shape == (rows, one.stop - one.start)
            np.testing.assert_array_equal(ours, theirs)
    assert len(made) == rows


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rows_have_any_shape_and_precision(dtype: type) -> None:
    points: NDArray[Any] = np.random.default_rng(0).standard_normal((5, 7, 3)).astype(dtype)
    made = on_disk(points)
    assert (made.shape, made.dtype) == (points.shape, points.dtype)
    np.testing.assert_array_equal(made[np.array([4, 0, 1])], points[[4, 0, 1]])
    np.testing.assert_array_equal(made[:0], points[:0])


def test_small_tables_are_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(new_large_array((4, 8)), np.ndarray)
    monkeypatch.setattr(low_memory, "MAX_BYTES_IN_MEMORY", 4 * 8 * 8 - 1)
    assert isinstance(new_large_array((4, 8)), DiskArray)
    assert isinstance(new_large_array((4, 8), np.float32), np.ndarray)


@pytest.mark.parametrize("limit", [0, 1 << 20])
def test_tables_are_made_of_columns(limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(low_memory, "MAX_BYTES_IN_MEMORY", limit)
    monkeypatch.setattr(low_memory, "_MAX_TILE_COLUMNS", 3)
    table = np.arange(40.0).reshape(5, 8)
    made = from_columns(table.shape, lambda columns: table[:, columns])
    assert isinstance(made, DiskArray) == (not limit)
    np.testing.assert_array_equal(made[1:4], table[1:4])


def test_many_rows_come_in_narrow_blocks() -> None:
    wide = next(column_blocks(np.zeros((2, 20_000))))[1]
    narrow = next(column_blocks(np.zeros((100_000, 200))))[1]
    assert wide.shape == (2, 1 << 14)
    assert narrow.shape == (100_000, 83)


def test_files_vanish_with_their_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    made = on_disk(np.ones((3, 4)))
    number = made._file.fileno()
    if os.name == "posix":
        assert not list(tmp_path.iterdir()), "it has no name even while it is used"
    del made
    gc.collect()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(number)
    assert not list(tmp_path.iterdir())


def test_threads_read_what_was_written() -> None:
    array = DiskArray((400, 3000))
    array[0:400] = np.tile(np.arange(400.0)[:, None], (1, 3000))

    def row(_: None, number: int) -> bool:
        return bool((array[number : number + 1] == number).all())

    assert all(thread_executor(8)(row, None, [*range(400)] * 4))


def test_a_full_disk_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def seek(self, place: int) -> None:
            pass

        def write(self, data: object) -> None:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            pass

    monkeypatch.setattr(tempfile, "TemporaryFile", Full)
    made = DiskArray((1000, 500_000))
    with pytest.raises(OutputError, match=r"temporary file of 4\.0 GB in .*No space left.*set TMPDIR"):
        made[0:1] = np.zeros((1, 500_000))


# Statistics of values that come block by block


@given(seeds, st.lists(st.integers(0, 1500), min_size=1, max_size=8), st.integers(0, 5000), st.booleans())
@settings(max_examples=60, deadline=None)
def test_statistics_equals_brute_force(seed: int, sizes: list[int], skipped: int, ties: bool) -> None:
    rng = np.random.default_rng(seed)
    blocks = [rng.exponential(size=size) for size in sizes]
    if ties:
        blocks = [np.round(block, 1) for block in blocks]
    everything = np.concatenate(blocks)
    gathered = RunningStatistics(everything.size + skipped)
    for block in blocks:
        gathered.add(block)
    result = gathered.result()
    assert result.skipped == skipped
    if not everything.size:
        assert (result.rms, result.p999, result.max) == (0, 0, 0)
        return
    assert result.max == everything.max()
    assert result.p999 == np.quantile(everything, 0.999, method="inverted_cdf")
    assert result.rms == pytest.approx(np.sqrt(np.square(everything).mean()))


def test_statistics_when_a_block_is_as_long_as_what_is_kept() -> None:
    gathered = RunningStatistics(1000)
    everything = np.concatenate([[9.0, 1.0], np.full(997, 2.0), [5.0]])
    for block in (everything[:2], everything[2:]):
        gathered.add(block)
    assert gathered.result().p999 == 5.0


def test_what_is_not_finite_is_skipped() -> None:
    gathered = RunningStatistics(4)
    gathered.add(np.array([1.0, np.nan, 3.0]))
    gathered.add(np.array([np.inf]))
    result = gathered.result()
    assert (result.max, result.p999, result.skipped) == (3.0, 3.0, 2)
    assert RunningStatistics(3).result().skipped == 3
