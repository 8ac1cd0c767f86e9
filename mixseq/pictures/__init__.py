"""Draw pictures and films of mesh sequences in software; pictures need matplotlib (the extra ``plot``).

`scene` defines meshes, frame times and cameras; `colours` defines colourings. `raster` draws meshes; `charts`, `models`
and `sheets` arrange pages with matplotlib. `film` draws films, and `film_encoding` writes them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixseq.runtime.lazy import lazy_getattr

if TYPE_CHECKING:
    from mixseq.pictures.charts import draw_coefficients, draw_embedding, draw_singular_values
    from mixseq.pictures.models import draw_frame_errors, draw_parts, draw_vertex_errors, plot_model
    from mixseq.pictures.raster import draw_mesh
    from mixseq.pictures.scene import shared_limits, three_quarter_view
    from mixseq.pictures.sheets import contact_sheet, draw_segmentation

__all__ = [
    "contact_sheet",
    "draw_coefficients",
    "draw_embedding",
    "draw_frame_errors",
    "draw_mesh",
    "draw_parts",
    "draw_segmentation",
    "draw_singular_values",
    "draw_vertex_errors",
    "plot_model",
    "shared_limits",
    "three_quarter_view",
]

_NAMES = {
    "charts": "draw_coefficients draw_embedding draw_singular_values",
    "models": "draw_frame_errors draw_parts draw_vertex_errors plot_model",
    "raster": "draw_mesh",
    "scene": "shared_limits three_quarter_view",
    "sheets": "contact_sheet draw_segmentation",
}

__getattr__ = lazy_getattr(
    __name__, {name: f"mixseq.pictures.{module}" for module, names in _NAMES.items() for name in names.split()}
)
