"""Open files share a few processes, and nobody who reads them notices."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from mixseq.errors import FormatError, MixseqWarning
from mixseq.types import FloatArray
from mixseq_io import isolation
from mixseq_io.isolation import OpenFile, open_isolated
from mixseq_io.reader import SequenceReader

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def two_workers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let two files have workers, none of which are other tests'."""
    monkeypatch.setattr(isolation, "MAX_WORKERS", 2)
    monkeypatch.setattr(isolation, "idle_workers", [])
    yield
    isolation.close_idle_workers()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "walk.abc").touch()
    return tmp_path / "walk.abc"


def opened(path: Path, how: str = "well", when: str = "opening") -> SequenceReader:
    return open_isolated("tests.formats.readers:open_file", path, {"how": how, "when": when})


def file_of(reader: SequenceReader) -> OpenFile:
    file: OpenFile = reader._file  # type: ignore[attr-defined]
    return file


def processes(readers: list[SequenceReader]) -> list[int]:
    """Processes of the files that have one."""
    workers = [file_of(reader).worker for reader in readers]
    return [worker._process.pid for worker in workers if worker is not None]


def frames(blocks: Iterator[FloatArray]) -> list[float]:
    return [float(block[0, 0, 0]) for block in blocks]


def test_many_files_have_few_processes(path: Path) -> None:
    readers = [opened(path) for _ in range(5)]
    assert len(set(processes(readers))) == 2
    assert [frames(reader.blocks(1)) for reader in readers] == [[0, 1, 2, 3]] * 5
    assert len(set(processes(readers))) == 2
    for reader in readers:
        reader.close()
    assert processes(readers) == []
    assert len(isolation.idle_workers) == 2


def test_reading_goes_on_where_it_was(path: Path) -> None:
    readers = [opened(path) for _ in range(3)]
    blocks = [reader.blocks(1) for reader in readers]
    velocities = readers[0].velocity_blocks(2)
    assert velocities is not None
    for number in range(4):  # each takes the worker of the one that is asked next
        assert [next(each)[0, 0, 0] for each in blocks] == [number] * 3
        if number % 2 == 0:
            assert next(velocities)[0, 0, 0] == -number
    assert [frames(each) for each in (*blocks, velocities)] == [[]] * 4


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signals to block")
def test_ctrl_c_does_not_end_a_worker_that_starts() -> None:
    worker = isolation.WorkerProcess()
    os.kill(worker._process.pid, signal.SIGINT)
    assert worker.request(Path(), "close") is None
    worker.close()


def test_what_was_told_is_not_told_again(path: Path) -> None:
    with pytest.warns(MixseqWarning, match="something is lost") as caught:
        reader = opened(path, "warn")
    with opened(path), opened(path):
        assert file_of(reader).worker is None
    assert frames(reader.blocks(4)) == [0]
    assert len(caught) == 1
    reader.close()


def test_a_file_that_changed_meanwhile(path: Path) -> None:
    reader = opened(path)
    with opened(path), opened(path):
        path.write_text("others")
        with pytest.raises(FormatError, match=r"walk.abc has changed since it was opened; open it again"):
            list(reader.blocks(1))


def test_who_waits_for_an_answer_keeps_the_worker(path: Path) -> None:
    with opened(path) as one, opened(path) as other:
        asked = threading.Thread(target=file_of(one).lock.acquire)
        asked.start()
        asked.join()
        with opened(path):
            assert file_of(one).worker is not None
            assert file_of(other).worker is None
        file_of(one).lock = threading.RLock()  # that thread is gone, and with it whoever could release it


def test_a_reader_that_is_dropped_ends_its_process(path: Path) -> None:
    reader = opened(path)
    worker = file_of(reader).worker
    assert worker is not None
    process: subprocess.Popen[bytes] = worker._process
    del reader, worker
    assert process.returncode is not None


def test_a_forked_process_opens_files_again(path: Path) -> None:
    with opened(path) as reader:
        blocks = reader.blocks(1)
        next(blocks)
        child = os.fork()
        if not child:
            code = 1
            try:
                code = int(frames(blocks) != [1, 2, 3])
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert frames(blocks) == [1, 2, 3]
