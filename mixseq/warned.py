"""Forwarding of mixseq's warnings to a display."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from mixseq.errors import MixseqWarning


@contextmanager
def warnings_heard(hear: Callable[[str], None], instead: bool = False) -> Iterator[None]:
    """Call a function with the text of every `MixseqWarning`."""
    usual: Callable[..., None] = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        ours = issubclass(category, MixseqWarning)
        if not (ours and instead):
            usual(message, category, *where, **more)
        if ours:
            hear(str(message))

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual
