"""Signals end the work, wherever they come, and no library swallows them."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mixseq.runtime import interrupts
from mixseq.runtime.interrupts import (
    acknowledge_signal,
    deferred_signals,
    raise_pending_signal,
    signals_as_exceptions,
    uninterrupted,
)
from mixseq_io import files as temporary
from mixseq_io.files import atomic_file, atomic_files
from mixseq_io.hdf5.datasets import DeferredErrorFile

PATIENCE = 60.0  # seconds

pytestmark = pytest.mark.usefixtures("interruptible")


def send(number: int = signal.SIGINT) -> None:
    signal.raise_signal(number)


def wait() -> None:
    """Work on, until a signal ends it."""
    for _ in range(1000):
        time.sleep(0.01)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_termination_ends_the_work(number: int, code: int) -> None:
    with pytest.raises(SystemExit) as ended, signals_as_exceptions():
        send(number)
    assert ended.value.code == code
    assert signal.getsignal(number) == signal.SIG_DFL


def test_an_import_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Libraries in C that import modules drop what is raised there."""
    (tmp_path / "interrupted_module.py").write_text("import signal\nsignal.raise_signal(signal.SIGINT)\ndone = True")
    monkeypatch.syspath_prepend(tmp_path)
    done: list[bool] = []

    def work() -> None:
        from interrupted_module import done as complete  # type: ignore[import-not-found]

        done.append(complete)
        wait()

    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        work()
    assert done == [True]


def test_what_is_unbroken_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """As are the functions that HDF5 calls to write, wherever in them, or below, the signal is heard."""
    monkeypatch.setattr(interrupts, "_RETRY_SECONDS", 0.001)
    done: list[str] = []

    @uninterrupted
    def called_by_a_library() -> None:
        send()
        time.sleep(0.05)  # the signal comes again, and again
        done.append("called")

    def work() -> None:
        called_by_a_library()
        wait()
        done.append("worked")

    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        work()
    assert done == ["called"]


