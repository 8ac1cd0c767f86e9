"""Match a sequence with its original file, of which a copy with new points is written.

Meshes are matched by path, or by faces if exactly one mesh of the file has the same faces.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError, InvalidSequenceError, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons, count_common_polygons, describe_difference, reversed_winding
from mixseq.sequence.frame_rates import FRAME_TOLERANCE
from mixseq.sequence.header import SequenceHeader
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import SceneMesh, format_names, split_meshes

Loaded = TypeVar("Loaded")
Mesh = TypeVar("Mesh")
Match = TypeVar("Match")


def open_original_file(
    path: Path,
    header: SequenceHeader,
    flatten: bool,
    onto: str | os.PathLike[str] | None,
    format_name: str,
    load: Callable[[Path], Loaded],
) -> Loaded | None:
    """Load the file to copy, or return None without one or with `flatten`; warn if a recorded origin is unreadable."""
    if flatten and onto is not None:
        raise SettingsError("flatten writes a stand-alone file, onto a copy of another; give one of them")
    origin = header.surface.origin
    if onto is not None:
        file = Path(onto)
    elif origin is not None and origin.format == format_name and not flatten:
        file = Path(origin.path)
    else:
        return None
    if path.exists() and file.exists() and path.samefile(file):
        raise OutputError(f"{path} is the original and would be lost; write to another name")
    try:
        return load(file)
    except (FormatError, InvalidSequenceError) as error:
        if onto is not None:
            raise OutputError(f"cannot write {path} onto another file: {error}") from error
        warn(f"{error}; the result is a stand-alone file, without its other contents (onto=FILE names another)")
        return None


def match_meshes(
    path: Path,
    header: SequenceHeader,
    meshes: Mapping[str, Mesh],
    match: Callable[[SceneMesh, Mesh], Match | None],
    describe_difference: Callable[[SceneMesh, Mesh], str],
) -> list[Match]:
    """Match every mesh of a sequence with one of the file's `meshes`, whose keys are paths."""
    unmatched, matches = dict(meshes), []
    for scene_mesh in split_meshes(header):
        own_path = scene_mesh.path
        label = own_path or scene_mesh.name
        candidates = {own_path: unmatched[own_path]} if own_path in unmatched else unmatched
        results = {name: match(scene_mesh, mesh) for name, mesh in candidates.items()}
        matching = {name: result for name, result in results.items() if result is not None}
        if len(matching) > 1:
            raise FormatError(
                f"{path} has {len(matching)} meshes with the faces of {label!r}, {format_names(list(matching))}"
            )
        if not matching:
            reason = describe_difference(scene_mesh, *candidates.values()) if len(candidates) == 1 else ""
            problem = f"{path} has no mesh with the faces of {label!r}"
            raise FormatError(f"{problem}: {reason}" if reason else problem)
        ((name, result),) = matching.items()
        del unmatched[name]
        matches.append(result)
    return matches


def describe_difference_up_to_winding(polygons: Polygons, stored: Polygons, name: str) -> str:
    """Describe the first difference of a sequence's polygons from stored ones, in the winding with more equal polygons.

    Stored polygons are reversed if their mesh is mirrored or left-handed; `name` is the name of their mesh.
    """
    reversed_polygons = Polygons(stored.counts, stored.indices[reversed_winding(stored.counts, keep_first=True)])
    closest = max((stored, reversed_polygons), key=partial(count_common_polygons, polygons))
    return describe_difference(polygons, closest, ("the sequence", name))


def is_retimed(header: SequenceHeader, sources: ArrayLike | None) -> bool:
    """Whether `sources`, times of the original in seconds, are given and differ from the times of the frames."""
    return sources is not None and not np.allclose(sources, header.times, rtol=0, atol=FRAME_TOLERANCE / header.fps)


def warn_of_unretimed_motion(
    path: Path, header: SequenceHeader, spans: Mapping[str, tuple[float, float]], sources: ArrayLike | None
) -> None:
    """Warn of objects whose animation does not follow the sequence; `spans` are their first and last times in seconds.

    If `sources` ``(T,)`` retime the sequence, all objects count; else objects it outlasts by more than a frame.
    """
    first, last = (float(time) for time in header.times[[0, -1]])
    frame, retimed = 1 / header.fps, is_retimed(header, sources)
    unretimed = [name for name, (start, end) in spans.items() if retimed or first < start - frame or last > end + frame]
    if unretimed:
        start, end = min(spans[name][0] for name in unretimed), max(spans[name][1] for name in unretimed)
        warn(
            f"{path}: other animation keeps its own times, {start:g} to {end:g} s, and is not retimed: "
            f"{format_names(unretimed)}"
        )
