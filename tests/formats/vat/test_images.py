"""Pictures of numbers: PNG with 8 and 16 bits as Pillow and our own JavaScript see them, EXR as its library does."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import MissingExtraError
from mixseq_io.vat import textures
from mixseq_io.vat.textures import encode_png, write_exr

pytestmark = pytest.mark.slow


def unpacked(png: bytes) -> NDArray[np.unsignedinteger]:
    """Read a PNG as the specification has it; filters none (0), sub (1) and up (2)."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    at, data, header = 8, b"", b""
    while at < len(png):
        length, kind = struct.unpack(">I4s", png[at : at + 8])
        body = png[at + 8 : at + 8 + length]
        assert struct.unpack(">I", png[at + 8 + length : at + 12 + length])[0] == zlib.crc32(kind + body)
        data += body if kind == b"IDAT" else b""
        header = body if kind == b"IHDR" else header
        at += 12 + length
    width, height, bits, colours = struct.unpack(">IIBB", header[:10])
    channels = {2: 3, 6: 4}[colours]
    size = channels * bits // 8
    lines = np.frombuffer(zlib.decompress(data), np.uint8).reshape(height, 1 + width * size)
    assert lines[:, 0].max() <= 2
    rows = np.zeros((height + 1, width, size), np.uint8)
    for y, line in enumerate(lines):
        row = line[1:].reshape(width, size)
        rows[y + 1] = np.cumsum(row, axis=0, dtype=np.uint8) if line[0] == 1 else row + (line[0] // 2) * rows[y]
    pixels = rows[1:].reshape(height, -1).view(f">u{bits // 8}")
    return pixels.reshape(height, width, channels).astype(f"u{bits // 8}")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [3, 4])
def test_png_comes_back(dtype: type, channels: int) -> None:
    rng = np.random.default_rng(0)
    noise: NDArray[Any] = rng.integers(0, np.iinfo(dtype).max + 1, (5, 7, channels)).astype(dtype)
    ramp: NDArray[Any] = np.tile(np.arange(7, dtype=dtype)[None, :, None], (5, 1, channels))
    for pixels in (noise, ramp, np.zeros((1, 1, channels), dtype)):
        np.testing.assert_array_equal(unpacked(encode_png(pixels)), pixels)


def test_pillow_sees_the_same_in_8_bits() -> None:
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(1).integers(0, 256, (9, 11, 3)).astype(np.uint8)
    np.testing.assert_array_equal(np.asarray(image.open(io.BytesIO(encode_png(pixels)))), pixels)


def test_what_repeats_is_small() -> None:
    pixels = np.tile(np.random.default_rng(2).integers(0, 65536, (1, 64, 3)).astype(np.uint16), (100, 1, 1))
    assert len(encode_png(pixels)) < 2 * 64 * 6


def test_exr(tmp_path: Path) -> None:
    library = pytest.importorskip("OpenEXR")
    pixels = np.random.default_rng(3).normal(size=(4, 6, 4)).astype(np.float32)
    write_exr(tmp_path / "some.exr", pixels)
    with library.File(str(tmp_path / "some.exr")) as file:
        found = np.asarray(file.channels()["RGBA"].pixels)
    np.testing.assert_array_equal(found, pixels)


def test_exr_without_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    with pytest.raises(MissingExtraError, match=r"walk.vat: EXR textures.*pip install 'mixseq\[exr\]'"):
        textures.import_openexr(Path("walk.vat"))
