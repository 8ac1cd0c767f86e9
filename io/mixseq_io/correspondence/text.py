"""Files of text and JSON, read whole, with errors that name the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mixseq.errors import FormatError
from mixseq_io.reader import brief, reading


def read_text(file: Path, what: str) -> str:
    """Read a file of UTF-8, with or without a byte order mark; `what` it should be is for the message.

    Raises
    ------
    FormatError
        If there is no such file, or it is no text.
    """
    with reading(file, what, UnicodeDecodeError):
        return file.read_text(encoding="utf-8-sig")


def parse_json(file: Path, text: str) -> Any:
    """Parse what was read from a file of JSON.

    Raises
    ------
    FormatError
        If it is none; the message names the file, line and column.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits are a ValueError, too
        raise FormatError(f"{file} cannot be read as JSON: {brief(error)}") from None
