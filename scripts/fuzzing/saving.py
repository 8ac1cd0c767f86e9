"""``mixseq view`` with somebody who saves again and again, for `kills`; arguments are MODEL and the file to write."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

from mixseq.__main__ import listen


def run() -> None:
    """Run the viewer, which heeds Ctrl-C from the start, as the command does."""
    listen()
    from mixseq.cli import main
    from mixseq.viewing import live

    usual = live.viewer

    @contextmanager
    def saving(*settings: Any) -> Iterator[Any]:
        with usual(*settings) as running:
            Thread(target=_save, args=(running.session,), daemon=True).start()
            yield running

    live.viewer = saving  # type: ignore[assignment]
    main(["view", sys.argv[1], "--no-browser"], prog_name="mixseq")


def _save(session: Any) -> None:
    while True:
        session.save(Path(sys.argv[2]), replace=True)
        time.sleep(0.2)


run()
