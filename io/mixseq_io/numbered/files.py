"""Read and write numbered files of one frame each: file names, frames, and functions common to all formats.

A sequence is given by a folder or a pattern: ``walk_####.obj``, ``walk_%04d.obj``, ``walk_*.obj``. A format has a
parser of one file and an encoder of one frame. For later files the parser also gets the first frame's mesh, and reuses
its faces if the later file stores them in the same bytes.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, starmap
from math import ceil, floor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mixseq.errors import (
    AmbiguousError,
    FormatError,
    InvalidSequenceError,
    MissingFileError,
    OutputError,
    SettingsError,
)
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import Surface
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, format_number, time_to_number
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.files import atomic_files
from mixseq_io.reader import SequenceReader, prefix_errors, read_bytes, translate_read_errors, validate_blocks, warn
from mixseq_io.surfaces import lost_scale, scale_text_colours, warn_of_losses

_FRAME_PATTERN = re.compile(r"#+|%0?(\d*)d")
_LAST_WHOLE_NUMBER = re.compile(r"(?:(?<![^\W_])-)?\d+(?=\D*$)")  # a minus after a letter or digit is no sign
_LAST_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?=\D*$)")

MIN_FRAME_STEP = 0.02
"""Shortest step between sub-frames in frames; ``v2.0001`` and ``v2.0002`` are frames 1 and 2 of a second version."""


def is_pattern(path: Path) -> bool:
    """Whether a file name has a placeholder for the frame number, ``####`` or ``%04d``."""
    return _FRAME_PATTERN.search(path.name) is not None


def frame_file_name(pattern: Path, number: float) -> str:
    """Insert a frame number into the name of a pattern; a name without a placeholder is unchanged."""
    whole, point, part = format_number(number).partition(".")
    return _FRAME_PATTERN.sub(lambda match: whole.zfill(_digit_count(match)) + point + part, pattern.name, count=1)


def find_frame_files(path: Path, allow_gaps: bool, extension: str = ".obj") -> tuple[list[Path], list[float]]:
    """Return the files of a sequence and their frame numbers, in order of the numbers."""
    if path.is_file():
        return [path], [0.0]
    if path.is_dir():
        numbered = _number_files(path, [file for file in path.iterdir() if file.suffix.lower() == extension])
    elif is_pattern(path):
        numbered = find_numbered_files(path)
    elif "*" in path.name or "?" in path.name:
        numbered = _number_files(path, path.parent.glob(path.name))
    else:
        raise MissingFileError(f"{path} does not exist")
    if not numbered:
        raise FormatError(f"{path}: there are no numbered files of this name")
    numbers = [number for number, _ in numbered]
    _check_numbers(path, numbered, allow_gaps)
    return [file for _, file in numbered], numbers


def find_numbered_files(path: Path) -> list[tuple[float, Path]]:
    """Return the files that match a pattern, with their frame numbers, in order of these."""
    placeholder = _FRAME_PATTERN.search(path.name)
    if placeholder is None or not path.parent.is_dir():
        return []
    before, after = path.name[: placeholder.start()], path.name[placeholder.end() :]
    digits = _digit_count(placeholder)  # a sign counts as one
    number = rf"((?:\d|-(?=\d))\d{{{digits - 1},}}(?:\.\d+)?)"
    expression = re.compile(rf"{re.escape(before)}{number}{re.escape(after)}")
    matches = ((expression.fullmatch(file.name), file) for file in path.parent.iterdir())
    numbered = sorted((float(match[1]), file) for match, file in matches if match)
    has_subframes = _are_frames([number for number, _ in numbered])
    return [each for each in numbered if has_subframes or each[0].is_integer()]


class NumberedFiles(NamedTuple):
    """The files of a sequence in a folder."""

    pattern: str  # file name with ``#`` for the digits of the frame number; without a number, the name
    files: list[tuple[float, Path]]  # by frame number, 0 if there is none


