"""Work on other processes: the same results, whatever happens to a worker."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import mixseq.runtime.cluster
from mixseq.errors import ClusterError, GivenUpError, MissingExtraError, SettingsError
from mixseq.runtime.cluster import ClusterExecutor, connect_to_cluster
from mixseq.runtime.parallel import serial_executor
from mixseq.signals.model import Model

pytestmark = pytest.mark.slow

dask = pytest.importorskip("dask")
pytest.importorskip("distributed")


@contextmanager
def cluster(process_count: int) -> Iterator[ClusterExecutor]:
    """Start a cluster with workers of one thread, and connect to it."""
    from distributed import LocalCluster

    with (
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=process_count, threads_per_worker=1, dashboard_address=":0", silence_logs=50, memory_limit=None
        ) as started,
        connect_to_cluster(started.scheduler_address) as workers,
    ):
        assert isinstance(workers, ClusterExecutor)
        yield workers


@pytest.fixture(scope="module")
def two() -> Iterator[ClusterExecutor]:
    with cluster(2) as workers:
        yield workers


def address_of(workers: ClusterExecutor) -> str:
    return str(workers._client.scheduler.address)


def worker_after(_: object, seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def slept(_: object, seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def pids(workers: ClusterExecutor) -> set[int]:
    """Return the processes of the workers."""
    return set(workers._client.run(os.getpid).values())


def test_results_are_in_order(two: ClusterExecutor) -> None:
    assert list(two(pow, 2, range(20))) == [2**power for power in range(20)]
    assert list(two(pow, 2, [])) == []


def test_work_is_spread_over_processes(two: ClusterExecutor) -> None:
    found = set(two(worker_after, None, [0.05] * 30))
    assert found == pids(two)
    assert len(found) == 2
    assert os.getpid() not in found


def test_items_are_taken_as_results_are(two: ClusterExecutor) -> None:
    taken = []

    def items() -> Iterator[int]:
        for item in range(100):
            taken.append(item)
            yield item

    results = two(pow, 2, items())
    assert taken == []
    assert next(results) == 1
    assert len(taken) <= 6
    results.close()  # type: ignore[attr-defined]
    assert len(taken) <= 6


def test_what_is_done_first_comes_first(two: ClusterExecutor) -> None:
    seconds = [1.0, 0.0, 0.1]
    found = [(item, result()) for item, result in two.as_completed(slept, None, seconds)]
    assert sorted(found) == sorted(zip(seconds, seconds, strict=True))
    assert found[0] != (1.0, 1.0)


def test_errors_are_those_of_the_function(two: ClusterExecutor) -> None:
    with pytest.raises(ZeroDivisionError):
        list(two(divmod, 1, [1, 0, 1]))
    results = dict(two.as_completed(divmod, 1, [1, 0]))
    assert results[1]() == (1, 0)
    with pytest.raises(ZeroDivisionError):
        results[0]()


def test_the_only_worker_dies_with_everything_it_holds(bar_model: Model) -> None:
    times = np.linspace(bar_model.start, bar_model.end, 20)
    expected = np.concatenate(list(bar_model.blocks(times, 2, workers=serial_executor)))
    found = []
    with cluster(1) as workers:
        before = pids(workers)
        for number, block in enumerate(bar_model.blocks(times, 2, workers=workers)):
            found.append(block)
            if number == 3:
                os.kill(min(before), signal.SIGKILL)
        assert not before & pids(workers)
    assert np.concatenate(found).tobytes() == expected.tobytes()


def test_work_that_kills_workers_is_given_up() -> None:
    # Given up after the first death, not the fourth: that is quicker.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        cluster(1) as workers,
        pytest.raises(ClusterError, match="several workers died while they did the same task"),
    ):
        list(workers(lambda _, number: os.kill(os.getpid(), number), None, [signal.SIGKILL]))


def killed_by(killer: str, item: str) -> str:
    """Do a little work, or kill the worker."""
    time.sleep(0.05)
    if item == killer:
        os.kill(os.getpid(), signal.SIGKILL)
    return item.upper()


def test_only_what_kills_is_given_up() -> None:
    # Given up after the second death, not the fourth: that is quicker, and harder on the neighbours.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        cluster(2) as workers,
    ):
        results = dict(workers.as_completed(killed_by, "c", "abcdef"))
        assert set(results) == set("abcdef")
        for item in "abdef":
            assert results[item]() == item.upper()
        with pytest.raises(GivenUpError, match="several workers died while they did the same task"):
            results["c"]()


def test_what_was_given_up_with_another_is_tried_again_alone(
    two: ClusterExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    suspected = []

    def suspect_once(future: Any) -> bool:
        suspected.append(future)
        return len(suspected) == 1

    monkeypatch.setattr(mixseq.runtime.cluster, "_was_given_up", suspect_once)
    found = [(item, result()) for item, result in two.as_completed(pow, 2, [1, 2, 3])]
    assert len(suspected) == 3
    assert sorted(found) == [(1, 2), (2, 4), (3, 8)]


def test_work_that_takes_long_is_on_all_workers_and_no_more(two: ClusterExecutor) -> None:
    taken = []

    def items() -> Iterator[float]:
        for _ in range(6):
            taken.append(0.3)
            yield 0.3

    for done, (_, result) in enumerate(two.as_completed(worker_after, None, items())):
        assert len(taken) <= done + 2
        result()
    assert {result() for _, result in two.as_completed(worker_after, None, [0.3] * 6)} == pids(two)


def test_workers_that_come_later(two: ClusterExecutor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(two._client, "nthreads", dict)  # for the moment there are none
    assert list(two(pow, 2, range(3))) == [1, 2, 4]
    assert dict(two.as_completed(pow, 2, [3]))[3]() == 8


@pytest.fixture
def scheduler() -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A scheduler with a worker, in processes of their own."""
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        address = next(found[1] for line in process.stderr if (found := re.search(r"(tcp://\S+)", line)))
        worker = [
            sys.executable,
            "-m",
            "distributed.cli.dask_worker",
            address,
            "--no-nanny",
            "--no-dashboard",
        ]
        with subprocess.Popen(worker, stderr=subprocess.DEVNULL) as helper:
            try:
                yield address, process
            finally:
                helper.kill()
                process.kill()


