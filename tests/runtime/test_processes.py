"""Tasks in processes: results, deaths, and what is left of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import GivenUpError, SettingsError
from mixseq.runtime.cluster import connect_to_cluster
from mixseq.runtime.parallel import serial_executor
from mixseq.runtime.processes import ProcessPool, process_pool
from mixseq.signals.model import Model

pytestmark = pytest.mark.slow

PATIENCE = 60.0  # seconds


def told(_: object, name: str) -> tuple[int, str | None]:
    return os.getpid(), os.environ.get(name)


def divided(shared: int, item: int) -> float:
    if item == 99:
        raise SettingsError("99 is too large")
    return shared / item


def killed(folder: Path, item: str) -> str:
    """End the process of the item "once" in its first try, and that of "always" in every try."""
    if item == "always" or (item == "once" and not (folder / item).exists()):
        (folder / item).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def endless(folder: Path, item: int) -> None:
    (folder / f"{os.getpid()}.pid").touch()
    try:
        time.sleep(PATIENCE)
    finally:
        (folder / f"{os.getpid()}.cleaned").touch()


def processes_of(pool: ProcessPool) -> set[int | None]:
    return {worker.process.pid for worker in pool._workers}


def test_results_and_errors_are_those_of_the_function() -> None:
    with process_pool(2) as pool:
        results = dict(pool.as_completed(divided, 6, [1, 0, 3, 99]))
        assert (results[1](), results[3]()) == (6, 2)
        with pytest.raises(ZeroDivisionError):
            results[0]()
        with pytest.raises(SettingsError, match="99 is too large"):
            results[99]()
        used = {result()[0] for _, result in pool.as_completed(told, None, ["PATH"] * 8)}
        assert used <= processes_of(pool) and len(used) <= 2 and os.getpid() not in used
        (threads,) = [result()[1] for _, result in pool.as_completed(told, None, ["OPENBLAS_NUM_THREADS"])]
        assert threads == "1"
        assert list(pool.as_completed(told, None, [])) == []
        alive = processes_of(pool)
    for process in alive:
        with pytest.raises(ProcessLookupError):
            os.kill(process or 0, 0)


def test_a_task_whose_process_dies_is_tried_alone_and_then_given_up(tmp_path: Path) -> None:
    with process_pool(2) as pool:
        results = dict(pool.as_completed(killed, tmp_path, ["always", "once", "never"]))
    assert next(iter(results)) == "never"
    assert (results["once"](), results["never"]()) == ("once", "never")
    with pytest.raises(GivenUpError, match=r"its process was ended twice \(SIGKILL\).*may need more memory"):
        results["always"]()


def test_results_are_in_order_whatever_dies(tmp_path: Path) -> None:
    taken = []

    def items() -> Iterator[int]:
        for item in range(100):
            taken.append(item)
            yield item

    with connect_to_cluster("local:2") as workers:
        assert isinstance(workers, ProcessPool)
        results = workers(pow, 2, items())
        assert taken == []
        assert next(results) == 1
        results.close()  # type: ignore[attr-defined]
        assert len(taken) <= 4
        assert list(workers(pow, 2, range(20))) == [2**power for power in range(20)]
        for worker in workers._workers:
            worker.process.kill()
            worker.process.join()
        assert list(workers(killed, tmp_path, ["never", "once", "never"])) == ["never", "once", "never"]
        with pytest.raises(ZeroDivisionError):
            list(workers(divided, 6, [1, 0]))
        with pytest.raises(GivenUpError):
            list(workers(killed, tmp_path, ["never", "always"]))


def test_frames_are_those_of_one_thread(bar_model: Model) -> None:
    times = np.linspace(bar_model.start, bar_model.end, 20)
    with process_pool(2) as workers:
        blocks = list(bar_model.blocks(times, 2, workers=workers))
    expected = list(bar_model.blocks(times, 2, workers=serial_executor))
    assert np.concatenate(blocks).tobytes() == np.concatenate(expected).tobytes()


def wait_for(folder: Path, pattern: str, count: int) -> list[Path]:
    deadline = time.monotonic() + PATIENCE
    while len(found := list(folder.glob(pattern))) < count:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


def is_gone(process: int) -> bool:
    deadline = time.monotonic() + PATIENCE
    while Path(f"/proc/{process}").exists():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


SCRIPT = """
import sys
from pathlib import Path
from mixseq.runtime.processes import process_pool
from tests.runtime.test_processes import endless
if __name__ == "__main__":
    with process_pool(2) as pool:
        list(pool.as_completed(endless, Path(sys.argv[1]), [1, 2]))
"""


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are looked up in /proc")
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(("number", "to_group"), [(signal.SIGINT, True), (signal.SIGKILL, False)])
def test_no_process_is_left(tmp_path: Path, number: signal.Signals, to_group: bool) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    parent = subprocess.Popen(
        [sys.executable, script, tmp_path],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    workers = wait_for(tmp_path, "*.pid", 2)
    (os.killpg if to_group else os.kill)(parent.pid, number)  # a terminal sends Ctrl-C to the group
    _, errors = parent.communicate(timeout=PATIENCE)
    assert parent.returncode == -number
    assert errors.count(b"Traceback") == (number == signal.SIGINT)  # the script's own, none of the workers'
    assert all(is_gone(int(worker.stem)) for worker in workers)
    assert len(list(tmp_path.glob("*.cleaned"))) == 2
