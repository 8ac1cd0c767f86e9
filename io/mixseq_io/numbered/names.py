"""File names with frame numbers: ``walk_####.obj``, ``walk_%04d.obj``, ``walk_*.obj``, or a folder."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError

_PLACEHOLDER = re.compile(r"#+|%0?(\d*)d")
_LAST_NUMBER = re.compile(r"(\d+)(?=\D*$)")


def is_pattern(path: Path) -> bool:
    """Whether a file name has a placeholder of the frame number: ``####`` or ``%04d``."""
    return _PLACEHOLDER.search(path.name) is not None


def numbered_name(pattern: Path, number: int) -> str:
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
        numbered = files_of_pattern(path)
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


def files_of_pattern(path: Path) -> list[tuple[int, Path]]:
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
