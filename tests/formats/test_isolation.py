"""Readers in a process of their own: the same sequence, and whatever happens there is an error here."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

import mixseq
from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning
from mixseq_io import isolation
from mixseq_io.hdf5.contents import MODEL_FORMAT, read_contents
from mixseq_io.isolation import open_isolated
from mixseq_io.reader import SequenceReader
from tests.forking import in_a_fork
from tests.meshes import coarse_walk

FILE = Path("walk.abc")


def opened(how: str = "well", when: str = "opening") -> SequenceReader:
    return open_isolated("tests.formats.readers:open_file", FILE, {"how": how, "when": when})


@pytest.fixture
def new_workers(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Let no worker of another test answer, and end those of this one."""
    monkeypatch.setattr(isolation, "idle_workers", [])
    yield monkeypatch
    isolation.close_idle_workers()


def test_the_same_sequence_comes_through() -> None:
    with opened() as reader:
        assert reader.header.times.tolist() == [0, 1, 2, 3]
        assert not reader.header.times.flags.writeable
        assert not reader.header.polygons.indices.flags.writeable
        assert [block[:, 0, 0].tolist() for block in reader.blocks(3)] == [[0, 0, 0], [3]]
        velocities = reader.velocity_blocks(2)
        assert velocities is not None
        assert [block[:, 0, 0].tolist() for block in velocities] == [[0, 0], [-2, -2]]


def test_iterations_and_files_do_not_disturb_each_other() -> None:
    with opened() as one, opened() as other:
        a, b, c = one.blocks(2), one.blocks(3), other.blocks(1)
        next(a), next(b), next(c)
        assert (next(a)[0, 0, 0], next(b)[0, 0, 0], next(c)[0, 0, 0]) == (2, 3, 1)


def test_a_worker_is_used_again(new_workers: pytest.MonkeyPatch) -> None:
    with opened() as reader:
        process = reader._worker._process.pid  # type: ignore[attr-defined]
    with opened() as reader:
        assert reader._worker._process.pid == process  # type: ignore[attr-defined]


def test_idle_workers_are_few(new_workers: pytest.MonkeyPatch) -> None:
    readers = [opened() for _ in range(3)]
    assert [[float(block[0, 0, 0]) for block in reader.blocks(1)] for reader in readers] == [[0, 1, 2, 3]] * 3
    for reader in readers:
        reader.close()
    assert len(isolation.idle_workers) == 2


def test_a_reader_that_is_dropped_ends_its_process(new_workers: pytest.MonkeyPatch) -> None:
    reader = opened()
    process = reader._worker._process  # type: ignore[attr-defined]
    del reader
    assert process.returncode is not None


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signals to block")
def test_ctrl_c_does_not_end_a_worker_that_starts() -> None:
    worker = isolation.WorkerProcess()
    os.kill(worker._process.pid, signal.SIGINT)
    assert worker.request(Path(), "close") is None
    worker.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_has_workers_of_its_own(new_workers: pytest.MonkeyPatch) -> None:
    def read() -> list[float]:
        with opened() as reader:
            return [float(block[0, 0, 0]) for block in reader.blocks(1)]

    with opened() as idle, opened() as busy:
        idle.close()
        rest = busy.blocks(1)
        next(rest)
        assert len(isolation.idle_workers) == 1
        assert in_a_fork(lambda: len(isolation.idle_workers)) == "0"
        assert "was opened before this process was forked" in in_a_fork(lambda: next(rest))
        assert in_a_fork(busy.close) == "None"
        here = str(read())
        with isolation._lock:  # as another thread may
            assert in_a_fork(read) == here
        assert [float(block[0, 0, 0]) for block in rest] == [1, 2, 3]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_worker_ends_though_a_forked_process_lives(new_workers: pytest.MonkeyPatch) -> None:
    """It ends when nobody can ask it any more; a forked process has a copy of the pipe."""
    with opened() as reader:
        worker = reader._worker  # type: ignore[attr-defined]
        going_on, done = os.pipe()
        child = os.fork()
        if not child:
            os.close(done)
            os.read(going_on, 1)
            os._exit(0)
    isolation.close_idle_workers()
    assert worker._process.returncode == 0
    os.close(done)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.parametrize("when", ["opening", "reading"])
