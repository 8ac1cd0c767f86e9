"""Read the text files that the core and the file formats share: edit scripts, retimings, markers, maps, contacts."""

from __future__ import annotations

from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path

from mixseq.errors import FormatError, MissingFileError


def read_text(file: Path, what: str) -> str:
    """Read a UTF-8 file, with or without a byte order mark; `what` names the expected contents in messages."""
    try:
        data = file.read_bytes()
    except FileNotFoundError:
        raise MissingFileError(f"{file} does not exist") from None
    except OSError as error:
        raise FormatError(f"{file} cannot be read: {error.strerror or error}") from None
    return decode_text(file, data, what)


def decode_text(file: Path, data: bytes, what: str) -> str:
    """Decode the bytes of a UTF-8 file as in `read_text`."""
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        raise FormatError(f"{file} cannot be read as {what}: its text is UTF-16; save it as UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{file} cannot be read as {what}: byte {error.start} is not UTF-8") from None
