"""What is written to HDF5 depends on the contents only: not on blocks of frames, nor on who looks at our frames."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

import mixseq
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq_io import write_blocks
from tests.formats.test_obj import rich


@contextmanager
def stack_frames_held() -> Iterator[None]:
    """Hold all stack frames, and so what is in their variables, as a profiler does now and then."""
    held: list[FrameType] = []
    sys.setprofile(lambda frame, event, argument: held.append(frame))
    try:
        yield
    finally:
        sys.setprofile(None)


@pytest.mark.parametrize("kind", ["model", "sequence"])
def test_the_same_file_whoever_holds_datasets(tmp_path: Path, bar_model: Model, kind: str) -> None:
    write: dict[str, Callable[[Path], None]] = {
        "model": lambda path: mixseq.save(path, bar_model),
        "sequence": lambda path: mixseq.write(path, rich()),
    }
    write[kind](tmp_path / "alone.h5")
    with stack_frames_held():
        write[kind](tmp_path / "held.h5")
    assert (tmp_path / "held.h5").read_bytes() == (tmp_path / "alone.h5").read_bytes()


def test_the_same_file_in_blocks_of_any_size(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(8, 6000, 3))  # 7 frames a chunk
    sequence = MeshSequence.from_arrays(points, [[0, 1, 2]])
    for size in (3, 8):
        blocks = (points[start : start + size] for start in range(0, 8, size))
        write_blocks(tmp_path / f"{size}.h5", sequence.header, blocks)
    assert (tmp_path / "3.h5").read_bytes() == (tmp_path / "8.h5").read_bytes()
