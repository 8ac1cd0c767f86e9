"""USD's diagnostics, printed to stderr from C++ or raised with C++ file names, turned into mixseq's errors.

Specification: https://openusd.org/release/api/page_tf__diagnostic.html
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import shorten

from pxr import Sdf, Tf, UsdUtils

from mixseq.errors import FormatError, OutputError
from mixseq_io.atomic import raise_system_error
from mixseq_io.memory import out_of_memory

_LONGEST_REASON = 200

_TEMPORARY = re.compile(r"\.mixseq\.[\w-]+\.[0-9a-f]{8}(?:(\.new)|\.\w+)")
"""Temporary file names, see `mixseq_io.atomic` and `mixseq_io.usd.clips`."""


@contextmanager
def quiet() -> Iterator[list[str]]:
    """Yield a list that collects USD's warnings; it is complete when the block ends."""
    messages: list[str] = []
    delegate = UsdUtils.CoalescingDiagnosticDelegate()  # listens as long as it lives
    try:
        yield messages
    finally:
        messages.extend(_text(report) for report in delegate.TakeUncoalescedDiagnostics())
        del delegate


@contextmanager
def reading_usd(path: Path) -> Iterator[None]:
    """Translate USD's errors (`RuntimeError`), and those of damaged values, about a file read into `FormatError`."""
    try:
        yield
    except MemoryError:
        raise out_of_memory(path) from None
    except (RuntimeError, ValueError, TypeError) as error:
        raise FormatError(
            f"{path} cannot be read as USD; it is damaged, truncated or of another type ({_reasons(error)})"
        ) from error


@contextmanager
def writing_usd(path: Path) -> Iterator[None]:
    """Translate USD's errors about a file that is written into `OutputError`, except for errors of the system."""
    try:
        yield
    except Tf.ErrorException as error:
        reasons = _reasons(error)
        raise_system_error(reasons, path.resolve().parent)
        named = _TEMPORARY.sub(lambda found: f"{path.name}{'.clips' if found[1] else ''}", reasons)
        short = shorten(named, _LONGEST_REASON, placeholder=" ...")
        raise OutputError(
            f"cannot write {path}: {short}; check the free space of the disk and the path"
        ) from error


def save_layer(layer: Sdf.Layer) -> None:
    """Save a layer; raise an error even if USD gives no reason."""
    if not layer.Save():
        raise Tf.ErrorException("USD does not save it, and does not say why")


def _reasons(error: Exception) -> str:
    return "; ".join(dict.fromkeys(map(_text, error.args))) or type(error).__name__


def _text(report: object) -> str:
    """Return a diagnostic, or an argument of another error, in one line."""
    try:
        return " ".join(str(getattr(report, "commentary", report)).split())
    except UnicodeDecodeError:  # the message quotes a damaged file
        return "what it holds is not text"
