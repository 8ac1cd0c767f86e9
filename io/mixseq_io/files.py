"""Limit the memory of readers, and write output files atomically.

A small file can declare or unpack to any size, so sizes are compared with a limit before memory is allocated. C++
parsers are also limited by the system, see `mixseq_io.isolation`. The limit is the argument `max_memory`
(``--max-memory``), else ``MIXSEQ_READER_MEMORY`` in GiB, else the smaller of 8 GB and half of the machine's memory.

Output is written to a temporary file beside the target and flushed to disk, then renamed to the target, which is atomic
(https://pubs.opengroup.org/onlinepubs/9799919799/functions/rename.html). Readers find the old file or the new
file. After an error, a full disk, Ctrl-C or a power cut, the old file is unchanged. Renaming defers signals. The file
that a link leads to is replaced, not the link; of several files in a folder, links are. Devices, pipes and sockets are
refused, directly or through links, as renaming would remove them.

Temporary names start with a prefix ``.mixseq.HOST.RANDOM``. The writer holds a lock on the file ``PREFIX.lock``, which
the operating system releases when the process ends. The next writer in the folder deletes unlocked temporary files.
Locks may be unsupported, or invisible for other hosts on a shared disk. In both cases, only files older than a day are
deleted. Backups of targets that were not replaced are restored.
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
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.runtime.interrupts import deferred_signals, raise_pending_signal

MEMORY_LIMIT_VARIABLE = "MIXSEQ_READER_MEMORY"
"""Environment variable that sets the memory limit in GiB."""

_DEFAULT_LIMIT_BYTES = 8_000_000_000
_limit_of_call: ContextVar[int | None] = ContextVar("max_memory", default=None)


def max_memory() -> int:
    """Return the memory limit in bytes."""
    limit = _limit_of_call.get()
    if limit is not None:
        return limit
    gibibytes = os.environ.get(MEMORY_LIMIT_VARIABLE)
    if gibibytes is None:
        return min(_DEFAULT_LIMIT_BYTES, _machine_memory() // 2)
    try:
        return _validated_limit(float(gibibytes) * (1 << 30))
    except ValueError:
        raise SettingsError(f"{MEMORY_LIMIT_VARIABLE} is {gibibytes!r}; a number of GiB is expected") from None


@contextmanager
def memory_limit(size: float | None) -> Iterator[None]:
    """Set the memory limit in bytes for files that this thread reads in the context; None changes nothing."""
    if size is None:
        yield
        return
    token = _limit_of_call.set(_validated_limit(size))
    try:
        yield
    finally:
        _limit_of_call.reset(token)


class LimitError(FormatError):
    """A file that exceeds a limit as a whole, unlike a mesh that is damaged."""


def check_memory(file: object, needed: float, part: str = "its contents") -> None:
    """Raise an error if the bytes `needed` for a part of a file exceed the memory limit."""
    limit = max_memory()
    if needed > limit:
        raise LimitError(
            f"{file}: {part} would take {format_gigabytes(needed)} of memory, the limit is {format_gigabytes(limit)}; "
            f"if you trust it, allow more: --max-memory {format_gigabytes(1.5 * needed, 'GB')} "
            "(max_memory=... in Python)"
        )


def out_of_memory_error(file: object) -> LimitError:
    """Return the error to raise if reading a file has exhausted the memory."""
    return LimitError(
        f"{file}: reading needs more than {format_gigabytes(max_memory())} of memory, the limit, or than is free; the "
        "file is damaged, or more must be allowed: --max-memory (max_memory=... in Python)"
    )


def format_gigabytes(size: float, unit: str = " GB") -> str:
    """Format a number of bytes in gigabytes, such as "0.123 GB"."""
    return f"{size / 1e9:.3g}{unit}"


def _validated_limit(size: float) -> int:
    if not 0 < size < 1 << 62:
        raise SettingsError(f"the limit of memory is {size:g} bytes; a positive number is expected")
    return int(size)


def _machine_memory() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows
        return 2 * _DEFAULT_LIMIT_BYTES


_STALE_SECONDS = 24 * 3600.0
_HOST_NAME = re.sub(r"[^\w-]", "-", platform.node())[:32] or "host"
_BACKUP_INFIX = ".old."
_TEMPORARY_PREFIX = re.compile(r"\.mixseq\.([\w-]+)\.[^.]{8}(?=\.|$)")


@contextmanager
def temporary_prefix(folder: Path) -> Iterator[Path]:
    """Yield a unique path prefix in a folder; paths with this prefix are deleted at the end of the context."""
    claimed: list[tuple[Path, int]] = []
    try:
        with deferred_signals():  # a signal directly after the claim would prevent the cleanup
            delete_leftovers(folder)
            claimed.append(_claim_prefix(folder))
        yield claimed[0][0]
    finally:
        with deferred_signals():
            for prefix, descriptor in claimed:
                names = [name for name in _temporary_names(folder) if name.startswith(prefix.name)]
                _delete(folder, names)
                os.close(descriptor)


def _claim_prefix(folder: Path) -> tuple[Path, int]:
    """Return a new path prefix and the descriptor of its locked lock file."""
    while True:
        prefix = folder / f".mixseq.{_HOST_NAME}.{secrets.token_hex(4)}"
        descriptor = os.open(f"{prefix}.lock", os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        if _try_lock(descriptor) is not False and Path(f"{prefix}.lock").exists():
            return prefix, descriptor
        os.close(descriptor)  # another process has deleted the lock file as a leftover


def backup_path(prefix: Path, target: Path) -> Path:
    """Return the path to which the old target is moved while the target is replaced."""
    return Path(f"{prefix}{_BACKUP_INFIX}{target.name}")


def delete_leftovers(folder: Path) -> None:
    """Delete temporary files in a folder whose writers have ended."""
    names_of_writer = defaultdict(list)
    for name in _temporary_names(folder):
        if match := _TEMPORARY_PREFIX.match(name):
            names_of_writer[match[0], match[1]].append(name)
    for (prefix, host), names in names_of_writer.items():
        with _open_and_lock(folder / f"{prefix}.lock") as locked:
            if _is_stale(folder, names) if host != _HOST_NAME or locked is None else locked:
                _delete(folder, names)


@contextmanager
def _open_and_lock(file: Path) -> Iterator[bool | None]:
    """Yield whether the lock of a writer could be acquired, or None if this cannot be determined."""
    try:
        descriptor = os.open(file, os.O_RDWR)
    except OSError:
        yield None
        return
    try:
        yield _try_lock(descriptor)
    finally:
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool | None:
    """Lock a file without waiting; return whether locking succeeded, or None if locks are unsupported."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some file systems do not support locks
        return None
    return True


