"""Atomic output: files are written beside the target, then moved over it.

A rename within a folder is atomic (https://pubs.opengroup.org/onlinepubs/9799919799/functions/rename.html): readers see
the old file or the new one, and after an error, a full disk or Ctrl-C the old one is unchanged. The new file is flushed
to disk first, since a power cut could otherwise leave it empty. Signals wait while files are moved.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mixseq.errors import OutputError
from mixseq.interrupts import held, raise_swallowed
from mixseq_io.temporary import temporary_name


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path to write to; it becomes `path` if the block ends without an exception."""
    target = Path(os.path.realpath(path))
    with _explaining(target):
        _check_target(target)
        with temporary_name(target.parent) as name:
            temporary = Path(f"{name}{target.suffix}")
            yield temporary
            if target.exists():
                shutil.copymode(target, temporary)
            _flush(temporary)
            raise_swallowed()
            with held():
                temporary.replace(target)
        _flush_folder(target.parent)


@contextmanager
def replacing_many(pattern: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary folder to write files to; they move beside `pattern`, each atomically, if the block succeeds.

    They move once all are written and flushed; only a sudden end of the process (SIGKILL) can leave some behind.
    """
    target = Path(os.path.realpath(pattern))
    folder = target.parent
    with _explaining(target):
        _check_target(target)
        with temporary_name(folder) as temporary:
            temporary.mkdir()
            yield temporary
            files = sorted(temporary.iterdir())
            for file in files:
                _check_target(folder / file.name)
                _flush(file)
            raise_swallowed()
            with held():
                for file in files:
                    file.replace(folder / file.name)
        _flush_folder(folder)


@contextmanager
def replacing_folder(path: str | os.PathLike[str], own: Container[str]) -> Iterator[Path]:
    """Yield a temporary folder to write files to; they move into `path` if the block ends without an exception.

    An existing folder stays, with the files of others. Files are exchanged one by one; if one fails, all go back.
    """
    target = Path(os.path.realpath(path))
    with _explaining(target):
        _check_parent(target)
        with temporary_name(target.parent) as name:
            temporary = Path(f"{name}.new")
            temporary.mkdir()
            yield temporary
            for file in temporary.iterdir():
                _flush(file)
            _flush_folder(temporary)
            raise_swallowed()
            with held():
                if target.exists():
                    _exchange(temporary, target, own, Path(f"{name}.old"))
                else:
                    temporary.rename(target)
        _flush_folder(target)
        _flush_folder(target.parent)


def _exchange(source: Path, target: Path, own: Container[str], old: Path) -> None:
    """Move all files of a folder into another; replaced files and the writer's `own` go to `old`. All or none."""
    old.mkdir()
    written = sorted(file.name for file in source.iterdir())
    stale = [file.name for file in target.iterdir() if file.name in own and file.name not in written]
    moved: list[tuple[Path, Path]] = []
    try:
        for name in (*written, *stale):
            for start, end in ((target / name, old / name), (source / name, target / name)):
                if os.path.lexists(start):
                    start.rename(end)
                    moved.append((start, end))
    except OSError:
        for start, end in reversed(moved):
            with suppress(OSError):  # the others can go back
                end.rename(start)
        raise


def _check_target(target: Path) -> None:
    """Raise an error for a target that could not be written at the end."""
    if target.is_dir():
        raise OutputError(f"{target} is a folder; give the name of a file")
    _check_parent(target)


def _check_parent(target: Path) -> None:
    if not target.parent.is_dir():
        raise OutputError(f"{target}: the folder {target.parent} does not exist; make it first")


def _flush(file: Path) -> None:
    descriptor = os.open(file, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(folder: Path) -> None:
    # Some systems cannot flush folders. By now the file is in place and safe; a power cut could at worst undo
    # the rename.
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


_ALMOST_FULL = 1 << 20
"""Free space in bytes below which a library's failure is taken for a full disk."""

_CURES = {
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "free some of your quota or choose another disk",
    errno.EFBIG: "the file is larger than the limit for files here; choose another disk or raise the limit",
    errno.EACCES: "choose a folder that you may write to",
    errno.EPERM: "choose a folder that you may write to",
    errno.EROFS: "choose a folder that you may write to",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def raise_system_error(message: str, folder: Path) -> None:
    """Raise the system's error behind a library's failure to write, if there seems to be one, within `replacing`."""
    codes = [code for code in _CURES if os.strerror(code) in message]
    if not codes and shutil.disk_usage(folder).free < _ALMOST_FULL:
        codes = [errno.ENOSPC]
    if codes:
        raise OSError(codes[0], os.strerror(codes[0]))


@contextmanager
def _explaining(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        cure = _CURES.get(error.errno or 0, "check the disk and the path")
        raise OutputError(f"cannot write {target}: {reason}; {cure}") from error
