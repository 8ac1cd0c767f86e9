"""Files outside of a case's folder that nobody has a reason to open, each with a text that must not be printed.

Linux tells which of them were opened (inotify), by whatever library.
"""

from __future__ import annotations

import ctypes
import os
import struct
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

MARK = "SECRETCANARY7391"
NUMBER = 0.7391739173917391
_OPENED = 0x20  # IN_OPEN
_EVENT = struct.Struct("iIII")


@dataclass(frozen=True)
class Canary:
    """A watched folder of files, and what is at their places."""

    folder: Path
    watch: int

    @property
    def paths(self) -> list[str]:
        """The files, as a hostile file would name them: absolute."""
        return sorted(str(file) for file in self.folder.iterdir())

    def opened(self) -> list[str]:
        """Return which of them were opened since this was last asked."""
        try:
            events = os.read(self.watch, 1 << 16)
        except BlockingIOError:
            return []
        names, at = [], 0
        while at < len(events):
            *_, length = _EVENT.unpack_from(events, at)
            at += _EVENT.size
            names.append(events[at : at + length].rstrip(b"\0").decode())
            at += length
        return sorted({name for name in names if name})


def lay_out(folder: Path) -> Canary:
    """Write the files and watch them."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "secret.txt").write_text(f"{MARK}\n" * 50)
    (folder / "secret.csv").write_text(f"{MARK},1\n{MARK},2\n")
    (folder / "secret.png").write_bytes(b"\x89PNG\r\n\x1a\n" + MARK.encode() * 50)
    (folder / "secret.bin").write_bytes(np.full(20_000, NUMBER).tobytes())
    (folder / "secret.usda").write_text('#usda 1.0\ndef Mesh "other" {}\n')  # layers may name layers
    with h5py.File(folder / "secret.h5", "w") as file:
        file["points"] = np.full((4, 24, 3), NUMBER)
        file["times"] = np.arange(4) * NUMBER
        file.attrs["name"] = MARK
    library = ctypes.CDLL(None, use_errno=True)
    watch = library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    if watch < 0 or library.inotify_add_watch(watch, os.fsencode(folder), _OPENED) < 0:
        raise OSError(ctypes.get_errno(), "cannot watch files")
    return Canary(folder, watch)
