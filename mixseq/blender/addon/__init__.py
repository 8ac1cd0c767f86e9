"""Blender add-on: deform meshes by mixseq models at every frame and sub-frame, retime and bake them.

`live` has the settings of a mesh and moves its vertices, `importing` makes meshes of models, `baking` retimes and bakes
them. This module is the user interface.
"""

from __future__ import annotations

from textwrap import wrap
from typing import Any

import bpy

from . import baking, importing, live


class MotionPanel(bpy.types.Panel):
    """Settings and operators of the model that moves a mesh, and its errors."""

    bl_idname = "MIXSEQ_PT_motion"
    bl_label = "mixseq Model"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "data"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Whether the properties editor shows a mesh."""
        return context.mesh is not None

    def draw(self, context: Any) -> None:
        """Draw the panel."""
        settings, layout = context.mesh.mixseq, self.layout
        layout.use_property_split = True
        layout.operator(importing.AttachModel.bl_idname, text="Open", icon="FILE_FOLDER")
        if not settings.filepath:
            return
        layout.prop(settings, "filepath")
        if message := live.error_message(context.mesh):
            _draw_warning(layout, message, context.region.width)
        layout.prop(settings, "is_live")
        column = layout.column()
        column.active = settings.is_live
        _draw_settings(column, settings)
        if not context.scene.render.use_lock_interface:
            _draw_warning(layout, "Turn on Render > Lock Interface before rendering", context.region.width)
        row = layout.row()
        row.operator(baking.BakeShapeKeys.bl_idname, text="Shape Keys")
        row.operator(baking.BakeAlembic.bl_idname, text="Alembic")


def _draw_settings(layout: Any, settings: Any) -> None:
    column = layout.column(align=True)
    column.prop(settings, "frame")
    column.prop(settings, "frame_offset")
    column.operator(baking.Retime.bl_idname)
    column = layout.column(align=True)
    column.prop(settings, "up_axis")
    column.prop(settings, "scale")
    if settings.part:
        column.prop(settings, "part")


def _draw_warning(layout: Any, text: str, width: int) -> None:
    column = layout.box().column(align=True)
    column.alert = True
    for number, line in enumerate(wrap(text, max(20, width // 8))):
        column.label(text=line, icon="NONE" if number else "ERROR")


_register, _unregister = bpy.utils.register_classes_factory((MotionPanel,))
_MODULES = (live, importing, baking)


def register() -> None:
    """Register all classes when Blender enables the add-on."""
    for module in _MODULES:
        module.register()
    _register()


def unregister() -> None:
    """Unregister all classes when Blender disables the add-on."""
    _unregister()
    for module in reversed(_MODULES):
        module.unregister()
