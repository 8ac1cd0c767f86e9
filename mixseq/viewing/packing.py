r"""Bytes as text in a page: 7 bits a character, and rows of colours as bytes that deflate well.

A page is text, in UTF-8, in which 128 characters take one byte. Of these a script element cannot hold three: NUL, the
carriage return, and ``<``. So bytes, the highest bit first, are written as digits of 7 bits; a digit that is one of the
three is written with the one after it, as the character ``(k + 1) << 7 | next``, which takes two bytes in UTF-8, with k
its number among the three. That takes 8 characters for 7 bytes, where base64 takes 9.3. ``page/loader.js`` undoes it.

Of rows :math:`q_{tj}` of bytes, a row per frame, the page has :math:`s_{tj} = d_{tj} - d_{t,j-1}` with :math:`d_{tj} =
q_{tj} - q_{t-1,j}` and zeros before the first row and column, modulo 256, through deflate (RFC 1950), which browsers
undo by themselves.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

UNFIT = b"\0\r<"
"""Characters that the text of a script element cannot hold as they are."""

_UNFIT_AND_NEXT = re.compile(rb"([\0\r<])(.)", re.DOTALL)


def as_text(data: bytes) -> bytes:
    """Return bytes as the text of a script element, in UTF-8."""
    bits = np.unpackbits(np.frombuffer(data, np.uint8))
    digits = np.zeros((-(-len(bits) // 7), 8), np.uint8)
    padded = np.concatenate([bits, np.zeros(7 * len(digits) - len(bits), np.uint8)])
    digits[:, 1:] = padded.reshape(-1, 7)
    text = np.packbits(digits, axis=1).tobytes()
    if text and text[-1] in UNFIT:  # it needs one after it
        text += b"\1"
    return _UNFIT_AND_NEXT.sub(lambda pair: chr(UNFIT.index(pair[1]) + 1 << 7 | pair[2][0]).encode(), text)


def deflated_rows(rows: Iterable[NDArray[np.uint8]]) -> bytes:
    """Return rows ``(V,)`` of bytes, one after the other, deflated."""
    deflate, parts = zlib.compressobj(9), []
    before: NDArray[np.uint8] | None = None
    for row in rows:
        steps = row - (np.zeros_like(row) if before is None else before)
        parts.append(deflate.compress(np.diff(steps, prepend=np.uint8(0)).tobytes()))
        before = row
    return b"".join([*parts, deflate.flush()])
