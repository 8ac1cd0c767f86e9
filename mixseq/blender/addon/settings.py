"""Settings of a mesh moved by a model, kept in .blend files and named as those of Blender's cache files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from mixseq.blender.motion import MEMORY

UP_AXES = [(axis, f"{axis} Up", f"{axis} points up in the model") for axis in "XYZ"]

_RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5) else set()
"""Option for paths that may begin with //, required by this version of Blender and later."""


def _changed(settings: MotionSettings, context: Any) -> None:
    settings.id_data.update_tag()  # makes Blender evaluate the mesh, which calls `live`


class MotionSettings(bpy.types.PropertyGroup):
    """Settings of a mesh, shared by linked duplicates: the model that moves it, and the frame that is shown."""

    filepath: StringProperty(
        name="Model",
        subtype="FILE_PATH",
        description="The mixseq model that moves this mesh",
        options=_RELATIVE,
        update=_changed,
    )
    part: StringProperty(
        name="Mesh", description="Which of the model's meshes this is; empty for all of it", update=_changed
    )
    is_live: BoolProperty(
        name="Live", default=True, description="Move the mesh at every frame", update=_changed
    )
    up_axis: EnumProperty(name="Up", items=UP_AXES, default="Y", update=_changed)
    scale: FloatProperty(
        name="Scale",
        default=1.0,
        min=1e-9,
        precision=4,
        description="Units per unit of the model",
        update=_changed,
    )
    frame: FloatProperty(
        name="Frame",
        description="Frame that is shown, at the scene's rate: driven by the scene's, keyed to retime the motion",
        update=_changed,
    )
    frame_offset: FloatProperty(
        name="Offset", description="Frame at which the model's time 0 is shown", update=_changed
    )

    @property
    def moves(self) -> bool:
        """Whether a model moves the mesh."""
        return bool(self.is_live and self.filepath)

    @property
    def path(self) -> Path:
        """Path of the model; of meshes linked from another .blend file, relative to that."""
        return Path(bpy.path.abspath(self.filepath, library=self.id_data.library))


class Preferences(bpy.types.AddonPreferences):
    """Preferences of the add-on: the memory for frames."""

    bl_idname = __package__

    megabytes: IntProperty(
        name="Memory for Frames (MB)",
        default=MEMORY >> 20,
        min=1,
        description="Decoded frames are kept up to this size, those used last",
    )

    def draw(self, context: Any) -> None:
        """Draw the preferences."""
        self.layout.prop(self, "megabytes")


def memory() -> int:
    """Return the largest number of bytes of cached frames."""
    addon = bpy.context.preferences.addons.get(__package__)
    return MEMORY if addon is None or addon.preferences is None else addon.preferences.megabytes << 20


_register, _unregister = bpy.utils.register_classes_factory((MotionSettings, Preferences))


def register() -> None:
    """Add the settings to all meshes."""
    _register()
    bpy.types.Mesh.mixseq = PointerProperty(type=MotionSettings)


def unregister() -> None:
    """Remove the settings; files keep their values."""
    del bpy.types.Mesh.mixseq
    _unregister()