@pytest.mark.parametrize("way", ["in order", "as done"])
def test_the_scheduler_dies(way: str, scheduler: tuple[str, subprocess.Popen[str]]) -> None:
    """Further calls do not wait for it."""
    address, process = scheduler
    lost = "the connection to the scheduler of the cluster was lost"
    with connect_to_cluster(address) as workers:
        call = workers if way == "in order" else workers.as_completed
        with pytest.raises(ClusterError, match=lost):
            for number, each in enumerate(call(slept, None, [0.1] * 100)):
                if callable(result := each[1] if isinstance(each, tuple) else None):
                    result()
                if number == 2:
                    process.kill()
        start = time.monotonic()
        with pytest.raises(ClusterError, match=lost):
            list(call(slept, None, [0.1]))
        assert time.monotonic() - start < 5


def test_a_scheduler_elsewhere(two: ClusterExecutor) -> None:
    with connect_to_cluster(address_of(two)) as workers:
        assert list(workers(pow, 3, range(4))) == [1, 3, 9, 27]
    assert list(two(pow, 3, range(4))) == [1, 3, 9, 27]  # still there


@pytest.mark.parametrize("address", ["local", "local:", "local:0", "local:-1", "local:two", "local:1.5"])
def test_no_number_of_processes(address: str) -> None:
    with (
        pytest.raises(SettingsError, match=f"'{address}' is no cluster; give local:N"),
        connect_to_cluster(address),
    ):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "tcp://127.0.0.1:port", "nonsense://x", "", "localhost"])
def test_nobody_answers(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mixseq.runtime.cluster, "CONNECT_TIMEOUT_SECONDS", 0.3)
    with pytest.raises(ClusterError, match=f"no scheduler answers at {address}"), connect_to_cluster(address):
        pass


def test_no_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster

    monkeypatch.setattr(mixseq.runtime.cluster, "CONNECT_TIMEOUT_SECONDS", 0.3)
    with (
        LocalCluster(n_workers=0, dashboard_address=":0") as empty,  # type: ignore[no-untyped-call]
        pytest.raises(ClusterError, match="has no workers; start some with `dask worker tcp://"),
        connect_to_cluster(empty.scheduler_address),
    ):
        pass


def test_another_version(two: ClusterExecutor, monkeypatch: pytest.MonkeyPatch) -> None:
    there = mixseq.__version__
    monkeypatch.setattr(mixseq.runtime.cluster, "__version__", "99.1")
    expected = rf"has mixseq {there}, this machine 99.1; install mixseq==99.1 on the worker"
    with pytest.raises(ClusterError, match=expected), connect_to_cluster(address_of(two)):
        pass


def test_no_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(MissingExtraError, match=r"pip install 'mixseq\[dask\]'"),
        connect_to_cluster("tcp://127.0.0.1:8786"),
    ):
        pass