def group_numbered_files(files: Iterable[Path]) -> list[NumberedFiles]:
    """Group files whose names are equal without the last number.

    Whole numbers count, with a sign after a separator. Numbers with sub-frames (``w_0001.5.obj``) and with a sign after
    a letter (``w-1.obj``) count if otherwise one sequence would be several.
    """
    found: list[NumberedFiles] = []
    for joined in _group(files, _LAST_NUMBER):
        separate = _group([file for _, file in joined.files], _LAST_WHOLE_NUMBER)
        is_one = len(separate) > 1 and _are_frames([number for number, _ in joined.files])
        found += [joined] if is_one else separate
    return found


def _group(files: Iterable[Path], number_pattern: re.Pattern[str]) -> list[NumberedFiles]:
    groups: dict[tuple[str, ...], list[tuple[str, Path]]] = defaultdict(list)
    for file in sorted(files):
        number = number_pattern.search(file.stem)
        before, _, after = number_pattern.sub("\0", file.stem).partition("\0")
        groups[before, "#" * bool(number), after, file.suffix.lower()].append((number[0] if number else "0", file))
    found = []
    for (before, placeholder, after, _), group in groups.items():
        digits = min(len(text.lstrip("-").partition(".")[0]) for text, _ in group)
        pattern = f"{before}{digits * placeholder}{after}{group[0][1].suffix}"
        found.append(NumberedFiles(pattern, sorted((float(text), file) for text, file in group)))
    return found


def _are_frames(numbers: Sequence[float]) -> bool:
    """Whether increasing numbers are whole numbers, and maybe sub-frames of these."""
    wholes = [number for number in numbers if float(number).is_integer()]
    steps = [b - a for a, b in pairwise(numbers) if b > a]
    return bool(wholes) and (len(wholes) == len(numbers) or min(steps) >= MIN_FRAME_STEP)


def _missing_between(number: float, following: float) -> range:
    return range(floor(number) + 1, ceil(following))


def _number_files(path: Path, files: Iterable[Path]) -> list[tuple[float, Path]]:
    """Return the files of a sequence with their numbers; without these, all names must be equal."""
    series = group_numbered_files(file for file in files if not file.name.startswith("."))
    if len(series) > 1:
        names = ", ".join(sorted(each.pattern for each in series)[:10])
        raise AmbiguousError(f"{path} matches several sequences: {names}; give one of these patterns")
    return series[0].files if series else []


def _digit_count(placeholder: re.Match[str]) -> int:
    """Return the minimum number of digits of a placeholder."""
    text = placeholder[0]
    return len(text) if text.startswith("#") else int(placeholder[1] or 1)


