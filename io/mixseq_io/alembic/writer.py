"""Alembic, writing: Ogawa files (.abc).

Sequences from an archive become a copy of it with new points (`overlay`), others a stand-alone archive (`targets`) with
a mesh per object, SubDs if subdivided, else PolyMeshes. Points are float32. Texture coordinates are at corners with
indices, normals at corners per frame where there are hard edges; face sets have assigned materials.

Specification: https://docs.alembic.io/reference/index.html
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from errno import ENOSPC
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from mixseq.version import __version__
from mixseq_io.alembic.library import ERRORS, Abc, open_archive
from mixseq_io.alembic.overlay import (
    MadeMesh,
    MovedMesh,
    Original,
    Target,
    largest_size,
    lay_over,
    make_meshes,
    make_targets,
    open_original,
)
from mixseq_io.alembic.samples import time_sampling, valid_name
from mixseq_io.files import atomic_file
from mixseq_io.originals import open_original_file
from mixseq_io.reader import FrameBlock, as_float32, summarize_error, validate_blocks
from mixseq_io.surfaces import lost_scale, warn_of_losses

_ERRORS: tuple[type[Exception], ...] = (*ERRORS, FormatError)


def write_alembic(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | os.PathLike[str] | None = None,
    sources: ArrayLike | None = None,
) -> None:
    """Write an Alembic file; options as in `FORMATS`, `sources` ``(T,)`` in seconds for a warning if they differ."""
    if sources is not None and np.shape(sources) != header.times.shape:
        raise SettingsError(
            f"sources are {np.size(sources)} times for {header.frame_count} frames; give one each"
        )
    original = open_original_file(
        path, header, flatten, onto, "Alembic", lambda file: open_original(file, header)
    )
    targets = [] if original else make_targets(header)
    moving = velocities is not None
    with atomic_file(path) as temporary:
        _, numbered = validate_blocks(header, blocks, velocities)
        warn_of_losses(path, "Alembic files", _losses(header, targets))
        if original:
            _check_room(temporary, largest_size(original, header, moving))
        else:
            _check_room(temporary, sum(each.largest_size(header.frame_count, moving) for each in targets))
        _write(path, temporary, header, original or targets, numbered, moving, sources)
        with _writing(path):
            open_archive(temporary)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Translate the library's errors about a file that is written into `OutputError`."""
    try:
        yield
    except _ERRORS as error:
        raise OutputError(
            f"cannot write {path}: {summarize_error(error)}; check the disk and the path"
        ) from error


def _write(
    path: Path,
    temporary: Path,
    header: SequenceHeader,
    source: Original | Sequence[Target],
    numbered: Iterable[FrameBlock],
    velocities: bool,
    sources: ArrayLike | None,
) -> None:
    """Write everything; the library completes the file when its last object is released, at the return."""
    with _writing(path):
        archive = Abc.CreateArchiveWithInfo(str(temporary), header.fps, f"mixseq {__version__}", "")
        sampling = archive.addTimeSampling(time_sampling(header.times, 1 / header.fps))
        meshes: Sequence[MovedMesh | MadeMesh] = (
            lay_over(archive, path, source, header, sampling, velocities, sources)
            if isinstance(source, Original)
            else make_meshes(archive.getTop(), source, sampling)
        )
    for first, block, speeds in numbered:
        points = as_float32(block, first, "Alembic", header=header)
        of = "the velocity of vertex"
        moving = None if speeds is None else as_float32(speeds, first, "Alembic", of, header)
        with _writing(path):
            for mesh in meshes:
                mesh.write(first, points, moving)


def _check_room(path: Path, size: int) -> None:
    """Raise an error if the file would exceed the free disk space.

    The library ends the process, by a C++ exception in a destructor, if a disk fills while it writes.
    """
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate"):  # counts quotas and limits, too
            os.posix_fallocate(file.fileno(), 0, size)
        elif shutil.disk_usage(path.parent).free < size:
            raise OSError(ENOSPC, os.strerror(ENOSPC))
    path.unlink()


def _losses(header: SequenceHeader, targets: Sequence[Target]) -> list[str]:
    """Return the contents that Alembic cannot hold."""
    lost = lost_scale(header, has_velocities=False)
    if any(each.subdivided and each.scene_mesh.hard_edges is not None for each in targets):
        lost.append("hard edges of subdivided meshes")
    names = (
        {header.name, *(target.scene_mesh.name for target in targets if len(targets) > 1)} if targets else ()
    )
    changed = sorted(repr(name) for name in names if valid_name(name) != name)
    return [*lost, f"the names {', '.join(changed)}"] if changed else lost
