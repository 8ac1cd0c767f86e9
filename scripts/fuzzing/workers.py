"""Reader processes that are forked, not started: a case costs milliseconds, not half a second.

What they do is the same: `mixseq_io.worker` with its own limits, asked over pipes.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from types import SimpleNamespace
from typing import IO, Any

from mixseq_io import isolation, worker


class ForkedProcess:
    """The part of `subprocess.Popen` that readers in a process of their own need."""

    def __init__(self, *command: Any, **settings: Any) -> None:
        questions, ask = os.pipe()
        answer, answers = os.pipe()
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        self.returncode: int | None = None
        if self.pid == 0:
            _serve(questions, answers)
        os.close(questions)
        os.close(answers)
        self.stdin: IO[bytes] = os.fdopen(ask, "wb")
        self.stdout: IO[bytes] = os.fdopen(answer, "rb")

    def poll(self) -> int | None:
        """Return the exit code, if it has ended."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; case and sandbox have limits of time themselves."""
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode

    def kill(self) -> None:
        """End it."""
        if self.returncode is None:
            os.kill(self.pid, signal.SIGKILL)


def _serve(questions: int, answers: int) -> None:
    try:
        os.dup2(questions, 0)
        os.dup2(answers, 1)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        # Pipes of other workers would keep these from seeing their end.
        os.closerange(3, os.sysconf("SC_OPEN_MAX") if os.sysconf("SC_OPEN_MAX") < 4096 else 4096)
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        sys.stdin = os.fdopen(0, "r")
        worker.main()
    finally:
        os._exit(1)


def fork_workers() -> None:
    """Let readers be forked from now on, in this process and those that it forks."""
    known = {name: getattr(subprocess, name) for name in ("PIPE", "DEVNULL", "TimeoutExpired")}
    vars(isolation)["subprocess"] = SimpleNamespace(Popen=ForkedProcess, **known)