def test_what_is_unbroken_is_never_broken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """On a busy disk HDF5 writes longer than any number of signals, and fails if one is raised in what it calls."""
    monkeypatch.setattr(interrupts, "_MAX_RETRIES", 0)
    monkeypatch.setattr(interrupts, "_RETRY_SECONDS", PATIENCE)
    raised: list[str] = []

    class Raw(io.FileIO):
        def truncate(self, size: int | None = None) -> int:
            raised.append("truncate")
            send()
            return super().truncate(size)

        def tell(self) -> int:
            raised.append("tell")
            send()
            return super().tell()

        def seek(self, offset: int, whence: int = 0) -> int:
            raised.append("seek")
            send()
            return super().seek(offset, whence)

    def work() -> None:
        with Raw(tmp_path / "a.h5", "w+") as raw, h5py.File(DeferredErrorFile(raw), "w") as file:
            file["numbers"] = np.arange(10)
        raise_pending_signal()

    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        work()
    assert {"truncate", "seek"} <= set(raised)
    with h5py.File(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(file["numbers"], np.arange(10))


def test_an_import_without_end_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interrupts, "_RETRY_SECONDS", 0.001)
    (tmp_path / "endless_module.py").write_text(
        "import signal, time\nsignal.raise_signal(signal.SIGINT)\nwhile True: time.sleep(0.001)"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        __import__("endless_module")


@pytest.mark.parametrize("hook", ["excepthook", "unraisablehook"])
def test_what_is_printed_and_dropped_comes_again(hook: str, capsys: pytest.CaptureFixture[str]) -> None:
    """As USD does with what is raised in functions that it calls."""

    def work() -> None:
        try:
            send()
        except KeyboardInterrupt as error:
            told = (type(error), error, None)
            getattr(sys, hook)(*(told if hook == "excepthook" else [_Unraisable(*told)]))
        wait()

    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        work()
    assert capsys.readouterr().err == ""


class _Unraisable:
    def __init__(self, kind: type[BaseException], value: BaseException, _: None) -> None:
        self.exc_type, self.exc_value, self.exc_traceback = kind, value, None
        self.err_msg, self.object = None, None


def test_other_errors_are_printed_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []
    monkeypatch.setattr(sys, "excepthook", lambda *told_of: told.append(told_of))
    with signals_as_exceptions():
        sys.excepthook(ValueError, ValueError("odd"), None)
    assert [kind for kind, *_ in told] == [ValueError]


@pytest.mark.parametrize("write", [atomic_file, atomic_files])
def test_no_output_is_replaced_after_a_signal_was_swallowed(tmp_path: Path, write: Callable[..., Any]) -> None:
    (tmp_path / "a").write_text("old")

    def swallow() -> None:
        try:
            send()
        except KeyboardInterrupt:
            raise TypeError("something else") from None

    def work() -> None:
        with write(tmp_path / "a") as temporary:
            (temporary / "a" if temporary.is_dir() else temporary).write_text("new")
            with pytest.raises(TypeError):
                swallow()

    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        work()
    assert (tmp_path / "a").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_is_saved_in_answer_to_a_signal_is_saved(tmp_path: Path) -> None:
    with signals_as_exceptions():
        with pytest.raises(KeyboardInterrupt):
            send()
        acknowledge_signal()
        with atomic_file(tmp_path / "unsaved") as temporary:
            temporary.write_text("new")
    assert (tmp_path / "unsaved").read_text() == "new"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_files_are_moved_before_a_signal_ends_the_work(
    tmp_path: Path, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = Path.replace

    def interrupted(self: Path, target: Path) -> Path:
        if target.name == "a_1":
            send(number)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    with (
        pytest.raises((KeyboardInterrupt, SystemExit)),
        signals_as_exceptions(),
        atomic_files(tmp_path / "a_#") as folder,
    ):
        for name in ("a_1", "a_2"):
            (folder / name).write_text("new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a_1", "a_2"]


def test_what_fails_while_a_signal_waits_does_not_take_its_place() -> None:
    """As the answer of a process that Ctrl-C ended, too."""

    @uninterrupted
    def waiting() -> None:
        send()
        raise ValueError("the process has died")

    with pytest.raises(KeyboardInterrupt), signals_as_exceptions():
        waiting()


@pytest.mark.parametrize(("number", "kind"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)])
def test_what_fails_while_a_signal_cleans_up_does_not_take_its_place(
    tmp_path: Path, number: int, kind: type[BaseException]
) -> None:
    (tmp_path / "a").write_text("old")

    def work() -> None:
        with atomic_file(tmp_path / "a") as temporary, temporary.open("w") as file:
            try:
                file.write("new")
                send(number)
            finally:
                file.close()
                file.write("the end")  # a ValueError: the file is closed

    with pytest.raises(kind), signals_as_exceptions():
        work()
    assert (tmp_path / "a").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_fails_after_the_answer_to_a_signal_is_told() -> None:
    with pytest.raises(ValueError, match="odd"), signals_as_exceptions():
        with pytest.raises(KeyboardInterrupt):
            send()
        acknowledge_signal()
        raise ValueError("odd")


@pytest.mark.parametrize("function", ["delete_leftovers", "_claim_prefix", "_delete"])
def test_temporary_names_have_an_end_whenever_a_signal_comes(
    tmp_path: Path, function: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = getattr(temporary, function)

    def interrupted(*arguments: Any) -> Any:
        send()
        return usual(*arguments)

    monkeypatch.setattr(temporary, function, interrupted)
    with pytest.raises(KeyboardInterrupt), signals_as_exceptions(), atomic_file(tmp_path / "a") as file:
        file.write_text("new")
    monkeypatch.undo()
    assert [path.name for path in tmp_path.iterdir()] == (["a"] if function == "_delete" else [])


def test_signals_wait_in_programs_that_are_not_ours() -> None:
    steps: list[str] = []

    def work() -> None:
        with deferred_signals():
            send()
            steps.append("done")
        steps.append("not reached")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert steps == ["done"]


def test_what_is_ignored_stays_ignored() -> None:
    """As under nohup, or in the background of a shell."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with signals_as_exceptions(), deferred_signals():
        send()


def started(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the command line where a library that it imports does what a script says."""
    (folder / "click.py").write_text(textwrap.dedent(script))
    path = os.pathsep.join([str(folder), *sys.path])
    return subprocess.run(
        [sys.executable, "-m", "mixseq", "--help"],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "code", "said"), [("SIGINT", 130, "mixseq: interrupted\n"), ("SIGTERM", 143, "")])
def test_while_it_starts(tmp_path: Path, name: str, code: int, said: str) -> None:
    script = f"import signal, time\nsignal.raise_signal(signal.{name})\ntime.sleep(20)"
    ended = started(script, tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", said)
