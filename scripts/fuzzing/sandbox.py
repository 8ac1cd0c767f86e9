"""Run cases one after another in a forked process, each under limits of memory, processor time and wall-clock time.

A case that ends the process, or is still running when its time is over, is the one that was sent last; the next case
gets another process. The process leads a group, which is killed as a whole.
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
from typing import IO, NoReturn

CPU_SECONDS = 60
WALL_SECONDS = 240
MAX_ADDED_BYTES = 4 << 30
"""Bytes of address space beyond those of the process that forks."""

MAX_CASES = 1000
"""Cases that a process runs before another takes over, so that no state piles up."""


@dataclass(frozen=True)
class Ended:
    """Exit code (negative for a signal), whether time was over, what was printed, and by how much a process grew."""

    code: int
    is_hung: bool
    text: str
    megabytes: float


class Sandbox:
    """Process that calls a function with the name of each case and returns its exit code; `log` has what it prints."""

    def __init__(self, function: Callable[[str], int], log: Path) -> None:
        self._function = function
        self._log = log
        self._process = 0
        self._done = 0

    def run(self, case: str) -> Ended:
        """Run a case."""
        if not self._process:
            self._start()
        self._cases.write(f"{case}\n")
        ready, _, _ = select.select([self._answers], [], [], WALL_SECONDS)
        answer = self._answers.readline().split() if ready else []
        code, megabytes = (int(answer[0]), float(answer[1])) if answer else (self.close(), 0.0)
        self._done += 1
        if self._done == MAX_CASES:
            self.close()
        text = self._log.read_text(encoding="utf-8", errors="surrogateescape")
        return Ended(code, not ready or code == -signal.SIGPROF, text, megabytes)

    def close(self) -> int:
        """End the process with all that it started, and return its exit code."""
        if not self._process:
            return 0
        self._cases.close()
        self._answers.close()
        with suppress(ProcessLookupError):
            os.killpg(self._process, signal.SIGKILL)
        _, status = os.waitpid(self._process, 0)
        self._process = 0
        return os.waitstatus_to_exitcode(status)

    def _start(self) -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        (cases, send), (answers, answer) = os.pipe(), os.pipe()
        self._process, self._done = os.fork(), 0
        if not self._process:
            os.close(send)
            os.close(answers)
            self._serve(os.fdopen(cases), os.fdopen(answer, "w", buffering=1))
        os.close(cases)
        os.close(answer)
        self._cases, self._answers = os.fdopen(send, "w", buffering=1), os.fdopen(answers)

    def _serve(self, cases: IO[str], answers: IO[str]) -> NoReturn:
        os.setsid()
        _, most = resource.getrlimit(resource.RLIMIT_AS)  # Node.js reserves more than it uses, and raises the limit
        resource.setrlimit(resource.RLIMIT_AS, (_kilobytes("VmSize") * 1024 + MAX_ADDED_BYTES, most))
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        printed = os.open(self._log, os.O_CREAT | os.O_WRONLY | os.O_TRUNC | os.O_APPEND, 0o644)
        for number in (1, 2):
            os.dup2(printed, number)
        sys.stdout, sys.stderr = (
            os.fdopen(number, "w", encoding="utf-8", errors="surrogateescape") for number in (1, 2)
        )
        for case in cases:
            os.ftruncate(printed, 0)
            for process in _processes():
                with suppress(OSError):  # a process that has just ended
                    Path(f"/proc/{process}/clear_refs").write_text("5", encoding="ascii")  # peaks start again
            before = _kilobytes("VmRSS")
            signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)  # nothing handles its signal
            try:
                code = self._function(case.strip())
            except BaseException:
                traceback.print_exc()
                code = 70
            signal.setitimer(signal.ITIMER_PROF, 0)
            sys.stdout.flush()
            sys.stderr.flush()
            grown = max(_kilobytes("VmHWM", each) - (before if each == "self" else 0) for each in _processes())
            answers.write(f"{code} {grown / 1024}\n")
        os._exit(0)


def _processes() -> list[str]:
    """Return this process and its children, as the system names them."""
    return ["self", *Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="ascii").split()]


def _kilobytes(field: str, process: str = "self") -> int:
    """Return a size that the system has of a process; 0 if it has ended."""
    with suppress(OSError):
        lines = Path(f"/proc/{process}/status").read_text(encoding="ascii").splitlines()
        return next((int(line.split()[1]) for line in lines if line.startswith(f"{field}:")), 0)
    return 0