def _check_numbers(path: Path, numbered: Sequence[tuple[float, Path]], allow_gaps: bool) -> None:
    missing = []
    for (number, file), (following, following_file) in pairwise(numbered):
        if number == following:
            raise InvalidSequenceError(
                f"{path}: {file.name} and {following_file.name} have the same number; remove one"
            )
        if gap := _missing_between(number, following):
            missing.append(f"{gap[0]}" if len(gap) == 1 else f"{gap[0]}-{gap[-1]}")
    if missing and not allow_gaps:
        more = ", ..." if len(missing) > 10 else ""
        raise InvalidSequenceError(
            f"{path}: numbers {', '.join(missing[:10])}{more} are missing between {numbered[0][1].name} and "
            f"{numbered[-1][1].name}; add the files, or accept the gaps with allow_gaps=True (--allow-gaps)"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshFile:
    """Parsed contents of one file."""

    points: FloatArray  # (V, 3)
    polygons: Polygons
    stored_faces: Any = None  # faces as stored, to detect equal faces in other files
    name: str = ""
    surface: Surface = Surface()  # noqa: RUF009 - deeply frozen. Later frames have only colours
    colour_text: bytes = b""  # colours as stored, to detect equal colours in other files
    has_changing_colours: bool = False  # after a reported change, colours of later files are skipped


Parser = Callable[[Path, bytes, MeshFile | None], MeshFile]
"""Function from file name (for messages), bytes and, for later files, the first frame's mesh to the file's contents."""

Encoder = Callable[[FloatArray, int], Iterable[bytes]]
"""Function from the points ``(V, 3)`` and the index of a frame to the bytes of its file."""


@dataclass(frozen=True)
class FrameFormat:
    """Format whose files contain one frame each."""

    name: str  # name, which in lower case is the extension
    parse: Parser
    make_encoder: Callable[[Path, SequenceHeader], Encoder]  # arguments: pattern, for warnings, and header
    find_losses: Callable[[SequenceHeader], list[str]]
    is_welded: bool = False  # whether vertices are corners that coincide in all files
    is_text: bool = False  # whether files are text, which takes more memory to parse
    damage_errors: tuple[type[Exception], ...] = ()  # errors of `parse` on damaged files, besides mixseq's

    def open(self, path: Path, fps: float = DEFAULT_FPS, allow_gaps: bool = False) -> SequenceReader:
        """Open the numbered files of a sequence."""
        files, numbers = find_frame_files(path, allow_gaps, f".{self.name.lower()}")
        name = files[0].stem
        for _ in range(1 if numbers[0].is_integer() else 2):
            name = name.rstrip("0123456789").rstrip("_-. ")
        with prefix_errors(files[0]):
            first = self.read(files[0])
        if self.is_welded and len(files) > 1:
            for file, number in zip((*files[1:], files[0]), (*numbers[1:], numbers[0]), strict=True):
                with prefix_errors(f"{file} (frame {format_number(number)})"):
                    first = self.read(file, first)
        with prefix_errors(files[0]):
            header = SequenceHeader(
                polygons=first.polygons,
                vertex_count=len(first.points),
                times=np.array(numbers) / fps,
                fps=fps,
                name=first.name or name or "mesh",
                surface=first.surface,
            )
        return _FilesReader(path, header, files, first, self)

    def read(self, file: Path, first: MeshFile | None = None) -> MeshFile:
        """Read one file; `first` is the first frame's mesh for files of later frames."""
        with translate_read_errors(file, with_article(self.name), *self.damage_errors):
            return self.parse(file, read_bytes(file, self.is_text), first)

    def write(
        self,
        path: Path,
        header: SequenceHeader,
        blocks: Iterable[FloatArray],
        velocities: Iterable[FloatArray] | None = None,
        start: int | None = None,
    ) -> None:
        """Write one file per frame, without velocities, named by a pattern such as ``walk_####.obj``.

        Numbers are those of the frames if they are whole and have no gaps, or are sub-frames between such; otherwise
        they begin at 1. With `start`, they count from it. Raise `OutputError` for failed writes or several frames
        without a pattern, `SettingsError` for negative `start`.
        """
        if start is not None and start < 0:
            raise SettingsError(f"start is {start}; files are numbered from 0 or more")
        if header.frame_count > 1 and not is_pattern(path):
            raise OutputError(
                f"{path}: {with_article(self.name)} holds one frame, this sequence has {header.frame_count}; give a "
                f"pattern such as {path.stem.rstrip('*')}_####{path.suffix}"
            )
        numbers = np.array([time_to_number(time, header.fps) for time in header.times]).round(3)
        counted = np.arange(header.frame_count)
        is_lost = not _are_frames(numbers.tolist()) or any(starmap(_missing_between, pairwise(numbers)))
        if start is not None:
            is_lost = bool(np.abs(numbers - numbers[0] - counted).max() > FRAME_TOLERANCE)
        if is_lost or start is not None:
            numbers = counted + (1 if start is None else start)
        losses = ["the times of the frames"] * is_lost
        if header.fps != DEFAULT_FPS:
            losses.insert(0, f"{header.fps:g} frames per second")
        losses *= header.frame_count > 1
        losses += lost_scale(header, velocities is not None) + self.find_losses(header)
        warn_of_losses(path, f"{self.name} files", losses)
        names = [frame_file_name(path, number) for number in numbers]
        encode = self.make_encoder(path, header)
        with atomic_files(path) as folder:
            _, frame_blocks = validate_blocks(header, blocks, velocities)
            for start_frame, block, _ in frame_blocks:
                for frame, points in enumerate(block, start=start_frame):
                    with (folder / names[frame]).open("wb") as file:
                        file.writelines(encode(points, frame))
        if is_pattern(path):
            _warn_of_leftover_files(path, set(names))


class _FilesReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, files: Sequence[Path], first: MeshFile, codec: FrameFormat
    ) -> None:
        super().__init__(path, header)
        self._files = files
        self._first = first
        self._codec = codec

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        for start in range(0, len(self._files), size):
            frames = range(start, min(start + size, len(self._files)))
            yield np.stack([self._points(frame) for frame in frames], dtype=self._first.points.dtype)

    def _points(self, frame: int) -> FloatArray:
        first = self._files[0]
        where = f"{self._files[frame]} (frame {self.header.frame_number(frame)})"
        with prefix_errors(where):
            mesh = self._codec.read(self._files[frame], self._first)
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
        if not (self._first.has_changing_colours or _same_colours(mesh.surface, self.header.surface)):
            self._first = replace(self._first, has_changing_colours=True)
            warn(f"{self.path}: colours that change over time stay as they are in the first frame; {where} has others")
        return mesh.points


