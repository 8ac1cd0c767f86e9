"""The command line, ``mixseq`` or ``python -m mixseq``; Ctrl-C is handled even during imports."""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import NoReturn


def _exit(number: int, frame: FrameType | None) -> NoReturn:
    """Exit at once, as no work has begun."""
    if number == signal.SIGINT:
        os.write(2, b"mixseq: interrupted\n")
    os._exit(128 + number)


def exit_on_signals() -> None:
    """Let Ctrl-C exit at once, until work begins."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:  # signals are ignored in the background of a shell
            signal.signal(number, _exit)


def main() -> None:
    """Run the command line."""
    exit_on_signals()
    from mixseq.cli import main as run

    run()


if __name__ == "__main__":
    main()
