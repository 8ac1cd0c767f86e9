"""Signals that end the work by an exception, so that what is half done is cleaned up, and that nothing swallows.

What a handler raises is raised wherever Python happens to be. If that is inside a library in C that called Python, a
module that is being imported or a callback, the library may print or drop it, and the work goes on: USD does so with
an interrupt that falls into ``import pxr``; HDF5 dies of one that falls into its file. So signals wait until imports
are done, and functions that are `unbroken`, come again when they were seen to be swallowed, and are looked for once
more before a file gets its name. What fails meanwhile, as a process that Ctrl-C ended, too, or when half of the work is
cleaned up, does not take a signal's place. All this is for programs, as the command line: whoever uses the library
decides what a signal does.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import CodeType, FrameType, FunctionType
from typing import Any, NoReturn, TypeVar, cast

ENDING = [
    signal.SIGINT,
    signal.SIGTERM,
    *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []),
]  # Windows: not
_LATER = 0.1  # seconds
_PATIENCE = 50  # times that an import, or an unbroken function, is waited for

_unbroken: set[CodeType] = set()
_Function = TypeVar("_Function", bound=Callable[..., Any])

_arrived: int | None = None
"""The signal that is to end the work, from when it came until the work has ended."""


@contextmanager
def unwinding() -> Iterator[None]:
    """Let signals end the block by an exception: `KeyboardInterrupt`, or `SystemExit` with the code 128 + number."""
    global _arrived
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    again: list[threading.Timer] = []

    def come_again(number: int) -> None:
        again.append(threading.Timer(_LATER, os.kill, (os.getpid(), number)))
        again[-1].daemon = True
        again[-1].start()

    def leave(number: int, frame: FrameType | None) -> None:
        global _arrived
        _arrived = number
        if _must_wait(frame) and len(again) < _PATIENCE:
            come_again(number)
        else:
            _end(number)

    def swallowed(usual: Callable[..., None], kind: type[BaseException], *arguments: Any) -> None:
        """What was raised while a library in C called Python: it is printed and lost, and the work goes on."""
        if issubclass(kind, SystemExit | KeyboardInterrupt):
            come_again(signal.SIGINT if issubclass(kind, KeyboardInterrupt) else signal.SIGTERM)
        else:
            usual(*arguments)

    hooks = sys.unraisablehook, sys.excepthook
    # One that is ignored stays so, as under nohup, or in the background of a shell.
    before = {number: signal.getsignal(number) for number in ENDING}
    handled = [number for number in ENDING if before[number] not in (signal.SIG_IGN, None)]
    for number in handled:
        signal.signal(number, leave)
    sys.unraisablehook = lambda told: swallowed(hooks[0], told.exc_type, told)
    sys.excepthook = lambda kind, *rest: swallowed(hooks[1], kind, kind, *rest)
    try:
        yield
    except Exception:
        raise_swallowed()
        raise
    finally:
        for timer in again:
            timer.cancel()
        sys.unraisablehook, sys.excepthook = hooks
        for number in handled:
            signal.signal(number, before[number])
        _arrived = None


def unbroken(function: _Function) -> _Function:
    """Let signals wait for the end of a function, which a library in C calls that no exception may pass through."""
    _unbroken.add(cast("FunctionType", function).__code__)
    return function


@contextmanager
def held() -> Iterator[None]:
    """Let signals wait for the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in ENDING}
    handled = [number for number in ENDING if callable(before[number])]
    for number in handled:
        signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, before[number])
    if came:
        signal.raise_signal(came[0])


def raise_swallowed() -> None:
    """End the work here, if it goes on though a signal came."""
    if _arrived is not None and threading.current_thread() is threading.main_thread():
        _end(_arrived)


def answered() -> None:
    """Say that the work ends as the signal asks: what is still done is meant."""
    global _arrived
    _arrived = None


def _end(number: int) -> NoReturn:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


def _must_wait(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code in _unbroken or frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
