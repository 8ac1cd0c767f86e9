"""Caches of models and decoded frames, up to a limit, for fast scrubbing.

Blender draws on one thread and renders on another, so both are behind a lock.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path
from threading import Lock

from mixseq.arrays import Single
from mixseq.errors import FormatError, MixseqError
from mixseq.signals.model import Model

MEMORY = 512 << 20
"""Bytes of cached frames by default."""


class Frames:
    """A cache of arrays, limited by memory; the least recently used are dropped."""

    def __init__(self, memory: int = MEMORY) -> None:
        self.memory = memory
        self._kept: OrderedDict[Hashable, Single] = OrderedDict()
        self._size = 0
        self._lock = Lock()

    @property
    def size(self) -> int:
        """Bytes in use."""
        return self._size

    def get(self, key: Hashable, make: Callable[[], Single]) -> Single:
        """Return the cached array of a key, or else the result of `make`."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = make()  # without the lock, so that cached frames stay available
        made.setflags(write=False)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made
                self._size += made.nbytes
            while self._size > self.memory and len(self._kept) > 1:
                self._size -= self._kept.popitem(last=False)[1].nbytes
        return made

    def clear(self) -> None:
        """Empty the cache."""
        with self._lock:
            self._kept.clear()
            self._size = 0


class Models:
    """A cache of models by their files, read again when these change."""

    def __init__(self, load: Callable[[Path], Model]) -> None:
        self._load = load
        self._read: dict[Path, tuple[tuple[int, int], Model | MixseqError]] = {}
        self._lock = Lock()

    def get(self, path: Path) -> Model:
        """Return the model in a file, the same object until the file changes."""
        try:
            told = path.stat()
        except OSError as error:
            raise FormatError(f"{path}: {error.strerror or error}; choose the file again") from None
        state = told.st_mtime_ns, told.st_size
        with self._lock:
            known, found = self._read.get(path, (None, None))
            if found is None or known != state:
                try:
                    found = self._load(path)
                except MixseqError as error:
                    found = error
                self._read[path] = state, found
        if isinstance(found, MixseqError):
            raise found
        return found

    def clear(self) -> None:
        """Empty the cache."""
        with self._lock:
            self._read.clear()
