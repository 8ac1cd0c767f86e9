"""Driver of numbered files of one frame each: names, frames, and what OBJ, PLY, STL and OFF share.

Files are named by a pattern or a folder: ``walk_####.obj``, ``walk_%04d.obj``, ``walk_*.obj``. A format is a parser of
one file and an encoder of one frame. Parsers of later files get the first frame's mesh, and skip faces stored in the
same bytes.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.sequence.frame_rates import time_to_number
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.files import atomic_files
from mixseq_io.reader import (
    SequenceReader,
    prefix_errors,
    read_bytes,
    translate_read_errors,
    validate_blocks,
    warn,
)
from mixseq_io.surfaces import lost_scale, lost_times, scale_text_colours, warn_of_losses

_PLACEHOLDER = re.compile(r"#+|%0?(\d*)d")
_LAST_NUMBER = re.compile(r"(\d+)(?=\D*$)")


def is_pattern(path: Path) -> bool:
    """Whether a file name has a placeholder of the frame number: ``####`` or ``%04d``."""
    return _PLACEHOLDER.search(path.name) is not None


def frame_file_name(pattern: Path, number: int) -> str:
    """Return a pattern's name with a frame number, or the unchanged name without a placeholder."""
    return _PLACEHOLDER.sub(lambda found: str(number).zfill(_width(found)), pattern.name, count=1)


def find_frames(path: Path, allow_gaps: bool, extension: str = ".obj") -> tuple[list[Path], list[int]]:
    """Find the files of a sequence and their numbers, in order."""
    if path.is_file():
        return [path], [0]
    if path.is_dir():
        numbered = _by_last_number(
            path, [file for file in path.iterdir() if file.suffix.lower() == extension]
        )
    elif is_pattern(path):
        numbered = find_numbered_files(path)
    elif "*" in path.name or "?" in path.name:
        numbered = _by_last_number(path, path.parent.glob(path.name))
    else:
        raise FormatError(f"{path} does not exist")
    if not numbered:
        raise FormatError(f"{path}: there are no files of this name with numbers in it")
    numbered.sort()
    numbers = [number for number, _ in numbered]
    _check_numbers(path, numbered, allow_gaps)
    return [file for _, file in numbered], numbers


def find_numbered_files(path: Path) -> list[tuple[int, Path]]:
    """Find the numbers and files that match a pattern, in no order."""
    place = _PLACEHOLDER.search(path.name)
    if place is None or not path.parent.is_dir():
        return []
    before, after = path.name[: place.start()], path.name[place.end() :]
    expression = re.compile(rf"{re.escape(before)}(\d{{{_width(place)},}}){re.escape(after)}")
    found = ((expression.fullmatch(file.name), file) for file in path.parent.iterdir())
    return [(int(match[1]), file) for match, file in found if match]


def _by_last_number(path: Path, files: Iterable[Path]) -> list[tuple[int, Path]]:
    """Return the last number in each name with its file; all names must be the same around it."""
    series: dict[str, list[tuple[int, Path]]] = defaultdict(list)
    for file in sorted(files):
        if file.name.startswith("."):
            continue
        number = _LAST_NUMBER.search(file.stem)
        key = _LAST_NUMBER.sub("*", file.stem) + file.suffix.lower()
        series[key].append((int(number[1]) if number else 0, file))
    if len(series) > 1:
        names = ", ".join(sorted(series)[:10])
        raise AmbiguousError(f"{path} matches several sequences: {names}; give one of these patterns")
    return next(iter(series.values()), [])


def _width(placeholder: re.Match[str]) -> int:
    """Return a placeholder's minimum number of digits."""
    text = placeholder[0]
    return len(text) if text.startswith("#") else int(placeholder[1] or 1)


