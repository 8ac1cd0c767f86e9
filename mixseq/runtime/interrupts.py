"""Signals that end work by an exception, with cleanup, and that no library swallows.

Python raises a handler's exception at any point. Inside a C library that called Python (an import, a callback) it may
be dropped: USD drops interrupts during ``import pxr``; HDF5 crashes on one in its file. So signals are deferred until
imports and `unbroken` functions return, raised again if swallowed, and checked before a file gets its final name. This
is for programs such as the command line; in the library the caller handles signals.
An error raised while a deferred signal unwinds does not replace the signal.
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
"""The signal that ends the work, from its arrival until the end of the work."""


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
        """Send the signal again if its exception was raised where a C library called Python, and is dropped."""
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
    """Defer signals to the end of a function called by a C library, where exceptions would be lost."""
    _unbroken.add(cast("FunctionType", function).__code__)
    return function


@contextmanager
def held() -> Iterator[None]:
    """Defer signals to the end of the block."""
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
    """Raise the exception of a signal that was swallowed."""
    if _arrived is not None and threading.current_thread() is threading.main_thread():
        _end(_arrived)


def answered() -> None:
    """Mark the signal as handled: the remaining work is intended."""
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
