"""Films of mesh sequences and models, drawn in software and encoded by Pillow or ffmpeg (the extra ``plot``).

`film` combines the frames of a scene (panels), names and a colour bar (backdrop), and the file (encoding, ffmpeg).
"""

from mixseq.choices import COLOURS, Colour
from mixseq.plots.video.encoding import FILM_FORMATS, FilmFormat, check_film, film_format
from mixseq.plots.video.film import FilmSettings, film

__all__ = [
    "COLOURS",
    "FILM_FORMATS",
    "Colour",
    "FilmFormat",
    "FilmSettings",
    "check_film",
    "film",
    "film_format",
]
