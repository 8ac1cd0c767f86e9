"""Results written over their original: a copy of the file that a sequence came from, with new points.

Meshes of the sequence and the file are matched by path, else by faces if a single mesh has the same.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError, InvalidSequenceError, OutputError, SettingsError
from mixseq.sequence.frame_rates import NEAR
from mixseq.sequence.header import SequenceHeader
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import SceneMesh, format_names, split_meshes

Opened = TypeVar("Opened")
Mesh = TypeVar("Mesh")
Fit = TypeVar("Fit")


def open_original_file(
    path: Path,
    header: SequenceHeader,
    flatten: bool,
    onto: str | os.PathLike[str] | None,
    kind: str,
    opened: Callable[[Path], Opened],
) -> Opened | None:
    """Open the original that is copied; None if there is none, or the sequence is written alone (`flatten`)."""
    if flatten and onto is not None:
        raise SettingsError("flatten writes the sequence alone, onto lays it over a file; give one of them")
    origin = header.surface.origin
    if onto is not None:
        file = Path(onto)
    elif origin is not None and origin.format == kind and not flatten:
        file = Path(origin.path)
    else:
        return None
    if path.exists() and file.exists() and path.samefile(file):
        raise OutputError(f"{path} is the original and would be lost; write to another name")
    try:
        return opened(file)
    except (FormatError, InvalidSequenceError) as error:
        if onto is not None:
            raise OutputError(f"cannot write {path} onto another file: {error}") from error
        warn(
            f"{error}; the sequence is written alone, without what else that file had (onto=FILE names another)"
        )
        return None


def match_meshes(
    path: Path,
    header: SequenceHeader,
    meshes: Mapping[str, Mesh],
    fit: Callable[[SceneMesh, Mesh], Fit | None],
    difference: Callable[[SceneMesh, Mesh], str],
) -> list[Fit]:
    """Return, for every mesh of a sequence, its matching mesh of the file."""
    left, fits = dict(meshes), []
    for scene_mesh in split_meshes(header):
        wanted = scene_mesh.path or scene_mesh.name
        candidates = {scene_mesh.path: left[scene_mesh.path]} if scene_mesh.path in left else left
        found = {
            name: each for name, mesh in candidates.items() if (each := fit(scene_mesh, mesh)) is not None
        }
        if len(found) > 1:
            raise FormatError(
                f"{path} has {len(found)} meshes with the faces of {wanted!r}, {format_names(list(found))}"
            )
        if not found:
            why = (
                [difference(scene_mesh, mesh) for mesh in candidates.values()] if len(candidates) == 1 else []
            )
            raise FormatError(
                ": ".join(filter(None, [f"{path} has no mesh with the faces of {wanted!r}", *why]))
            )
        ((name, each),) = found.items()
        del left[name]
        fits.append(each)
    return fits


def is_retimed(header: SequenceHeader, sources: ArrayLike | None) -> bool:
    """Whether `sources`, times of the original in seconds, differ from the frames' own; False without them."""
    return sources is not None and not np.allclose(sources, header.times, rtol=0, atol=NEAR / header.fps)


def warn_of_unretimed_motion(
    path: Path,
    header: SequenceHeader,
    moving: Mapping[str, tuple[float, float]],
    sources: ArrayLike | None,
) -> None:
    """Warn of other motion if the sequence shows other times ``(T,)``, or is outlasted by more than a frame."""
    first, last = (float(time) for time in header.times[[0, -1]])
    frame, retimed = 1 / header.fps, is_retimed(header, sources)
    told = [
        each
        for each, (start, end) in moving.items()
        if retimed or first < start - frame or last > end + frame
    ]
    if told:
        start, end = min(moving[each][0] for each in told), max(moving[each][1] for each in told)
        warn(
            f"{path}: what else moves keeps its own times, {start:g} to {end:g} s, and is not retimed: "
            f"{format_names(told)}"
        )
