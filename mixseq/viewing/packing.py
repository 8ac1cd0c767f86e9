"""Binary data as text in a page: two bytes a character; rows of colours as bytes that deflate well.

A page is UTF-16 with a byte order mark, which overrides a server's encoding. Two bytes, the lower one first, are one
code unit. Units that the text of a script element cannot hold (NUL, carriage return, ``<``, surrogates) and U+0001 are
written as U+0001 and a unit with the highest bit flipped. This adds 3 % to typical bytes; base64 in UTF-8 adds 33 %, 7
bits a character 14 %. ``page/loader.js`` decodes it.

Of rows :math:`q_{tj}` of bytes, a row per frame, the page has :math:`s_{tj} = d_{tj} - d_{t,j-1}` with
:math:`d_{tj} = q_{tj} - q_{t-1,j}` and zeros before the first row and column, modulo 256, deflated (RFC 1950), which
browsers decode.
"""

from __future__ import annotations

import codecs
import zlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

ENCODING = "utf-16-le"
"""Encoding of pages."""

BYTE_ORDER_MARK = codecs.BOM_UTF16_LE
"""First character of pages."""

ESCAPE = 1
"""The unit before those with a flipped highest bit."""

_UNFIT = np.array([0, ord("\r"), ord("<"), ESCAPE])
_HALVES = 0xD800, 0xDFFF


def as_text(data: bytes) -> bytes:
    """Return bytes as UTF-16 text of a script element; an odd number is padded by a zero."""
    units = np.frombuffer(data + bytes(len(data) % 2), "<u2")
    unfit = np.isin(units, _UNFIT) | ((units >= _HALVES[0]) & (units <= _HALVES[1]))
    text = np.repeat(units, 1 + unfit)
    seconds = np.cumsum(1 + unfit)[unfit] - 1
    text[seconds - 1] = ESCAPE
    text[seconds] ^= 0x8000
    return text.tobytes()


def deflated_rows(rows: Iterable[NDArray[np.uint8]]) -> bytes:
    """Return rows ``(V,)`` of bytes, joined and deflated."""
    deflate, parts = zlib.compressobj(9), []
    before: NDArray[np.uint8] | None = None
    for row in rows:
        steps = row - (np.zeros_like(row) if before is None else before)
        parts.append(deflate.compress(np.diff(steps, prepend=np.uint8(0)).tobytes()))
        before = row
    return b"".join([*parts, deflate.flush()])
