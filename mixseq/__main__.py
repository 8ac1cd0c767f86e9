"""The command line, as ``mixseq`` or ``python -m mixseq``; Ctrl-C is heard while it is still being imported."""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import NoReturn


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    """End at once: nothing has begun yet, or everything is done."""
    if number == signal.SIGINT:
        os.write(2, b"mixseq: interrupted\n")
    os._exit(128 + number)


def listen() -> None:
    """Let Ctrl-C end the program at once, until it has begun to work."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:  # as in the background of a shell
            signal.signal(number, _leave)


def main() -> None:
    """Run the command line."""
    listen()
    from mixseq.cli import main as run

    run()


if __name__ == "__main__":
    main()