def _same_colours(surface: Surface, first: Surface) -> bool:
    a, b = surface.colours, first.colours
    return a is b if a is None or b is None else np.array_equal(a.at_corners, b.at_corners, equal_nan=True)


def with_article(format_name: str) -> str:
    """Return the phrase for a file of a format with its article: "a PLY file", "an OBJ file"."""
    return f"{'a' if format_name.startswith('P') else 'an'} {format_name} file"


def _warn_of_leftover_files(path: Path, written: set[str]) -> None:
    """Warn of files left by a longer previous sequence, which would be read as part of the new sequence."""
    leftover = sorted({file.name for _, file in find_numbered_files(path)} - written)
    if leftover:
        warn(
            f"{path}: {len(leftover)} files of another sequence, {leftover[0]} to {leftover[-1]}, match as well; "
            "remove them, or they will be read as frames of this one"
        )


PRECISION_COMMENT = b"# Written by mixseq, "
"""Beginning of the comment that states the precision of points, float32 or float64."""


def quote_line(line: bytes) -> str:
    """Return the quoted beginning of a line for a message."""
    return repr(line.strip()[:40].decode("ascii", errors="replace"))


def format_number_lines(keyword: str, rows: FloatArray, ends: Sequence[str] = ()) -> bytes:
    """Format each row as a line with enough digits to restore every number, followed by its optional end."""
    line = keyword + " ".join(["%.9g" if rows.dtype == np.float32 else "%.17g"] * rows.shape[1])
    lines = "".join(f"{line}{end}\n" for end in ends) if ends else f"{line}\n" * len(rows)
    text: str = lines % tuple(rows.reshape(-1).tolist())
    return text.encode()


def parse_colours(
    file: Path, vertices: Sequence[int], rows: Sequence[Sequence[bytes]], first: MeshFile | None
) -> FloatArray:
    """Parse the colours ``(n, 3)`` or ``(n, 4)`` of vertices; unreadable colours of later frames become NaN."""
    try:
        return scale_text_colours(np.array(rows, dtype=np.float64))
    except ValueError:
        if first is not None:
            return np.full((len(rows), len(rows[0])), np.nan)
        pairs = zip(vertices, rows, strict=True)
        vertex, row = next((vertex, row) for vertex, row in pairs if not all(map(_is_number, row)))
        raise FormatError(
            f"{file}, vertex {vertex}: the colour {quote_line(b' '.join(row))} is not {len(row)} numbers, which are "
            "expected after the coordinates"
        ) from None


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