def _is_stale(folder: Path, names: list[str]) -> bool:
    """Whether files and folders, including all contents, were last modified more than a day ago."""
    paths = [folder / name for name in names]
    paths += [inner for path in paths if path.is_dir() for inner in path.rglob("*")]
    with suppress(OSError):
        return time.time() - max(path.lstat().st_mtime for path in paths) > _STALE_SECONDS
    return False


def _temporary_names(folder: Path) -> list[str]:
    try:
        return [path.name for path in folder.glob(".mixseq.*")]
    except OSError:  # the writer reports the error
        return []


def _delete(folder: Path, names: list[str]) -> None:
    """Restore backups and delete files, the lock file last, so that the next writer can complete the cleanup."""
    for name in sorted(names, key=lambda name: name.endswith(".lock")):
        with suppress(OSError):
            path = folder / name
            _, infix, target = name.partition(_BACKUP_INFIX)
            if infix and not os.path.lexists(folder / target):
                path.rename(folder / target)
            elif path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()


@contextmanager
def atomic_file(path: str | os.PathLike[str], check: Callable[[Path], object] | None = None) -> Iterator[Path]:
    """Yield a temporary path; its file replaces `path` if the block and `check`, called with it, raise no exception."""
    with _prepare_target(path) as (target, prefix):
        temporary = Path(f"{prefix}{target.suffix}")
        yield temporary
        if check is not None:
            check(temporary)
        if target.exists():
            shutil.copymode(target, temporary)
        _flush(temporary)
        raise_pending_signal()
        with deferred_signals():
            temporary.replace(target)


