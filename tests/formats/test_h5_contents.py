"""HDF5 is read in a process of its own: what never ends there is an error here, within seconds, and Ctrl-C is heard."""

from __future__ import annotations

import os
import signal
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import mixseq
from mixseq.errors import FormatError
from mixseq_io import isolation, worker_pool
from mixseq_io.hdf5.contents import read_attributes, read_contents
from tests.formats.models.model_cases import GOLDEN

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def new_workers(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Let no worker of another test answer, and end those of this one."""
    monkeypatch.setattr(worker_pool, "idle", [])
    monkeypatch.setenv("MIXSEQ_READER_SECONDS", "60")  # of which attributes have a second
    yield monkeypatch
    worker_pool.dismiss_all()


@pytest.fixture
def endless(tmp_path: Path) -> Path:
    """Make a file whose strings of any length HDF5 would search for ever: the size of what is free is too small."""
    path = tmp_path / "endless.h5"
    data = bytearray((GOLDEN / "sequence-v1.h5").read_bytes())
    place = data.index(b"GCOL") + 16
    while struct.unpack_from("<H", data, place)[0]:
        place += 16 + -(-struct.unpack_from("<Q", data, place + 8)[0] // 8) * 8
    free = struct.unpack_from("<Q", data, place + 8)[0]
    struct.pack_into("<Q", data, place + 8, free - 16)  # what follows is of no size, again and again
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("read", [mixseq.open_sequence, mixseq.load])
def test_a_search_without_end(endless: Path, read: Callable[[Path], object]) -> None:
    begin = time.monotonic()
    with pytest.raises(FormatError, match=r"endless\.h5: reading takes too long; it is damaged"):
        read(endless)
    assert time.monotonic() - begin < 30


def test_an_interrupt_is_heard(endless: Path, new_workers: pytest.MonkeyPatch) -> None:
    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    new_workers.setenv("MIXSEQ_READER_SECONDS", "6000")
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 1.5)
        with pytest.raises(KeyboardInterrupt):
            read_attributes(endless)
    finally:
        signal.signal(signal.SIGALRM, before)


def test_a_pipe_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    with pytest.raises(FormatError, match=r"pipe\.h5 is a pipe"):
        read_attributes(tmp_path / "pipe.h5")


def test_the_same_without_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    path = GOLDEN / "model-v5.h5"
    there = read_contents(path)
    monkeypatch.setattr(isolation, "can_isolate", lambda: False)
    here = read_contents(path)
    assert there.attributes == here.attributes
    assert there.attributes["space"]["placement"] == "anchored"
    assert {name: array.tolist() for name, array in there.arrays.items()} == {
        name: array.tolist() for name, array in here.arrays.items()
    }
