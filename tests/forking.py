"""A forked process, for tests of what it must not share with the one that it was forked from."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

_PATIENCE = 30  # seconds


def in_a_fork(function: Callable[[], object]) -> str:
    """Return what a function returns in a forked process, or the error that it raises there, as text."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        signal.alarm(_PATIENCE)  # whatever waits for threads that are not there
        try:
            text = str(function())
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        os.write(writer, text.encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as answer:
        text = answer.read().decode()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    return text
