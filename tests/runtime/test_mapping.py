from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.runtime import parallel as threads
from mixseq.runtime.parallel import (
    one_blas_thread,
    serial_executor,
    thread_count,
    thread_executor,
    two_thread_executor,
)
from mixseq.signals.fitting import fit
from tests.forking import in_a_fork
from tests.meshes import coarse_walk


def wait_and_add(shared: int, item: int) -> int:
    time.sleep(0.001 * ((7 * item) % 5))
    return shared + item


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_order(threads: int) -> None:
    assert list(thread_executor(threads)(wait_and_add, 10, range(20))) == list(range(10, 30))
    assert list(thread_executor(threads)(wait_and_add, 10, ())) == []


@pytest.mark.parametrize("threads", [1, 3])
def test_items_are_taken_as_results_are(threads: int) -> None:
    taken = []

    def items() -> Iterator[int]:
        for number in range(100):
            taken.append(number)
            yield number

    results = thread_executor(threads)(wait_and_add, 0, items())
    for _ in range(5):
        next(results)
    assert len(taken) <= 5 + threads + 1
    results.close()  # type: ignore[attr-defined]
    assert len(taken) <= 5 + threads + 1


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_ends_the_work(threads: int) -> None:
    def fail(shared: None, item: int) -> int:
        if item == 3:
            raise ValueError("three")
        return item

    results = thread_executor(threads)(fail, None, range(1000))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(results)
    assert threading.active_count() < 10


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_an_iteration_belongs_to_its_process() -> None:
    results = thread_executor(2)(wait_and_add, 0, range(9))
    assert next(results) == 0
    said = in_a_fork(lambda: list(results))
    assert said == "MixseqError: the process was forked during this iteration; start a new iteration"
    assert in_a_fork(lambda: list(thread_executor(2)(wait_and_add, 0, range(3)))) == "[0, 1, 2]"
    assert list(results) == list(range(1, 9))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_lock_that_another_thread_holds_at_a_fork() -> None:
    def enter() -> str:
        with one_blas_thread():
            return "entered"

    with threads._lock:
        assert in_a_fork(enter) == "entered"


def test_thread_count_is_a_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIXSEQ_THREADS", "3")
    assert thread_count() == 3
    monkeypatch.setenv("MIXSEQ_THREADS", "")
    assert thread_count() >= 1
    for nonsense in ("0", "many", "-1", "1.5"):
        monkeypatch.setenv("MIXSEQ_THREADS", nonsense)
        with pytest.raises(SettingsError, match=f"MIXSEQ_THREADS is '{nonsense}'"):
            thread_count()
    monkeypatch.setenv("MIXSEQ_THREADS", "1")
    assert thread_executor() is serial_executor


@pytest.mark.parametrize("threads", [1, 2, 9])
def test_what_takes_much_memory_is_done_twice_at_once_at_most(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIXSEQ_THREADS", str(threads))
    under_way, most, lock = 0, 0, threading.Lock()

    def work(shared: int, item: int) -> int:
        nonlocal under_way, most
        with lock:
            under_way += 1
            most = max(most, under_way)
        time.sleep(0.01)
        with lock:
            under_way -= 1
        return shared + item

    assert list(two_thread_executor()(work, 1, range(9))) == list(range(1, 10))
    assert most == min(threads, 2)


@pytest.mark.parametrize("velocities", [False, True])
def test_frames_are_the_same_on_any_number_of_threads(velocities: bool) -> None:
    walk = coarse_walk(frames=9)
    model = fit(walk, rank=3)
    times = np.linspace(model.start, model.end, 13)
    decode = model.moving_blocks if velocities else model.blocks

    def bytes_of(size: int, threads: int) -> bytes:
        blocks = decode(times, size=size, workers=thread_executor(threads))
        return b"".join(frame.tobytes() for block in blocks for frame in frames(block))

    def frames(block: object) -> list[np.ndarray]:
        if isinstance(block, tuple):
            points, speeds = block
            return [np.stack([p, s]) for p, s in zip(points, speeds, strict=True)]
        assert isinstance(block, np.ndarray)
        return list(block)

    once = bytes_of(13, 1)
    assert bytes_of(2, 1) == once
    assert bytes_of(1, 2) == once
    assert bytes_of(3, 4) == once