@contextmanager
def atomic_files(pattern: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary folder; its files move to the folder of `pattern` if the block ends without an exception.

    All files are written and flushed before the first is renamed; only SIGKILL can leave an incomplete set of files.
    """
    with _prepare_target(pattern) as (target, temporary):
        temporary.mkdir()
        yield temporary
        files = sorted(temporary.iterdir())
        for file in files:
            check_target(target.parent / file.name)
            _flush(file)
        raise_pending_signal()
        with deferred_signals():
            for file in files:
                file.replace(target.parent / file.name)


@contextmanager
def atomic_folder(path: str | os.PathLike[str], own: Container[str]) -> Iterator[Path]:
    """Yield a temporary folder; its files move into the folder `path` if the block ends without an exception.

    In an existing folder, files with the writer's `own` names are replaced or deleted; all other files are kept. If one
    file cannot be moved, all files are moved back.
    """
    with _prepare_target(path, is_folder=True) as (target, prefix):
        temporary = Path(f"{prefix}.new")
        temporary.mkdir()
        yield temporary
        for file in temporary.iterdir():
            _flush(file)
        _flush_folder(temporary)
        for file in target.iterdir() if target.exists() else ():
            if file.name in own:
                check_target(file)
        raise_pending_signal()
        with deferred_signals():
            if target.exists():
                _exchange(temporary, target, own, Path(f"{prefix}.old"))
            else:
                temporary.rename(target)
        _flush_folder(target)


def _exchange(source: Path, target: Path, own: Container[str], old: Path) -> None:
    """Move all files of a folder to `target`, or none; move replaced files and files with `own` names to `old`."""
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
            with suppress(OSError):  # continue with the remaining files
                end.rename(start)
        raise


def check_target(path: str | os.PathLike[str], is_folder: bool = False) -> None:
    """Raise an error for a path that cannot be replaced by a file, or into which a folder's files cannot be moved."""
    given, target = Path(path), Path(os.path.realpath(path))
    if given.is_dir() and not is_folder:
        raise OutputError(f"{given} is a folder; give the name of a file")
    if is_folder and given.is_file():
        raise OutputError(f"{given} is a file; give the name of a folder")
    if given.exists() and not (given.is_file() or given.is_dir()):
        link = f", through a link to {target}" if given.is_symlink() else ""
        raise OutputError(f"{given} is a device, a pipe or a socket{link}, which would be replaced; give another name")
    if not target.parent.is_dir():
        raise OutputError(f"{given}: the folder {target.parent} does not exist; make it first")


def _flush(file: Path, mode: int = os.O_RDWR) -> None:
    descriptor = os.open(file, mode)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(folder: Path) -> None:
    # Some systems cannot flush folders. Files are flushed, so that a power cut can at worst undo the rename.
    with suppress(OSError):
        _flush(folder, os.O_RDONLY)


_FULL_DISK_BYTES = 1 << 20
"""Free space in bytes below which a library's failure is attributed to a full disk."""

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
    """Raise an `OSError` if a library's message quotes one or the disk is full; for use in `atomic_file`."""
    codes = [code for code in _CURES if os.strerror(code) in message]
    if not codes and shutil.disk_usage(folder).free < _FULL_DISK_BYTES:
        codes = [errno.ENOSPC]
    if codes:
        raise OSError(codes[0], os.strerror(codes[0]))


@contextmanager
def _prepare_target(path: str | os.PathLike[str], is_folder: bool = False) -> Iterator[tuple[Path, Path]]:
    """Yield a target, links resolved, and a prefix of temporary paths beside it; translate errors, flush its folder."""
    target = Path(os.path.realpath(path))
    try:
        check_target(path, is_folder)
        with temporary_prefix(target.parent) as prefix:
            yield target, prefix
        _flush_folder(target.parent)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        cure = _CURES.get(error.errno or 0, "check the disk and the path")
        raise OutputError(f"cannot write {target}: {reason}; {cure}") from error
