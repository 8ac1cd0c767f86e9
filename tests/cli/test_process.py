"""The command line as a process of its own: interrupts, pipes, terminals, imports."""

from __future__ import annotations

import os
import platform
import re
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import mixseq
from mixseq.__main__ import LARGE_BLOCK_BYTES
from mixseq.cli.group import progress_bar
from mixseq.runtime.progress import log_progress
from tests.meshes import bar

pytestmark = pytest.mark.slow

MIXSEQ = str(Path(sysconfig.get_path("scripts")) / "mixseq")
PATIENCE = 30.0  # seconds until we give up


@pytest.fixture(scope="module")
def big(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence that takes seconds to encode, and about as long to write as text."""
    file = tmp_path_factory.mktemp("big") / "big.npz"
    mixseq.write(file, bar(sides=40, rings=200, frames=60))
    return file


def wait_until(condition: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    """Wait for a sign that a process is at work."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert process.poll() is None, "it ended before it could be interrupted"
        assert time.monotonic() < end, "it did not start to work"
        time.sleep(0.005)


class Terminal:
    """A terminal for the stderr of a process, and what appeared on it."""

    def __init__(self) -> None:
        self._ours, self.theirs = os.openpty()
        os.set_blocking(self._ours, False)
        self._shown = b""

    def shown(self) -> str:
        """Return all text so far, without colours and movements of the cursor."""
        try:
            while more := os.read(self._ours, 1 << 16):
                self._shown += more
        except OSError:  # nothing more for now, or nobody at the other end
            pass
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self._shown.decode(errors="replace"))

    def close(self) -> None:
        os.close(self._ours)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    made.close()


def start(terminal: Terminal, folder: Path, *arguments: str) -> subprocess.Popen[bytes]:
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    process = subprocess.Popen(
        [MIXSEQ, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=terminal.theirs, env=environment
    )
    os.close(terminal.theirs)
    return process


def interrupt(process: subprocess.Popen[bytes]) -> tuple[int, bytes]:
    """Press Ctrl-C; return the exit code and stdout."""
    process.send_signal(signal.SIGINT)
    stdout, _ = process.communicate(timeout=PATIENCE)
    return process.returncode, stdout


@pytest.mark.usefixtures("interruptible")
def test_interrupt_while_encoding(big: Path, tmp_path: Path, terminal: Terminal) -> None:
    target = tmp_path / "big.h5"
    target.write_bytes(b"somebody's work")
    with start(terminal, tmp_path, "encode", str(big), "big.h5") as process:
        try:
            wait_until(lambda: "finding parts" in terminal.shown(), process)
            assert interrupt(process) == (130, b"")
        finally:
            process.kill()
    assert terminal.shown().rstrip().endswith("mixseq: interrupted")
    assert "Traceback" not in terminal.shown()
    assert list(tmp_path.iterdir()) == [target]
    assert target.read_bytes() == b"somebody's work"


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("name", ["big_####.obj", "big.h5"])
def test_interrupt_while_writing(big: Path, tmp_path: Path, terminal: Terminal, name: str) -> None:
    with start(terminal, tmp_path, "convert", str(big), name) as process:
        try:
            wait_until(lambda: any(path.is_file() for path in tmp_path.rglob("*")), process)
            assert {path.name[0] for path in tmp_path.iterdir()} == {"."}
            assert interrupt(process) == (130, b"")
        finally:
            process.kill()
    assert terminal.shown().rstrip().endswith("mixseq: interrupted")
    assert list(tmp_path.iterdir()) == []


def test_termination_while_writing(big: Path, tmp_path: Path, terminal: Terminal) -> None:
    target = tmp_path / "big.h5"
    target.write_bytes(b"somebody's work")
    with start(terminal, tmp_path, "convert", str(big), "big.h5") as process:
        try:
            wait_until(lambda: len(list(tmp_path.iterdir())) > 1, process)
            process.terminate()
            stdout, _ = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert (process.returncode, stdout) == (128 + signal.SIGTERM, b"")
    assert "Traceback" not in terminal.shown()
    assert list(tmp_path.iterdir()) == [target]
    assert target.read_bytes() == b"somebody's work"


def test_progress_on_a_terminal(folder: Path, terminal: Terminal) -> None:
    command = ("encode", "bar.npz", "new.h5", "--space", "vertex")
    with start(terminal, folder, *command) as process:
        try:
            while process.poll() is None:
                terminal.shown()  # somebody has to read: a terminal takes a few kB, and then writing to it waits
                time.sleep(0.01)
        finally:
            process.kill()
    assert process.returncode == 0
    assert "choosing modes and knots" in terminal.shown()


def test_progress_is_silent_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    with progress_bar(quiet=False) as progress:
        assert progress is log_progress
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress_bar(quiet=True) as progress:
        assert progress is log_progress


def test_a_broken_pipe_is_quiet(folder: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        result = subprocess.run(
            [MIXSEQ, "info", "bar.npz"], cwd=folder, stdout=writer, stderr=subprocess.PIPE, timeout=PATIENCE
        )
    finally:
        os.close(writer)
    assert (result.returncode, result.stderr) == (1, b"")


HELP = """
import sys
from mixseq.cli import main
for name in [None, *main.list_commands(None)]:
    try:
        main([*([name] if name else []), "--help"])
    except SystemExit as exit:
        assert not exit.code
heavy = {"h5py", "matplotlib", "mixseq_io", "numpy", "pxr", "rich", "scipy", "trimesh"}
print("loaded:", sorted(heavy & set(sys.modules)))
"""


def test_help_imports_no_numerical_packages() -> None:
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", HELP], capture_output=True, timeout=PATIENCE, text=True, check=True
    )
    assert result.stdout.endswith("loaded: []\n")
    assert result.stderr == ""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have no such setting")
def test_freed_arrays_are_returned_to_the_system() -> None:
    """Also those that are smaller than one before, which glibc keeps by default."""
    program = """
import os, resource
import numpy as np
from mixseq.__main__ import return_large_blocks

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()

return_large_blocks()
np.ones(3 << 20)
array = np.ones(2 << 20)
before = resident()
del array
print(before - resident() > 15e6, os.environ["MALLOC_MMAP_THRESHOLD_"])
"""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC")}
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment)
    assert run.stdout.split() == ["True", str(LARGE_BLOCK_BYTES)]
