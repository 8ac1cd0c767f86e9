"""Memory limit of readers, and atomic output of writers.

A file of a few bytes can announce, or unpack to, any size, so sizes are compared with a limit before allocation; C++
parsers are also stopped by the system, see `mixseq_io.isolation`. The limit is `max_memory` of the call that opens a
file (``--max-memory``), else ``MIXSEQ_READER_MEMORY`` in GiB, else 8 GB or half of the machine's memory if less.

Files are written beside the target, then moved over it. A rename within a folder is atomic
(https://pubs.opengroup.org/onlinepubs/9799919799/functions/rename.html): readers see the old file or the new one, and
after an error, a full disk or Ctrl-C the old one is unchanged. The new file is flushed to disk first, since a power cut
could otherwise leave it empty. Signals wait while files are moved.

Temporary names of a writer begin with ``.mixseq.HOST.RANDOM``, with a lock on the file of that name with ``.lock``,
which the system releases when the process ends. The next writer in the folder deletes unlocked files. Without locks,
and for other hosts, whose locks may be invisible on a shared disk, it deletes files older than a day. Files that were
put away and not replaced are restored.
"""

from __future__ import annotations

import errno
import os
import platform
import re
import secrets
import shutil
import time
from collections import defaultdict
from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.runtime.interrupts import held, raise_swallowed

MEMORY_LIMIT_VARIABLE = "MIXSEQ_READER_MEMORY"
"""Environment variable of the limit, in GiB."""

_MOST = 8_000_000_000
_given: ContextVar[int | None] = ContextVar("max_memory", default=None)


def max_memory() -> int:
    """Return the limit in bytes."""
    given = _given.get()
    if given is not None:
        return given
    told = os.environ.get(MEMORY_LIMIT_VARIABLE)
    if told is None:
        return min(_MOST, _memory_of_machine() // 2)
    try:
        return _bytes(float(told) * (1 << 30))
    except ValueError:
        raise SettingsError(f"{MEMORY_LIMIT_VARIABLE} is {told!r}; a number of GiB is expected") from None


@contextmanager
def memory_limit(size: float | None) -> Iterator[None]:
    """Set the limit in bytes for files read in this thread; None leaves it unchanged."""
    if size is None:
        yield
        return
    before = _given.set(_bytes(size))
    try:
        yield
    finally:
        _given.reset(before)


def check_memory(file: object, needed: float, what: str = "what is in it") -> None:
    """Raise an error if reading needs more memory, in bytes, than the limit."""
    limit = max_memory()
    if needed > limit:
        raise FormatError(
            f"{file}: {what} would take {format_gigabytes(needed)} of memory, the limit is {format_gigabytes(limit)}; "
            f"if you trust it, allow more: --max-memory {format_gigabytes(1.5 * needed, 'GB')} "
            "(max_memory=... in Python)"
        )


def out_of_memory_error(file: object) -> FormatError:
    """Return the error of a file that exceeded the memory or a worker's limit."""
    return FormatError(
        f"{file}: reading needs more than {format_gigabytes(max_memory())} of memory, the limit, or than there is; it "
        "is damaged, or more must be allowed: --max-memory (max_memory=... in Python)"
    )


def format_gigabytes(size: float, unit: str = " GB") -> str:
    """Return a number of bytes in gigabytes for a message, such as "0.123 GB"."""
    return f"{size / 1e9:.3g}{unit}"


def _bytes(size: float) -> int:
    if not 0 < size < 1 << 62:
        raise SettingsError(f"the limit of memory is {size:g} bytes; a positive number is expected")
    return int(size)


def _memory_of_machine() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows
        return 2 * _MOST


_OLD = 24 * 3600.0  # seconds
_HOST = re.sub(r"[^\w-]", "-", platform.node())[:32] or "host"
_AWAY = ".old."
_NAME = re.compile(r"\.mixseq\.([\w-]+)\.[^.]{8}(?=\.|$)")


@contextmanager
def temporary_prefix(folder: Path) -> Iterator[Path]:
    """Yield a unique name prefix in a folder; files with it are deleted at the end."""
    claimed: list[tuple[Path, int]] = []
    try:
        with held():  # a signal between a name and its end would leave it to the next writer
            delete_leftovers(folder)
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


def backup_path(name: Path, target: Path) -> Path:
    """Return where to keep the old target while it is replaced."""
    return Path(f"{name}{_AWAY}{target.name}")


def delete_leftovers(folder: Path) -> None:
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


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path to write to; it becomes `path` if the block ends without an exception."""
    target = Path(os.path.realpath(path))
    with _explaining(target):
        _check_target(target)
        with temporary_prefix(target.parent) as name:
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
def atomic_files(pattern: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary folder to write files to; they move beside `pattern`, each atomically, if the block succeeds.

    They move once all are written and flushed; only a sudden end of the process (SIGKILL) can leave some behind.
    """
    target = Path(os.path.realpath(pattern))
    folder = target.parent
    with _explaining(target):
        _check_target(target)
        with temporary_prefix(folder) as temporary:
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
def atomic_folder(path: str | os.PathLike[str], own: Container[str]) -> Iterator[Path]:
    """Yield a temporary folder to write files to; they move into `path` if the block ends without an exception.

    An existing folder stays, with the files of others. Files are exchanged one by one; if one fails, all go back.
    """
    target = Path(os.path.realpath(path))
    with _explaining(target):
        _check_parent(target)
        with temporary_prefix(target.parent) as name:
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


def _flush(file: Path, mode: int = os.O_RDWR) -> None:
    descriptor = os.open(file, mode)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(folder: Path) -> None:
    # Some systems cannot flush folders. By now the file is in place and safe; a power cut could at worst undo
    # the rename.
    with suppress(OSError):
        _flush(folder, os.O_RDONLY)


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
    """Raise the system's error behind a library's failure to write, if there seems to be one, within `atomic_file`."""
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
