"""Parse and format lengths: fractions of the bounding-box diagonal, or lengths with a unit.

Errors and tolerances are fractions of the diagonal of the bounding box in the first frame, such as ``--max-error
0.001``. A length such as ``--max-error 0.5mm`` is converted to a fraction by the sequence's unit. Reports print both.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from mixseq.choices import UNITS
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    from mixseq.sequence.sequence import Frames

_LENGTH_PATTERN = re.compile(rf"(\d+\.?\d*(?:e[-+]?\d+)?|\.\d+(?:e[-+]?\d+)?)\s*({'|'.join(UNITS)}|)", re.IGNORECASE)

_REPORTED_UNITS = ("km", "m", "cm", "mm")
"""Units of reported lengths, in descending order."""


def parse_length(text: str) -> float | str:
    """Parse an option value: return a fraction of the diagonal as a number, a length with a unit as text.

    >>> parse_length("1e-3"), parse_length("0.5 mm")
    (0.001, '0.5mm')
    """
    match = _LENGTH_PATTERN.fullmatch(text.strip())
    if not match or not 0.0 < float(match[1]) < float("inf"):
        raise click.BadParameter(f"{text!r} is not a length above 0, such as 0.001 (of the diagonal) or 0.5mm")
    return f"{match[1]}{match[2].lower()}" if match[2] else float(match[1])


def in_diagonals(settings: Mapping[str, Any], frames: Frames, *names: str) -> dict[str, Any]:
    """Return settings with the named lengths converted to fractions of the diagonal of a sequence's first frame."""
    from mixseq.sequence.sequence import bounding_diagonal

    converted = dict(settings)
    for name in names:
        length = settings.get(name)
        match = _LENGTH_PATTERN.fullmatch(length) if isinstance(length, str) else None
        if match is None:
            continue
        diagonal = bounding_diagonal(next(iter(frames.blocks(1)))[0]) * frames.header.metres_per_unit
        if not diagonal > 0.0:
            raise SettingsError(
                f"{frames.header.name!r} has no size in its first frame, so {length} is no fraction of it; give a "
                "sequence whose first frame is larger than a point"
            )
        converted[name] = float(match[1]) * UNITS[match[2]] / diagonal
    return converted


def length_text(fraction: float, diagonal: float, digits: int = 4) -> str:
    """Format a fraction of a diagonal, with the corresponding length in brackets; `diagonal` is in metres.

    >>> length_text(0.0005, 1.8)
    '0.0005 diagonals (0.9 mm)'
    """
    metres = fraction * diagonal
    unit = next((name for name in _REPORTED_UNITS if metres >= UNITS[name]), "mm")
    return f"{fraction:.{digits}g} diagonals ({metres / UNITS[unit]:.3g} {unit})"
