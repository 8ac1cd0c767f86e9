r"""Bytes as text in a page: two a character, and rows of colours as bytes that deflate well.

A page is text in UTF-16, which the mark at its beginning says, whatever a server says. Two bytes, the lower one first,
are one unit of it. What the text of a script element cannot hold, NUL, the carriage return, ``<`` and halves of pairs
(surrogates), is written as U+0001 and a unit with another highest bit; so is U+0001 itself. Of bytes as they come these
are 3 %, where base64 in UTF-8 takes 33 % more, and 7 bits a character 14 %. ``page/loader.js`` undoes it.

Of rows :math:`q_{tj}` of bytes, a row per frame, the page has :math:`s_{tj} = d_{tj} - d_{t,j-1}` with :math:`d_{tj} =
q_{tj} - q_{t-1,j}` and zeros before the first row and column, modulo 256, through deflate (RFC 1950), which browsers
undo by themselves.
"""

from __future__ import annotations

import codecs
import zlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

ENCODING = "utf-16-le"
"""Of pages."""

BYTE_ORDER_MARK = codecs.BOM_UTF16_LE
"""What pages begin with."""

ESCAPE = 1
"""The unit before those whose highest bit is another one."""

_UNFIT = np.array([0, ord("\r"), ord("<"), ESCAPE])
_HALVES = 0xD800, 0xDFFF


def as_text(data: bytes) -> bytes:
    """Return bytes as the text of a script element, in UTF-16; of an odd number, a zero more is in it."""
    units = np.frombuffer(data + bytes(len(data) % 2), "<u2")
    unfit = np.isin(units, _UNFIT) | ((units >= _HALVES[0]) & (units <= _HALVES[1]))
    text = np.repeat(units, 1 + unfit)
    seconds = np.cumsum(1 + unfit)[unfit] - 1
    text[seconds - 1] = ESCAPE
    text[seconds] ^= 0x8000
    return text.tobytes()


def deflated_rows(rows: Iterable[NDArray[np.uint8]]) -> bytes:
    """Return rows ``(V,)`` of bytes, one after the other, deflated."""
    deflate, parts = zlib.compressobj(9), []
    before: NDArray[np.uint8] | None = None
    for row in rows:
        steps = row - (np.zeros_like(row) if before is None else before)
        parts.append(deflate.compress(np.diff(steps, prepend=np.uint8(0)).tobytes()))
        before = row
    return b"".join([*parts, deflate.flush()])
