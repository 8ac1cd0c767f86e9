"""Writer of Alembic files (.abc) in the Ogawa format.

A sequence from an archive becomes a copy of this archive with new points. Any other sequence becomes a new archive with
a mesh per object: a SubD if subdivided, else a PolyMesh. Points are float32, and below a translation if they are far
from zero. Texture coordinates are indexed values at corners. Meshes with hard edges have normals at corners in every
frame. Face sets have assigned materials.

Specification: https://docs.alembic.io/reference/index.html
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from errno import ENOSPC
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from mixseq.version import __version__
from mixseq_io.alembic.library import LIBRARY_ERRORS, Abc, open_archive
from mixseq_io.alembic.overlay import (
    CopiedMeshWriter,
    NewMesh,
    NewMeshWriter,
    Original,
    bound_copy_size,
    copy_archive,
    create_meshes,
    match_archive,
    plan_meshes,
)
from mixseq_io.alembic.samples import create_time_sampling, make_valid_name
from mixseq_io.files import atomic_file
from mixseq_io.originals import open_original_file
from mixseq_io.reader import FrameBlock, as_float32, summarize_error, validate_blocks
from mixseq_io.surfaces import RoundingMonitor, lost_scale, warn_of_losses


def write_alembic(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | os.PathLike[str] | None = None,
    sources: ArrayLike | None = None,
    rounding: RoundingMonitor | None = None,
) -> None:
    """Write an Alembic file; options as in `FORMATS`. `sources` ``(T,)`` are the original's times in s at frames."""
    if sources is not None and np.shape(sources) != header.times.shape:
        raise SettingsError(f"sources are {np.size(sources)} times for {header.frame_count} frames; give one per frame")
    match = partial(match_archive, header=header)
    original = open_original_file(path, header, flatten, onto, "Alembic", match)
    new_meshes = [] if original else plan_meshes(header)
    has_velocities = velocities is not None
    with atomic_file(path) as temporary:
        _, numbered = validate_blocks(header, blocks, velocities)
        warn_of_losses(path, "Alembic files", _describe_losses(header, new_meshes))
        if original:
            size = bound_copy_size(original, header, has_velocities)
        else:
            size = sum(mesh.bound_size(header.frame_count, has_velocities) for mesh in new_meshes)
        _check_disk_space(temporary, size)
        monitor = rounding or RoundingMonitor(path, "Alembic", header)
        _write(path, temporary, header, original or new_meshes, numbered, has_velocities, sources, monitor)
        with _translate_write_errors(path):
            open_archive(temporary)


_WRITE_ERRORS: tuple[type[Exception], ...] = (*LIBRARY_ERRORS, FormatError)


@contextmanager
def _translate_write_errors(path: Path) -> Iterator[None]:
    """Translate errors of the library into `OutputError`."""
    try:
        yield
    except _WRITE_ERRORS as error:
        raise OutputError(f"cannot write {path}: {summarize_error(error)}; check the disk and the path") from error


def _write(
    path: Path,
    temporary: Path,
    header: SequenceHeader,
    contents: Original | Sequence[NewMesh],
    numbered: Iterable[FrameBlock],
    has_velocities: bool,
    sources: ArrayLike | None,
    rounding: RoundingMonitor,
) -> None:
    """Write all contents; on return, the archive's last object is released and the library completes the file."""
    with _translate_write_errors(path):
        archive = Abc.CreateArchiveWithInfo(str(temporary), header.fps, f"mixseq {__version__}", "")
        sampling = archive.addTimeSampling(create_time_sampling(header.times, 1 / header.fps))
        writers: Sequence[CopiedMeshWriter | NewMeshWriter] = (
            copy_archive(archive, path, contents, header, sampling, has_velocities, sources)
            if isinstance(contents, Original)
            else create_meshes(archive.getTop(), contents, sampling, rounding.origin)
        )
    for first, block, velocities in numbered:
        as_float32(block, first, "Alembic", header=header)  # reports coordinates that are too large
        if velocities is not None:
            velocities = as_float32(velocities, first, "Alembic", "the velocity of vertex", header)
        with _translate_write_errors(path):
            for writer in writers:
                writer.write(first, block, velocities, rounding)


def _check_disk_space(path: Path, size: int) -> None:
    """Raise an error if the disk has less free space than `size` in bytes.

    On a full disk, the library would crash the process by a C++ exception in a destructor.
    """
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate"):  # respects quotas and size limits
            os.posix_fallocate(file.fileno(), 0, size)
        elif shutil.disk_usage(path.parent).free < size:
            raise OSError(ENOSPC, os.strerror(ENOSPC))
    path.unlink()


def _describe_losses(header: SequenceHeader, new_meshes: Sequence[NewMesh]) -> list[str]:
    """Describe the contents that Alembic cannot hold."""
    lost = lost_scale(header, has_velocities=False)
    if any(mesh.is_subdivided and mesh.scene_mesh.hard_edges is not None for mesh in new_meshes):
        lost.append("hard edges of subdivided meshes")
    names = {header.name} if new_meshes else set()
    names |= {mesh.scene_mesh.name for mesh in new_meshes} if len(new_meshes) > 1 else set()
    changed = sorted(repr(name) for name in names if make_valid_name(name) != name)
    return [*lost, f"the names {', '.join(changed)}"] if changed else lost
