"""Run a function in a process of its own, with limits of memory, processor time and wall-clock time.

The process is forked from one that has imported what it needs already, so that it starts in milliseconds. It leads a
group of processes, which is killed as a whole when it has ended or its time is over.
"""

from __future__ import annotations

import os
import resource
import select
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

CPU_SECONDS = 60
WALL_SECONDS = 240
MORE_MEMORY = 4 << 30
"""Bytes of address space beyond those of the process that forks."""


@dataclass(frozen=True)
class Ended:
    """Exit code (negative for a signal), whether time was over, what was printed, and by how much the process grew."""

    code: int
    is_hung: bool
    text: str
    megabytes: float


def forked(function: Callable[[], int], log: Path) -> Ended:
    """Call a function in a forked process, which ends with what it returns; `log` is a file for what it prints."""
    before = _own_bytes("VmRSS") / 2**20
    sys.stdout.flush()
    sys.stderr.flush()
    process = os.fork()
    if process == 0:
        _run(function, log)
    ended = os.pidfd_open(process)
    try:
        ready, _, _ = select.select([ended], [], [], WALL_SECONDS)
    finally:
        os.close(ended)
    with suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)
    _, status, usage = os.wait4(process, 0)
    code = os.waitstatus_to_exitcode(status)
    text = log.read_text(encoding="utf-8", errors="surrogateescape")
    return Ended(code, not ready or code == -signal.SIGXCPU, text, max(0.0, usage.ru_maxrss / 1024 - before))


def _run(function: Callable[[], int], log: Path) -> None:
    code = 70
    try:
        os.setsid()
        _, most = resource.getrlimit(resource.RLIMIT_AS)  # Node.js reserves more than it uses, and raises the limit
        resource.setrlimit(resource.RLIMIT_AS, (_own_bytes("VmSize") + MORE_MEMORY, most))
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 5))
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        printed = os.open(log, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o644)
        for number in (1, 2):
            os.dup2(printed, number)
        sys.stdout, sys.stderr = (
            os.fdopen(number, "w", encoding="utf-8", errors="surrogateescape") for number in (1, 2)
        )
        code = function()
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)


def _own_bytes(field: str) -> int:
    """Return a size in bytes that the system has of this process."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith(f"{field}:"))
