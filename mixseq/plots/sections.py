"""Pages from sections: pieces of a natural size, one below the other or side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import FigureBase


@dataclass(frozen=True)
class Section:
    """A piece of a page.

    Attributes
    ----------
    width, height : float
        How large it wants to be, in inches.
    draw : callable
        Draws it on a matplotlib Figure or SubFigure.
    """

    width: float
    height: float
    draw: Callable[[FigureBase], None]


def stacked(*sections: Section) -> Section:
    """Put sections one below the other, all as wide as the widest."""

    def draw(page: FigureBase) -> None:
        heights = [section.height for section in sections]
        rows = page.subfigures(len(sections), 1, squeeze=False, height_ratios=heights)[:, 0]
        for section, row in zip(sections, rows, strict=True):
            section.draw(row)

    width = max(section.width for section in sections)
    return Section(width, sum(section.height for section in sections), draw)


def beside(*sections: Section) -> Section:
    """Put sections side by side, all as high as the highest."""

    def draw(page: FigureBase) -> None:
        widths = [section.width for section in sections]
        columns = page.subfigures(1, len(sections), squeeze=False, width_ratios=widths)[0]
        for section, column in zip(sections, columns, strict=True):
            section.draw(column)

    height = max(section.height for section in sections)
    return Section(sum(section.width for section in sections), height, draw)
