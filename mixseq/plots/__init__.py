"""Pictures of mesh sequences, drawn in software with matplotlib (the extra ``plot``).

A mesh is one collection of shaded polygons, sorted by depth: no graphics card, no global pyplot state. All
panels of a sheet share one camera and one set of limits, so that they can be compared.
"""

from mixseq.plots.camera import Limits, View, broadside, shared_limits
from mixseq.plots.colours import CLAY, INK, JOINT_RED, part_colours, segmentation_colours
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.layout import DPI, Target
from mixseq.plots.sheets import contact_sheet
from mixseq.plots.two_sides import draw_segmentation

__all__ = [
    "CLAY",
    "DPI",
    "INK",
    "JOINT_RED",
    "Limits",
    "Target",
    "View",
    "broadside",
    "contact_sheet",
    "draw_mesh",
    "draw_segmentation",
    "part_colours",
    "segmentation_colours",
    "shared_limits",
]
