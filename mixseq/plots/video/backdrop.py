"""The static backdrop of a film: places of panels, their names, and the colour bar."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.plots.raster import Picture, blank
from mixseq.plots.sheet_layout import matplotlib_module
from mixseq.plots.video.encoding import pillow_module
from mixseq.scene.palettes import INK
from mixseq.scene.vertex_measures import two_digits

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont

Rectangle = tuple[slice, slice]
"""Rows and columns of a picture."""

LETTERS = 1 / 32
"""Height of letters, as a fraction of the picture's."""

SMALLEST = 24
"""Smallest side of a panel, in pixels."""

STRIP = 2.0
"""Height of a line with its margins, in letters."""


def panels_of(
    count: int, width: int, height: int, aspect: float, named: bool, barred: bool
) -> list[Rectangle]:
    """Divide a picture into equal panels, with as many columns as make meshes of an aspect largest."""
    strip = line_height(height)
    free = height - strip * barred

    def room(columns: int) -> float:
        rows = -(-count // columns)
        return min(width / columns, (free / rows - strip * named) / aspect)

    columns = max(range(1, count + 1), key=room)
    rows = -(-count // columns)
    if min(width // columns, free // rows - strip * named) < SMALLEST:
        raise SettingsError(
            f"{count} panels are too many for a picture of {width}x{height} pixels; give a larger size"
        )
    panels = []
    for number in range(count):
        row, column = divmod(number, columns)
        upper, lower = row * free // rows + strip * named, (row + 1) * free // rows
        panels.append(
            (slice(upper, lower), slice(column * width // columns, (column + 1) * width // columns))
        )
    return panels


def line_height(height: int) -> int:
    """Return the height of a line of text in pixels, for a picture of some height."""
    return round(STRIP * _letters(height))


def _letters(height: int) -> int:
    return max(9, round(LETTERS * height))


def backdrop_of(
    width: int,
    height: int,
    panels: Sequence[Rectangle],
    names: Sequence[str],
    palette: Float | None = None,
    top: float = 0.0,
    meaning: str = "",
) -> Picture:
    """Draw names above the panels, and with a palette ``(n, 3)`` the colour bar from 0 to `top` below them."""
    image = pillow_module("Image").fromarray(blank(width, height))
    draw = pillow_module("ImageDraw").Draw(image)
    font, strip = _font(_letters(height)), line_height(height)
    for (rows, columns), name in zip(panels, names, strict=True):
        if name:
            room = columns.stop - columns.start - strip
            middle = (columns.start + columns.stop) / 2
            draw.text((middle, rows.start - strip / 2), _shortened(name, font, room), INK, font, "mm")
    if palette is not None:
        _draw_bar(image, draw, font, palette, top, meaning)
    return np.array(image)


def _draw_bar(
    image: Any, draw: ImageDraw, font: FreeTypeFont, palette: Float, top: float, meaning: str
) -> None:
    width, height = image.size
    strip, letters = line_height(height), _letters(height)
    long, thick = width // 4, max(4, letters // 2)
    middle, left = height - strip / 2, (width - long) // 2
    bar = palette[np.arange(long) * len(palette) // long]
    rows = np.broadcast_to(np.rint(255 * bar).astype(np.uint8), (thick, long, 3))
    upper = round(middle - thick / 2)
    image.paste(pillow_module("Image").fromarray(np.ascontiguousarray(rows)), (left, upper))
    draw.text((left - letters / 2, middle), "0", INK, font, "rm")
    draw.text((left + long + letters / 2, middle), f"{two_digits(top)} {meaning}", INK, font, "lm")


def _font(size: int) -> FreeTypeFont:
    """Return the font of the charts, from matplotlib, with equal layout on all machines."""
    folder = Path(matplotlib_module("_api").__file__).parents[1] / "mpl-data" / "fonts" / "ttf"
    fonts = pillow_module("ImageFont")
    font: FreeTypeFont = fonts.truetype(folder / "DejaVuSans.ttf", size, layout_engine=fonts.Layout.BASIC)
    return font


def _shortened(text: str, font: FreeTypeFont, room: float) -> str:
    """Return a text with its middle left out if it is too long."""
    kept = len(text)
    short = text
    while kept > 2 and font.getlength(short) > room:
        kept -= 1
        short = f"{text[: kept - kept // 2]}…{text[len(text) - kept // 2 :]}"
    return short
