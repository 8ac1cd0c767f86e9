"""Pictures and films of mesh sequences, drawn in software with matplotlib (the extra ``plot``).

A `scene` holds meshes, colours and times; a `camera` looks at it; `raster` draws its faces, sorted by depth.
`sheets`, `charts` and `models` compose pictures on a `page`; `film` renders frames, `film_encoding` writes them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixseq.runtime.lazy import forwarded

if TYPE_CHECKING:
    from mixseq.choices import COLOURS, Colour
    from mixseq.pictures.charts import (
        draw_coefficients,
        draw_embedding,
        draw_singular_values,
        picture_format,
        singular_values,
    )
    from mixseq.pictures.colours import (
        CLAY,
        INK,
        JOINT_RED,
        Colouring,
        SceneColours,
        colourings_of,
        part_colours,
        segmentation_colours,
    )
    from mixseq.pictures.film import FilmSettings, film
    from mixseq.pictures.film_encoding import FILM_FORMATS, FilmFormat, check_film, film_format
    from mixseq.pictures.models import (
        VertexErrors,
        add_error_bar,
        check_settings,
        draw_frame_errors,
        draw_parts,
        draw_parts_legend,
        draw_vertex_errors,
        plot_model,
        vertex_errors,
    )
    from mixseq.pictures.page import DPI, Target, draw_mesh
    from mixseq.pictures.scene import (
        Camera,
        Limits,
        Scene,
        SceneItem,
        View,
        shared_limits,
        three_quarter_view,
    )
    from mixseq.pictures.sheets import contact_sheet, draw_segmentation

__all__ = [
    "CLAY",
    "COLOURS",
    "DPI",
    "FILM_FORMATS",
    "INK",
    "JOINT_RED",
    "Camera",
    "Colour",
    "Colouring",
    "FilmFormat",
    "FilmSettings",
    "Limits",
    "Scene",
    "SceneColours",
    "SceneItem",
    "Target",
    "VertexErrors",
    "View",
    "add_error_bar",
    "check_film",
    "check_settings",
    "colourings_of",
    "contact_sheet",
    "draw_coefficients",
    "draw_embedding",
    "draw_frame_errors",
    "draw_mesh",
    "draw_parts",
    "draw_parts_legend",
    "draw_segmentation",
    "draw_singular_values",
    "draw_vertex_errors",
    "film",
    "film_format",
    "part_colours",
    "picture_format",
    "plot_model",
    "segmentation_colours",
    "shared_limits",
    "singular_values",
    "three_quarter_view",
    "vertex_errors",
]

__getattr__ = forwarded(
    __name__,
    {
        "CLAY": "mixseq.pictures.colours",
        "COLOURS": "mixseq.choices",
        "Camera": "mixseq.pictures.scene",
        "Colour": "mixseq.choices",
        "Colouring": "mixseq.pictures.colours",
        "DPI": "mixseq.pictures.page",
        "FILM_FORMATS": "mixseq.pictures.film_encoding",
        "FilmFormat": "mixseq.pictures.film_encoding",
        "FilmSettings": "mixseq.pictures.film",
        "INK": "mixseq.pictures.colours",
        "JOINT_RED": "mixseq.pictures.colours",
        "Limits": "mixseq.pictures.scene",
        "Scene": "mixseq.pictures.scene",
        "SceneColours": "mixseq.pictures.colours",
        "SceneItem": "mixseq.pictures.scene",
        "Target": "mixseq.pictures.page",
        "VertexErrors": "mixseq.pictures.models",
        "View": "mixseq.pictures.scene",
        "add_error_bar": "mixseq.pictures.models",
        "check_film": "mixseq.pictures.film_encoding",
        "check_settings": "mixseq.pictures.models",
        "colourings_of": "mixseq.pictures.colours",
        "contact_sheet": "mixseq.pictures.sheets",
        "draw_coefficients": "mixseq.pictures.charts",
        "draw_embedding": "mixseq.pictures.charts",
        "draw_frame_errors": "mixseq.pictures.models",
        "draw_mesh": "mixseq.pictures.page",
        "draw_parts": "mixseq.pictures.models",
        "draw_parts_legend": "mixseq.pictures.models",
        "draw_segmentation": "mixseq.pictures.sheets",
        "draw_singular_values": "mixseq.pictures.charts",
        "draw_vertex_errors": "mixseq.pictures.models",
        "film": "mixseq.pictures.film",
        "film_format": "mixseq.pictures.film_encoding",
        "part_colours": "mixseq.pictures.colours",
        "picture_format": "mixseq.pictures.charts",
        "plot_model": "mixseq.pictures.models",
        "segmentation_colours": "mixseq.pictures.colours",
        "shared_limits": "mixseq.pictures.scene",
        "singular_values": "mixseq.pictures.charts",
        "three_quarter_view": "mixseq.pictures.scene",
        "vertex_errors": "mixseq.pictures.models",
    },
)