def test_crash(when: str) -> None:
    with (
        pytest.raises(FormatError, match=r"walk.abc: the library that reads it crashed; .* export it again"),
        opened("crash", when) as reader,
    ):
        list(reader.blocks(1))
    with opened() as reader:  # life goes on
        assert len(list(reader.blocks(1))) == 4


@pytest.mark.parametrize("how", ["hang", "wait"])
@pytest.mark.parametrize("when", ["opening", "reading"])
def test_no_answer(how: str, when: str, new_workers: pytest.MonkeyPatch) -> None:
    new_workers.setenv("MIXSEQ_READER_SECONDS", "0.2")
    with (
        pytest.raises(FormatError, match=r"walk.abc: reading takes too long; .*MIXSEQ_READER_SECONDS"),
        opened(how, when) as reader,
    ):
        list(reader.blocks(1))


@pytest.mark.parametrize("when", ["opening", "reading"])
def test_absurd_allocation(when: str, new_workers: pytest.MonkeyPatch) -> None:
    new_workers.setenv("MIXSEQ_READER_MEMORY", "1")
    with (
        pytest.raises(FormatError, match=r"walk.abc: reading needs more than 1.07 GB of memory, .* --max-memory"),
        opened("memory", when) as reader,
    ):
        list(reader.blocks(1))


@pytest.mark.parametrize("when", ["opening", "reading"])
def test_errors_are_the_same_as_here(when: str) -> None:
    with pytest.raises(InvalidSequenceError, match=r"walk.abc: it is unsound"), opened("error", when) as reader:
        list(reader.blocks(1))


def test_bugs_are_shown() -> None:
    with pytest.raises(RuntimeError, match=r"(?s)readers.py.*by our own mistake"):
        opened("bug")


def test_warnings_are_the_same_as_here() -> None:
    with pytest.warns(MixseqWarning, match="something is lost") as caught, opened("warn"):
        pass
    assert len(caught) == 1


def test_what_libraries_print_is_not_seen(capfd: pytest.CaptureFixture[str]) -> None:
    with opened("print", "reading") as reader:
        np.concatenate(list(reader.blocks(1)))
    assert capfd.readouterr() == ("", "")


def test_an_application_that_embeds_python_reads_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isolation.can_isolate()
    monkeypatch.setattr("sys.executable", "/opt/modeller/bin/modeller")
    assert not isolation.can_isolate()


def test_an_interrupted_worker_answers_no_more(new_workers: pytest.MonkeyPatch) -> None:
    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        with opened("hang", "reading") as reader:
            blocks = reader.blocks(2)
            next(blocks)
            signal.setitimer(signal.ITIMER_REAL, 0.1)
            with pytest.raises(KeyboardInterrupt):
                next(blocks)
    finally:
        signal.signal(signal.SIGALRM, before)
    with opened() as reader:
        assert [block[:, 0, 0].tolist() for block in reader.blocks(3)] == [[0, 0, 0], [3]]


def test_meanwhile_this_process_does_something_else(tmp_path: Path) -> None:
    path = tmp_path / "walk.h5"
    mixseq.save(path, mixseq.fit(coarse_walk(frames=2), space="vertex"))
    done: list[str] = []
    found = read_contents(path, MODEL_FORMAT, meanwhile=lambda: done.append("imports"))
    assert (done, found.kind) == (["imports"], MODEL_FORMAT)

    def fail() -> NoReturn:
        raise ImportError("nothing of that name")

    with pytest.raises(ImportError, match="nothing of that name"):
        read_contents(path, MODEL_FORMAT, meanwhile=fail)
    assert (
        read_contents(path, MODEL_FORMAT).attrs["vertex_count"] == found.attrs["vertex_count"]
    )  # not the other's answer
