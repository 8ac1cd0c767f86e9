"""Read text files: the encodings and line ends of edit scripts, retimings, markers, maps, contacts and text meshes."""

from __future__ import annotations

from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE, BOM_UTF32_BE, BOM_UTF32_LE
from pathlib import Path

from mixseq.errors import FormatError, MissingFileError

_BYTE_ORDER_MARKS = {BOM_UTF32_LE: 32, BOM_UTF32_BE: 32, BOM_UTF16_LE: 16, BOM_UTF16_BE: 16}
"""Bits of a code unit by byte order mark; that of UTF-16 begins that of UTF-32."""

_ASCII_PATTERNS = {b"x000": 32, b"000x": 32, b"x0x0": 16, b"0x0x": 16}
"""Bits of a code unit by the zeros among the first four bytes of text that begins with ASCII."""


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
    """Decode the bytes of a UTF-8 file as in `read_text`; lines end in newlines alone."""
    try:
        text = strip_byte_order_mark(file, data, what).decode()
    except UnicodeDecodeError as error:
        raise FormatError(f"{file} cannot be read as {what}: byte {error.start} is not UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def strip_byte_order_mark(file: Path, data: bytes, what: str) -> bytes:
    """Return the bytes of UTF-8 text without a byte order mark; refuse UTF-16 and UTF-32, with or without one."""
    pattern = bytes(b"x0"[byte == 0] for byte in data[:4])
    marks = (bits for mark, bits in _BYTE_ORDER_MARKS.items() if data.startswith(mark))
    if bits := next(marks, _ASCII_PATTERNS.get(pattern)):
        raise FormatError(f"{file} cannot be read as {what}: its text is UTF-{bits}; save it as UTF-8")
    return data.removeprefix(BOM_UTF8)
