"""Alembic, writing: an Ogawa file with one mesh per object of the sequence (.abc).

A mesh is below a transform of its name that does nothing, ``/<name>/<name>``; several are below one more,
``/<name>/<object>/<object>``, because tools name what they import by the transforms. Meshes to be subdivided are
SubDs, the others PolyMeshes; points are float32. Texture coordinates are at the corners, with indices; normals at the
corners, frame by frame, where there are hard edges. Materials of face sets are assigned as Alembic assigns them.

Specification: https://docs.alembic.io/reference/index.html
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from errno import ENOSPC
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError, OutputError
from mixseq.sequence import SequenceHeader
from mixseq.version import __version__
from mixseq_io.alembic.library import ERRORS, Abc, AbcCoreAbstract, AbcGeom, open_archive
from mixseq_io.alembic.targets import Target, unique_names, valid_name
from mixseq_io.atomic import replacing
from mixseq_io.blocks import Numbered, as_float32, checked
from mixseq_io.losses import lost_scale, warn_of_losses
from mixseq_io.reader import brief
from mixseq_io.scene_meshes import split

_ERRORS: tuple[type[Exception], ...] = (*ERRORS, FormatError)


def write_alembic(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
) -> None:
    """Write an Alembic file.

    Parameters
    ----------
    path : Path
        The file.
    header, blocks, velocities
        See `mixseq_io.write_blocks`.

    Raises
    ------
    OutputError
        If the file cannot be written.
    InvalidSequenceError
        If points or velocities are too large for float32.

    Warns
    -----
    MixseqWarning
        If the sequence has units, an up axis, names, or hard edges of subdivided meshes, which Alembic cannot hold.
    """
    targets = _targets(header)
    with replacing(path) as temporary:
        _, numbered = checked(header, blocks, velocities)
        warn_of_losses(path, "Alembic files", _losses(header, targets))
        size = sum(target.largest_size(header.frame_count, velocities is not None) for target in targets)
        _check_room(temporary, size)
        _write(path, temporary, header, targets, numbered)
        with _writing(path):
            open_archive(temporary)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Translate the library's errors about a file that is written into `OutputError`."""
    try:
        yield
    except _ERRORS as error:
        raise OutputError(f"cannot write {path}: {brief(error)}; check the disk and the path") from error


def _targets(header: SequenceHeader) -> list[Target]:
    scene_meshes = split(header)
    names = (
        [header.name]
        if len(scene_meshes) == 1
        else unique_names(scene_mesh.name for scene_mesh in scene_meshes)
    )
    return [
        Target(scene_mesh, valid_name(name)) for scene_mesh, name in zip(scene_meshes, names, strict=True)
    ]


def _write(
    path: Path,
    temporary: Path,
    header: SequenceHeader,
    targets: Sequence[Target],
    numbered: Iterable[Numbered],
) -> None:
    """Write everything. The library completes the file when the last of its objects is gone, at the return."""
    with _writing(path):
        archive = Abc.CreateArchiveWithInfo(str(temporary), header.fps, f"mixseq {__version__}", "")
        sampling = archive.addTimeSampling(_time_sampling(header))
        root = AbcGeom.OXform(archive.getTop(), valid_name(header.name))
        parents = [root] if len(targets) == 1 else [AbcGeom.OXform(root, target.name) for target in targets]
        meshes = [target.make(parent, sampling) for target, parent in zip(targets, parents, strict=True)]
    for first, block, speeds in numbered:
        points = as_float32(block, first, "Alembic", header=header)
        of = "the velocity of vertex"
        moving = None if speeds is None else as_float32(speeds, first, "Alembic", of, header)
        with _writing(path):
            for target, mesh in zip(targets, meshes, strict=True):
                target.write(mesh, points, moving)


def _time_sampling(header: SequenceHeader) -> Any:
    """Return a uniform sampling if the times are even, else one that lists them."""
    times, step = header.times, 1 / header.fps
    if header.frame_count > 1:
        mean = float(times[-1] - times[0]) / (header.frame_count - 1)
        step = step if np.isclose(mean, step, rtol=1e-9, atol=0) else mean
    if np.allclose(times, times[0] + np.arange(header.frame_count) * step, rtol=1e-12, atol=1e-12):
        return AbcCoreAbstract.TimeSampling(step, float(times[0]))
    listed = AbcCoreAbstract.TimeVector()
    listed.extend(times.tolist())
    one_by_one = AbcCoreAbstract.TimeSamplingType(AbcCoreAbstract.AcyclicFlag.kAcyclic)
    return AbcCoreAbstract.TimeSampling(one_by_one, listed)


def _check_room(path: Path, size: int) -> None:
    """Refuse to begin what the disk has no room for.

    The library ends the whole process, with a C++ exception in a destructor, if a disk fills while it writes.
    """
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate"):  # counts quotas and limits, too
            os.posix_fallocate(file.fileno(), 0, size)
        elif shutil.disk_usage(path.parent).free < size:
            raise OSError(ENOSPC, os.strerror(ENOSPC))
    path.unlink()


def _losses(header: SequenceHeader, targets: Sequence[Target]) -> list[str]:
    """Return what Alembic has no place for."""
    lost = lost_scale(header, moving=False)
    if any(each.subdivided and each.scene_mesh.hard_edges is not None for each in targets):
        lost.append("hard edges of subdivided meshes")
    names = {header.name, *(target.scene_mesh.name for target in targets if len(targets) > 1)}
    changed = sorted(repr(name) for name in names if valid_name(name) != name)
    return [*lost, f"the names {', '.join(changed)}"] if changed else lost
