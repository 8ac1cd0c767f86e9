"""Pictures of mesh sequences, drawn in software with matplotlib (the extra ``plot``).

A mesh is one collection of shaded polygons sorted by depth, drawn without graphics card and global pyplot state. All
panels of a sheet share one camera and one set of limits, so that they can be compared.
"""

from mixseq.plots.charts import picture_format
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.error_pictures import (
    VertexErrors,
    add_error_bar,
    draw_frame_errors,
    draw_vertex_errors,
    vertex_errors,
)
from mixseq.plots.model_charts import draw_coefficients, draw_embedding, draw_singular_values, singular_values
from mixseq.plots.model_parts import draw_parts, draw_parts_legend
from mixseq.plots.models import check_settings, plot_model
from mixseq.plots.sheet_layout import DPI, Target
from mixseq.plots.sheets import contact_sheet
from mixseq.plots.two_sides import draw_segmentation
from mixseq.scene.camera import Limits, View, shared_limits, three_quarter_view
from mixseq.scene.palettes import CLAY, INK, JOINT_RED, part_colours, segmentation_colours

__all__ = [
    "CLAY",
    "DPI",
    "INK",
    "JOINT_RED",
    "Limits",
    "Target",
    "VertexErrors",
    "View",
    "add_error_bar",
    "check_settings",
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
    "part_colours",
    "picture_format",
    "plot_model",
    "segmentation_colours",
    "shared_limits",
    "singular_values",
    "three_quarter_view",
    "vertex_errors",
]
