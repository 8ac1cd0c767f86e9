"""Pictures of numbers: PNG with 8 or 16 bits, and EXR with 32-bit floats.

PNG is written here with zlib, since Pillow has no 16 bits in three channels. Each row is filtered by none, the pixel to
the left, or the one above, whichever has the smallest sum of magnitudes, as in libpng.

Specifications: https://www.w3.org/TR/png-3/, https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import MissingExtraError

LARGEST = 16384
"""Largest side in pixels, above the limit of many graphics cards."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {3: 2, 4: 6}
_NONE, _SUB, _UP = 0, 1, 2


def png_of(pixels: NDArray[Any]) -> bytes:
    """Return a PNG of pixels ``(height, width, 3 or 4)``, from the top left, uint8 or uint16."""
    height, width, channels = pixels.shape
    size = pixels.dtype.itemsize * channels
    rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">"))).view(np.uint8)
    rows = rows.reshape(height, width * size)
    left = np.pad(rows, ((0, 0), (size, 0)))[:, : width * size]
    above = np.pad(rows, ((1, 0), (0, 0)))[:height]
    candidates = np.stack([rows, rows - left, rows - above])
    magnitudes = np.abs(candidates.view(np.int8).astype(np.int16)).sum(axis=2)
    chosen = magnitudes.argmin(axis=0)
    filters = np.array([_NONE, _SUB, _UP], np.uint8)[chosen][:, None]
    lines = np.concatenate([filters, candidates[chosen, np.arange(height)]], axis=1)
    header = struct.pack(
        ">IIBBBBB", width, height, 8 * pixels.dtype.itemsize, _COLOUR_TYPES[channels], 0, 0, 0
    )
    parts = (b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b"")
    return _SIGNATURE + b"".join(_chunk(*part) for part in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_exr(path: Path, pixels: NDArray[np.float32]) -> None:
    """Write an EXR of pixels ``(height, width, 3 or 4)``, from the top left."""
    library = exr_library(path)
    names = "RGBA"[: pixels.shape[2]]
    channels = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    with library.File(header, channels) as file:
        file.write(str(path))


def exr_library(path: Path) -> Any:
    """Return the package that writes EXR."""
    try:
        import OpenEXR
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"{path}: EXR textures need OpenEXR; get it with: pip install 'mixseq[exr]', or write png16"
        ) from error
    return OpenEXR
