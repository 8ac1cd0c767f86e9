"""Pictures and films of mesh sequences, drawn in software with matplotlib (the extra ``plot``).

`scene` has meshes, times and cameras, `colours` their colours. `page`, `sheets`, `charts` and `models` draw with
matplotlib, `raster` draws the frames of a `film`, and `film_encoding` writes them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixseq.runtime.lazy import lazy_getattr

if TYPE_CHECKING:
    from mixseq.pictures.charts import (
        draw_coefficients,
        draw_embedding,
        draw_singular_values,
        singular_values,
    )
    from mixseq.pictures.colours import (
        CLAY_COLOUR,
        INK_COLOUR,
        JOINT_RED,
        Colouring,
        SceneColours,
        available_colourings,
        part_colours,
        segmentation_colours,
    )
    from mixseq.pictures.film import FilmSettings, film
    from mixseq.pictures.models import (
        VertexErrors,
        add_error_bar,
        draw_frame_errors,
        draw_parts,
        draw_parts_legend,
        draw_vertex_errors,
        plot_model,
        vertex_errors,
    )
    from mixseq.pictures.page import draw_mesh
    from mixseq.pictures.scene import Camera, Scene, SceneItem, View, shared_limits, three_quarter_view
    from mixseq.pictures.sheets import contact_sheet, draw_segmentation

__all__ = [
    "CLAY_COLOUR",
    "INK_COLOUR",
    "JOINT_RED",
    "Camera",
    "Colouring",
    "FilmSettings",
    "Scene",
    "SceneColours",
    "SceneItem",
    "VertexErrors",
    "View",
    "add_error_bar",
    "available_colourings",
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
    "part_colours",
    "plot_model",
    "segmentation_colours",
    "shared_limits",
    "singular_values",
    "three_quarter_view",
    "vertex_errors",
]

_NAMES = {
    "charts": "draw_coefficients draw_embedding draw_singular_values singular_values",
    "colours": "CLAY_COLOUR INK_COLOUR JOINT_RED Colouring SceneColours available_colourings part_colours "
    "segmentation_colours",
    "film": "FilmSettings film",
    "models": "VertexErrors add_error_bar draw_frame_errors draw_parts draw_parts_legend draw_vertex_errors "
    "plot_model vertex_errors",
    "page": "draw_mesh",
    "scene": "Camera Scene SceneItem View shared_limits three_quarter_view",
    "sheets": "contact_sheet draw_segmentation",
}

__getattr__ = lazy_getattr(
    __name__,
    {name: f"mixseq.pictures.{module}" for module, names in _NAMES.items() for name in names.split()},
)