def _check_numbers(path: Path, numbered: Sequence[tuple[int, Path]], allow_gaps: bool) -> None:
    missing = []
    for (number, file), (following, other) in pairwise(numbered):
        if number == following:
            raise InvalidSequenceError(
                f"{path}: {file.name} and {other.name} have the same number; remove one"
            )
        if following > number + 1:
            missing.append(str(number + 1) if following == number + 2 else f"{number + 1}-{following - 1}")
    if missing and not allow_gaps:
        more = ", ..." if len(missing) > 10 else ""
        raise InvalidSequenceError(
            f"{path}: numbers {', '.join(missing[:10])}{more} are missing between {numbered[0][1].name} and "
            f"{numbered[-1][1].name}; add the files, or accept the gaps with allow_gaps=True (--allow-gaps)"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshFile:
    """Contents of one file: points ``(V, 3)``, polygons, name ("" for none), surface (later frames: colours only).

    `source` and `colour_text` are the faces and colours as stored, to detect equal ones in other files. `told`: colour
    changes were reported, so that later ones are skipped.
    """

    points: FloatArray
    polygons: Polygons
    source: Any = None
    name: str = ""
    surface: Surface = Surface()  # noqa: RUF009 - frozen all the way down
    colour_text: bytes = b""
    told: bool = False


Parser = Callable[[Path, bytes, MeshFile | None], MeshFile]
"""Parser of a file's bytes, given its name for messages, and the first frame's mesh for later files."""

Encoder = Callable[[FloatArray, int], Iterable[bytes]]
"""Encoder of points ``(V, 3)`` and their frame's index into a file's contents."""


@dataclass(frozen=True)
class FrameFormat:
    """Format of files with one frame; the lower-case name is the extension.

    `encoder` makes a frame's encoder from the pattern, for warnings, and the header; `lost` returns a header's losses.
    `damage` are exceptions of `parse` on damaged files besides mixseq's. Text files take more memory to parse.
    """

    name: str
    parse: Parser
    encoder: Callable[[Path, SequenceHeader], Encoder]
    lost: Callable[[SequenceHeader], list[str]]
    is_text: bool = False
    damage: tuple[type[Exception], ...] = ()

    def open(self, path: Path, fps: float = DEFAULT_FPS, allow_gaps: bool = False) -> SequenceReader:
        """Open numbered files."""
        if not (np.isfinite(fps) and fps > 0):
            raise SettingsError(f"fps is {fps}; a positive number is expected")
        files, numbers = find_frames(path, allow_gaps, f".{self.name.lower()}")
        with prefix_errors(files[0]):
            first = self.read(files[0])
            header = SequenceHeader(
                polygons=first.polygons,
                vertex_count=len(first.points),
                times=np.array(numbers) / fps,
                fps=fps,
                name=first.name or files[0].stem.rstrip("0123456789").rstrip("_-. ") or "mesh",
                surface=first.surface,
            )
        return _FilesReader(path, header, files, first, self)

    def read(self, file: Path, like: MeshFile | None = None) -> MeshFile:
        """Read a file, given the first frame's mesh for later frames."""
        with translate_read_errors(file, with_article(self.name), *self.damage):
            return self.parse(file, read_bytes(file, self.is_text), like)

    def write(
        self,
        path: Path,
        header: SequenceHeader,
        blocks: Iterable[FloatArray],
        velocities: Iterable[FloatArray] | None = None,
        start: int | None = None,
    ) -> None:
        """Write one file per frame, named by a pattern as ``walk_####.obj`` or ``walk_%04d.obj``; velocities are lost.

        Numbers begin at `start`, by default that of the first frame, or 1 if that is no whole number from 0 on. Raises
        `OutputError` for several frames without a pattern or failed writes, `SettingsError` if `start` is negative.
        """
        if start is not None and start < 0:
            raise SettingsError(f"start is {start}; files are numbered from 0 or more")
        if header.frame_count > 1 and not is_pattern(path):
            raise OutputError(
                f"{path}: {with_article(self.name)} holds one frame, this sequence has {header.frame_count}; give a "
                f"pattern such as {path.stem.rstrip('*')}_####{path.suffix}"
            )
        own = time_to_number(header.times[0], header.fps)
        first = start if start is not None else int(own) if own >= 0 and own.is_integer() else 1
        lost = lost_times(header, first if start is None else own)
        lost += lost_scale(header, velocities is not None) + self.lost(header)
        warn_of_losses(path, f"{self.name} files", lost)
        names = [frame_file_name(path, number) for number in range(first, first + header.frame_count)]
        encode = self.encoder(path, header)
        with atomic_files(path) as folder:
            _, numbered = validate_blocks(header, blocks, velocities)
            for done, block, _ in numbered:
                for frame, points in enumerate(block, start=done):
                    with (folder / names[frame]).open("wb") as file:
                        file.writelines(encode(points, frame))
        if is_pattern(path):
            _warn_of_others(path, set(names))


class _FilesReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, files: Sequence[Path], first: MeshFile, form: FrameFormat
    ) -> None:
        super().__init__(path, header)
        self._files = files
        self._first = first
        self._form = form

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        for start in range(0, len(self._files), size):
            frames = range(start, min(start + size, len(self._files)))
            yield np.stack([self._points(frame) for frame in frames], dtype=self._first.points.dtype)

    def _points(self, frame: int) -> FloatArray:
        first = self._files[0]
        where = f"{self._files[frame]} (frame {self.header.frame_number(frame)})"
        with prefix_errors(where):
            mesh = self._form.read(self._files[frame], self._first)
        if len(mesh.points) != self.header.vertex_count:
            raise InvalidSequenceError(
                f"{where} has {len(mesh.points)} vertices, {first} has {self.header.vertex_count}; "
                "every frame needs the same vertices in the same order"
            )
        if not mesh.polygons.same_as(self.header.polygons):
            raise InvalidSequenceError(
                f"{where} has other faces than {first}; every frame needs the same faces in "
                "the same order (export with the vertex order kept)"
            )
        if not self._first.told and not _alike(mesh.surface.colours, self.header.surface.colours):
            self._first = replace(self._first, told=True)
            warn(
                f"{self.path}: colours that change over time stay as they are in the first frame; {where} has others"
            )
        return mesh.points


