"""Drawn frames as an image of Pillow whose frames come one by one, as its encoders take those of opened files."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from mixseq.plots.raster import Picture
from mixseq.plots.video.encoding import pillow_module


def reel(pictures: Iterator[Picture], count: int) -> Any:
    """Return an image of `count` frames that takes each from `pictures` when it is sought; there is no way back.

    Raises
    ------
    StopIteration
        If there are no pictures.
    """
    return _reel_class()(pictures, count)


@lru_cache(maxsize=1)
def _reel_class() -> Any:
    """Return the class, which can only be made where Pillow is."""
    image = pillow_module("Image")
    base: Any = image.Image

    class Reel(base):  # type: ignore[misc]
        is_animated = True

        def __init__(self, pictures: Iterator[Picture], count: int) -> None:
            super().__init__()
            self.n_frames = count
            self._pictures = pictures
            self._frame = -1
            self.seek(0)

        def tell(self) -> int:
            return self._frame

        def seek(self, frame: int) -> None:
            if frame >= self.n_frames:
                raise EOFError
            while self._frame < frame:
                picture = image.fromarray(next(self._pictures))
                self.im, self._mode, self._size = picture.im, picture.mode, picture.size
                self._frame += 1

    return Reel
