"""Raise exceptions for signals, so that work ends with cleanup, even if a library swallows the exception.

Python raises the exception of a signal handler at any point. Inside a C library that called Python (an import, a
callback), the exception may be lost: USD drops interrupts during ``import pxr``; HDF5 crashes on an interrupt while it
uses a file. So signals are deferred until imports and `uninterrupted` functions return, raised again if swallowed, and
checked before a file gets its final name. If another error is raised meanwhile, the signal is raised instead.

This module is for programs such as the command line; callers of the library handle signals themselves.
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

HANDLED_SIGNALS = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]

_RETRY_SECONDS = 0.1
_MAX_RETRIES = 50  # number of retries while an import runs; it may never end

_uninterrupted: set[CodeType] = set()
_Function = TypeVar("_Function", bound=Callable[..., Any])

_pending: int | None = None
"""The received signal that ends the work, or None."""


@contextmanager
def signals_as_exceptions() -> Iterator[None]:
    """Let signals end the block by an exception: `KeyboardInterrupt`, or `SystemExit` with the code 128 + number."""
    global _pending
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread receives signals
        return
    retries: list[threading.Timer] = []

    def resend(number: int) -> None:
        retries.append(threading.Timer(_RETRY_SECONDS, os.kill, (os.getpid(), number)))
        retries[-1].daemon = True
        retries[-1].start()

    def handle(number: int, frame: FrameType | None) -> None:
        global _pending
        _pending = number
        if _is_deferred(frame, may_import=len(retries) < _MAX_RETRIES):
            resend(number)
        else:
            _raise(number)

    def resend_swallowed(hook: Callable[..., None], kind: type[BaseException], *arguments: Any) -> None:
        """Send the signal again if its exception was dropped by a C library that called Python."""
        if issubclass(kind, SystemExit | KeyboardInterrupt):
            resend(signal.SIGINT if issubclass(kind, KeyboardInterrupt) else signal.SIGTERM)
        else:
            hook(*arguments)

    hooks = sys.unraisablehook, sys.excepthook
    # Ignored signals stay ignored, as under nohup or in the background of a shell.
    handlers = {number: signal.getsignal(number) for number in HANDLED_SIGNALS}
    handled = [number for number in HANDLED_SIGNALS if handlers[number] not in (signal.SIG_IGN, None)]
    for number in handled:
        signal.signal(number, handle)
    sys.unraisablehook = lambda event: resend_swallowed(hooks[0], event.exc_type, event)
    sys.excepthook = lambda kind, *rest: resend_swallowed(hooks[1], kind, kind, *rest)
    try:
        yield
    except Exception:
        raise_pending_signal()
        raise
    finally:
        for timer in retries:
            timer.cancel()
        sys.unraisablehook, sys.excepthook = hooks
        for number in handled:
            signal.signal(number, handlers[number])
        _pending = None


def uninterrupted(function: _Function) -> _Function:
    """Defer signals to the end of a function called by a C library, where exceptions would be lost."""
    _uninterrupted.add(cast("FunctionType", function).__code__)
    return function


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Defer signals to the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    handlers = {number: signal.getsignal(number) for number in HANDLED_SIGNALS}
    handled = [number for number in HANDLED_SIGNALS if callable(handlers[number])]
    for number in handled:
        signal.signal(number, lambda number, _: received.append(number))
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, handlers[number])
    if received:
        signal.raise_signal(received[0])


@contextmanager
def blocked_interrupts() -> Iterator[None]:
    """Start processes that Ctrl-C, which goes to all processes of a terminal, does not end before they ignore it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def raise_pending_signal() -> None:
    """Raise the exception of a signal that was swallowed."""
    if _pending is not None and threading.current_thread() is threading.main_thread():
        _raise(_pending)


def acknowledge_signal() -> None:
    """Mark the signal as handled, so that the remaining work is not interrupted."""
    global _pending
    _pending = None


def _raise(number: int) -> NoReturn:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


def _is_deferred(frame: FrameType | None, may_import: bool) -> bool:
    """Return whether an `uninterrupted` function, or an import that may go on, is on the stack."""
    while frame is not None:
        if frame.f_code in _uninterrupted:
            return True
        if may_import and frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
