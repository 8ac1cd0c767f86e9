"""Films of mesh sequences and models, drawn in software and encoded by Pillow (the extra ``plot``).

`film` puts them together: what is shown when (timing), in which colours (colouring), where and from which side (page,
scene), and in which file (encoding; gif, webp, av1 with mp4).
"""

from mixseq.plots.video.colouring import COLOURS, Colour
from mixseq.plots.video.encoding import FILM_FORMATS, FilmFormat, check_film, film_format
from mixseq.plots.video.film import FilmSettings, Shown, film

__all__ = [
    "COLOURS",
    "FILM_FORMATS",
    "Colour",
    "FilmFormat",
    "FilmSettings",
    "Shown",
    "check_film",
    "film",
    "film_format",
]
