"""Animated GIF [1]_, frame by frame: one palette for all of them, and only the pixels that change.

The palette has 255 colours of frames from all over the film (median cut [2]_); the last of its 256 means that a pixel
stays as it was. Nothing is dithered: noise would flicker, and does not compress.

References
----------
.. [1] CompuServe: Graphics Interchange Format, version 89a, 1990.
.. [2] P. Heckbert: Color image quantization for frame buffer display. SIGGRAPH 1982.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.plots.raster import PAPER
from mixseq.plots.video.encoding import Draw, pillow_module

SAME = 255
"""The index of pixels that stay as they were."""

WHITE = 254
"""The index of the paper."""

LOOKED_AT = 6
"""Frames whose colours make the palette."""


def write_gif(target: Path, draw: Draw, count: int, fps: float) -> None:
    """Write frames as a GIF that plays for ever; parameters as those of `encode_film`."""
    image = pillow_module("Image")
    plugin = pillow_module("GifImagePlugin")
    palette = _palette(draw, count)
    shown: NDArray[np.uint8] | None = None
    with target.open("wb") as file:
        for frame, picture in enumerate(draw(range(count))):
            nearest = image.fromarray(picture).quantize(palette=palette, dither=image.Dither.NONE)
            # what Pillow finds is near; paper must not become a little grey
            indices = np.where((picture == PAPER).all(axis=2), WHITE, np.asarray(nearest)).astype(np.uint8)
            rows, columns = _changed(indices, shown)
            changed = indices[rows, columns]
            if shown is None:
                file.write(_header(picture.shape[1], picture.shape[0], palette))
            else:
                changed = np.where(changed == shown[rows, columns], SAME, changed).astype(np.uint8)
            hundredths = round(100 * (frame + 1) / fps) - round(100 * frame / fps)
            for piece in plugin.getdata(
                image.fromarray(changed),
                (columns.start, rows.start),
                duration=10 * hundredths,
                transparency=SAME,
                disposal=1,
                interlace=0,
            ):
                file.write(piece)
            shown = indices
        file.write(b";")


def _palette(draw: Draw, count: int) -> Any:
    """Return an image with the palette of a film."""
    image = pillow_module("Image")
    frames = sorted({number * count // LOOKED_AT for number in range(LOOKED_AT)})
    pixels = np.concatenate([picture.reshape(-1, 3) for picture in draw(frames)])
    # Colours of few pixels, as at the rims of meshes, count more than their share; paper is as white as it was.
    levels = np.dot(pixels >> 2, np.array([1 << 12, 1 << 6, 1], dtype=np.int64))
    _, first, counts = np.unique(levels, return_index=True, return_counts=True)
    chosen = np.repeat(pixels[first], np.ceil(np.sqrt(counts)).astype(np.int64), axis=0)
    ink = np.append(chosen[(chosen != PAPER).any(axis=1)], [[0, 0, 0]], axis=0).astype(np.uint8)
    colours = image.fromarray(ink[None]).quantize(WHITE, method=image.Quantize.MEDIANCUT)
    listed = [*bytes(colours.getpalette("RGB"))[: 3 * WHITE].ljust(3 * WHITE, b"\0"), PAPER, PAPER, PAPER]
    palette = image.new("P", (1, 1))
    palette.putpalette(listed)
    return palette


def _changed(indices: NDArray[np.uint8], before: NDArray[np.uint8] | None) -> tuple[slice, slice]:
    """Return the rows and columns in which pixels changed; one pixel, if none did."""
    if before is None:
        return slice(0, indices.shape[0]), slice(0, indices.shape[1])
    other = indices != before
    rows, columns = np.flatnonzero(other.any(axis=1)), np.flatnonzero(other.any(axis=0))
    if not rows.size:
        return slice(0, 1), slice(0, 1)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _header(width: int, height: int, palette: Any) -> bytes:
    """Return what comes before the frames: size, 256 colours, and that the film is repeated for ever."""
    colours = bytes(palette.getpalette("RGB"))[: 3 * SAME].ljust(3 * 256, b"\0")
    screen = struct.pack("<HHBBB", width, height, 0xF7, 0, 0)
    return b"GIF89a" + screen + colours + b"!\xff\x0bNETSCAPE2.0\x03\x01\0\0\0"
