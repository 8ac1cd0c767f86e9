"""Temporary names beside a target, and removal of those left by killed writers.

Names of a writer begin with ``.mixseq.HOST.RANDOM``, with a lock on the file of that name with ``.lock``, which the
system releases when the process ends. The next writer in the folder deletes unlocked files. Without locks, and for
other hosts, whose locks may be invisible on a shared disk, it deletes files older than a day. Files that were put away
and not replaced are restored.
"""

from __future__ import annotations

import os
import platform
import re
import secrets
import shutil
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mixseq.interrupts import held

_OLD = 24 * 3600.0  # seconds
_HOST = re.sub(r"[^\w-]", "-", platform.node())[:32] or "host"
_AWAY = ".old."
_NAME = re.compile(r"\.mixseq\.([\w-]+)\.[^.]{8}(?=\.|$)")


@contextmanager
def temporary_name(folder: Path) -> Iterator[Path]:
    """Yield a unique name prefix in a folder; files with it are deleted at the end."""
    claimed: list[tuple[Path, int]] = []
    try:
        with held():  # a signal between a name and its end would leave it to the next writer
            clear(folder)
            claimed.append(_claim(folder))
        yield claimed[0][0]
    finally:
        with held():
            for name, descriptor in claimed:
                _delete(folder, [entry for entry in _entries(folder) if entry.startswith(name.name)])
                os.close(descriptor)


def _claim(folder: Path) -> tuple[Path, int]:
    """Return a new name prefix and its lock."""
    while True:
        name = folder / f".mixseq.{_HOST}.{secrets.token_hex(4)}"
        descriptor = os.open(f"{name}.lock", os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        if _locked(descriptor) is not False and Path(f"{name}.lock").exists():
            return name, descriptor
        os.close(descriptor)  # somebody who clears the folder was quicker


def put_away(name: Path, target: Path) -> Path:
    """Return where to keep the old target while it is replaced."""
    return Path(f"{name}{_AWAY}{target.name}")


def clear(folder: Path) -> None:
    """Delete files left in a folder by writers that have ended."""
    found = defaultdict(list)
    for entry in _entries(folder):
        if match := _NAME.match(entry):
            found[match[0], match[1]].append(entry)
    for (name, host), entries in found.items():
        with _lock_of(folder / f"{name}.lock") as ours:
            if _old(folder, entries) if host != _HOST or ours is None else ours:
                _delete(folder, entries)


@contextmanager
def _lock_of(file: Path) -> Iterator[bool | None]:
    """Yield whether a writer's lock could be acquired; None if that is unknown."""
    try:
        descriptor = os.open(file, os.O_RDWR)
    except OSError:
        yield None
        return
    try:
        yield _locked(descriptor)
    finally:
        os.close(descriptor)


def _locked(descriptor: int) -> bool | None:
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some file systems have no locks
        return None
    return True


def _old(folder: Path, entries: list[str]) -> bool:
    """Whether some files, and all files in these folders, were last modified more than a day ago."""
    paths = [folder / entry for entry in entries]
    paths += [inner for path in paths if path.is_dir() for inner in path.rglob("*")]
    with suppress(OSError):
        return time.time() - max(path.lstat().st_mtime for path in paths) > _OLD
    return False


def _entries(folder: Path) -> list[str]:
    try:
        return [path.name for path in folder.glob(".mixseq.*")]
    except OSError:  # reported when the file is written
        return []


def _delete(folder: Path, entries: list[str]) -> None:
    """Delete files and folders, the lock last, so that an interrupted deletion is completed by the next writer."""
    for entry in sorted(entries, key=lambda entry: entry.endswith(".lock")):
        with suppress(OSError):
            path = folder / entry
            _, away, target = entry.partition(_AWAY)
            if away and not os.path.lexists(folder / target):
                path.rename(folder / target)
            elif path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()