def _alike(colours: CornerValues | None, first: CornerValues | None) -> bool:
    if colours is first or colours is None or first is None:
        return colours is first
    return np.array_equal(colours.at_corners, first.at_corners, equal_nan=True)


def with_article(kind: str) -> str:
    """Return "a file" of a format with its article: "a PLY file", "an OBJ file"."""
    return f"{'a' if kind.startswith('P') else 'an'} {kind} file"


def _warn_of_others(path: Path, written: set[str]) -> None:
    """Warn of files left by a longer sequence, which would be read with this one."""
    others = sorted({file.name for _, file in find_numbered_files(path)} - written)
    if others:
        warn(
            f"{path}: {len(others)} files of another sequence, {others[0]} to {others[-1]}, match as well; "
            "remove them, else they will be read as frames of this one"
        )


WRITTEN_BY = b"# Written by mixseq, "
"""Start of the comment in files of mixseq, followed by the points' precision: float32 or float64."""


def excerpt(line: bytes) -> str:
    """Return the beginning of a line for a message."""
    return repr(line.strip()[:40].decode("ascii", errors="replace"))


def number_lines(keyword: str, rows: FloatArray, ends: Sequence[str] = ()) -> bytes:
    """Return a line per row of numbers, with the digits that give back the same number, and optional ends."""
    line = keyword + " ".join(["%.9g" if rows.dtype == np.float32 else "%.17g"] * rows.shape[1])
    lines = "".join(f"{line}{end}\n" for end in ends) if ends else f"{line}\n" * len(rows)
    text: str = lines % tuple(rows.reshape(-1).tolist())
    return text.encode()


def colours_of_words(
    file: Path, vertices: Sequence[int], rows: Sequence[Sequence[bytes]], like: MeshFile | None
) -> FloatArray:
    """Return the colours ``(n, 3)`` or ``(n, 4)`` of some vertices; unreadable ones are NaN in later frames."""
    try:
        return scale_text_colours(np.array(rows, dtype=np.float64))
    except ValueError:
        if like is not None:
            return np.full((len(rows), len(rows[0])), np.nan)
        vertex, row = next(
            each for each in zip(vertices, rows, strict=True) if not all(map(_is_number, each[1]))
        )
        raise FormatError(
            f"{file}, vertex {vertex}: the colour {excerpt(b' '.join(row))} is not {len(row)} numbers, which are "
            "expected after the coordinates"
        ) from None


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
