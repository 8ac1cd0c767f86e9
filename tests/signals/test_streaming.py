"""Sequences larger than memory: the model is that of the sequence in memory, and little of it is there at a time."""

from __future__ import annotations

import gc
import os
import tempfile
import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError, MixseqError
from mixseq.runtime import low_memory
from mixseq.runtime.parallel import serial_executor, thread_executor
from mixseq.sequence import sequence as frame_store
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import FloatArray
from tests.meshes import SEQUENCES, bar

pytestmark = pytest.mark.slow

LONG = bar(sides=5, rings=13, frames=30)
BENT = MeshSequence.from_header(LONG.header.with_times(np.arange(30) / 24, fps=24.0), LONG.points.astype(np.float32))
FILES = ("bar.npz", "bar.h5", "bar.usdc", "bar.abc", "bar.glb", "bar.pc2", "bar.mdd", "bar_####.obj", "bar_####.ply")


@dataclass
class Made:
    """A sequence that is made frame by frame, as often as it is asked for; an error may come in the middle."""

    header: SequenceHeader
    rest: FloatArray
    error: BaseException | None = None

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        count = self.header.frame_count
        for start in range(0, count, size):
            if self.error is not None and start > count // 2:
                raise self.error
            phase = np.arange(start, min(start + size, count))[:, None] / 7.0
            bent = np.tile(self.rest, (len(phase), 1, 1))
            bent[:, :, 0] += 0.3 * np.sin(phase) * self.rest[:, 2] ** 2 / 16
            yield bent


@pytest.fixture
def on_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is small enough for memory."""
    monkeypatch.setattr(low_memory, "MAX_BYTES_IN_MEMORY", 0)


def assert_same(first: Model, second: Model) -> None:
    for one, other in (
        (first.shapes, second.shapes),
        (first.time.values, second.time.values),
        (first.time.times, second.time.times),
        (first.placement.values, second.placement.values),
        (first.correction.values, second.correction.values),
        (first.pose.matrix, second.pose.matrix),
        (first.vectors, second.vectors),
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.usefixtures("on_disk")
@pytest.mark.parametrize(
    "settings", [{}, {"exact": True}, {"tolerance": 1e-2, "placement": "free"}, {"space": "vertex", "knots": 5}]
)
def test_a_streamed_model_is_that_of_the_sequence(
    settings: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mixseq.write(tmp_path / "long.h5", LONG)
    with mixseq.open_sequence(tmp_path / "long.h5") as reader:
        streamed = fit(reader, workers=thread_executor(3), **settings)
    monkeypatch.setattr(low_memory, "MAX_BYTES_IN_MEMORY", 1 << 30)
    assert_same(streamed, fit(LONG, workers=serial_executor, **settings))


@pytest.mark.parametrize(
    ("name", "placement"),
    [(name, "anchored") for name in ("folding sheet", "rigid component", "unused vertices", "zero area", "float32")]
    + [("bar", "free"), ("several components", "free")],
)
def test_blocks_do_not_matter(name: str, placement: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sequences of up to five frames in one block, or in blocks of which the last is shorter."""
    models = []
    for frames in (2, 100):
        monkeypatch.setattr(frame_store, "MAX_BLOCK_FRAMES", frames)
        models.append(fit(SEQUENCES[name](), exact=True, placement=placement))
    assert_same(*models)


@pytest.mark.usefixtures("on_disk")
@pytest.mark.parametrize("name", FILES)
def test_files_of_every_kind_stream(name: str, tmp_path: Path) -> None:
    """Fits begin with `load_frames`, and compare streams both."""
    mixseq.write(tmp_path / name, BENT)
    whole = mixseq.read(tmp_path / name)
    with mixseq.open_sequence(tmp_path / name) as reader:
        streamed = load_frames(reader).points
        assert isinstance(streamed, low_memory.DiskArray) and streamed.dtype == whole.points.dtype
        np.testing.assert_array_equal(streamed[:], whole.points)
        assert mixseq.compare(BENT, reader).max_error < 1e-6


@pytest.mark.usefixtures("on_disk")
def test_memory_does_not_grow_with_the_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        low_memory, "_MAX_TILE_COLUMNS", 64
    )  # blocks of columns are bounded, but for longer sequences than these
    still = bar(sides=20, rings=60, frames=1)
    most = []
    for frames in (2, 70, 140):  # the first one compiles and imports
        source = Made(still.header.with_times(np.arange(frames) / 24), still.points[0])
        gc.collect()
        if frames > 2:
            tracemalloc.start()
        model = fit(source, rank=2, parts=3, workers=serial_executor)
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert model.times.size == frames
    points = 70 * still.points[0].nbytes
    gram = 8 * (140**2 - 70**2)
    assert most[2] - most[1] < 0.2 * points + 3 * gram
    assert most[2] < 4e7


@pytest.mark.usefixtures("on_disk")
@pytest.mark.parametrize("error", [FormatError("frame 16 is damaged"), KeyboardInterrupt(), MemoryError()])
def test_a_source_that_fails_leaves_no_file(
    error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    source = Made(LONG.header, LONG.points[0], error)
    with pytest.raises(type(error)):
        fit(source)
    gc.collect()
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("on_disk")
@pytest.mark.parametrize("stage", ["registering parts", "encoding frames", "choosing modes and knots"])
def test_an_interrupted_fit_leaves_no_file(stage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def stop(done: int, total: int, what: str) -> None:
        if os.name == "posix":
            assert not list(tmp_path.iterdir()), "files have no names"
        if what == stage:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(Made(LONG.header, LONG.points[0]), progress=stop)
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_a_truncated_file_is_told(tmp_path: Path) -> None:
    mixseq.write(tmp_path / "long_####.obj", BENT)
    last = sorted(tmp_path.iterdir())[-1]
    last.write_bytes(last.read_bytes()[:200])
    with pytest.raises(MixseqError, match=last.name), mixseq.open_sequence(tmp_path / "long_####.obj") as reader:
        fit(reader)


@pytest.mark.parametrize("size", [1, 4, 7])
def test_comparisons_stream_in_blocks_of_any_size(size: int) -> None:
    @dataclass
    class Blocks:
        sequence: MeshSequence

        @property
        def header(self) -> SequenceHeader:
            return self.sequence.header

        def blocks(self, _: int = 16) -> Iterator[FloatArray]:
            return self.sequence.blocks(size)

    other = LONG.with_points(LONG.points * np.linspace(1, 1.1, 30)[:, None, None])
    streamed = mixseq.compare(Blocks(LONG), Blocks(other)).as_dict(per_frame=True)
    assert streamed == mixseq.compare(LONG, other).as_dict(per_frame=True)
