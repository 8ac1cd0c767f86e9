"""Parsing of TOML for scripts and retimings, with a FormatError for any fault."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from mixseq.errors import FormatError

_LARGEST = 2**63
_DEEPEST = 20


def parse_toml(file: Path, text: str) -> dict[str, Any]:
    """Parse the text of a TOML file; FormatError for invalid, too deep or too large values."""
    try:
        parsed = tomllib.loads(text)
    except RecursionError:
        raise FormatError(f"{file} is not a TOML file: its tables or lists are nested too deeply") from None
    except ValueError as error:  # integers of thousands of digits are one, too
        raise FormatError(f"{file} is not a TOML file: {error}") from None
    level: list[Any] = [parsed]
    for _ in range(_DEEPEST):
        inner = [value for each in level for value in (each.values() if isinstance(each, dict) else each)]
        for value in inner:
            if isinstance(value, int) and not -_LARGEST <= value < _LARGEST:
                raise FormatError(f"{file} is not a TOML file: {str(value)[:20]}... has more than 64 bits")
        level = [value for value in inner if isinstance(value, dict | list)]
        if not level:
            return parsed
    raise FormatError(f"{file} is not a TOML file: its tables or lists are nested too deeply")
