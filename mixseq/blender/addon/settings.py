"""Properties of a mesh moved by a model, stored in .blend files, with the names of Blender's cache file properties."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from mixseq.blender.motion import DEFAULT_CACHE_BYTES

UP_AXES = [(axis, f"{axis} Up", f"{axis} points up in the model") for axis in "XYZ"]

_PATH_OPTIONS = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5) else set()
"""Option that allows paths relative to the .blend file, required since Blender 4.5."""


def _tag_mesh(settings: MotionSettings, context: Any) -> None:
    settings.id_data.update_tag()  # the tag makes Blender evaluate the mesh and call the handlers of `live`


class MotionSettings(bpy.types.PropertyGroup):
    """Properties of a mesh, shared by linked duplicates: its model, and the frame that it shows."""

    filepath: StringProperty(
        name="Model",
        subtype="FILE_PATH",
        description="The mixseq model that moves this mesh",
        options=_PATH_OPTIONS,
        update=_tag_mesh,
    )
    part: StringProperty(name="Mesh", description="Mesh of the model, empty for all", update=_tag_mesh)
    is_live: BoolProperty(name="Live", default=True, description="Update at every frame", update=_tag_mesh)
    up_axis: EnumProperty(name="Up", items=UP_AXES, default="Y", update=_tag_mesh)
    scale: FloatProperty(
        name="Scale",
        default=1.0,
        min=1e-9,
        precision=4,
        description="Blender units per unit of the model",
        update=_tag_mesh,
    )
    frame: FloatProperty(
        name="Frame",
        description="Displayed frame, at the scene's frame rate: driven by the scene, or animated to retime the motion",
        update=_tag_mesh,
    )
    frame_offset: FloatProperty(name="Offset", description="Scene frame of the model's time 0", update=_tag_mesh)

    @property
    def is_driven(self) -> bool:
        """Whether a model moves the mesh."""
        return bool(self.is_live and self.filepath)

    @property
    def path(self) -> Path:
        """Absolute path of the model; relative paths of linked meshes start at the linked .blend file."""
        return Path(bpy.path.abspath(self.filepath, library=self.id_data.library))


class Preferences(bpy.types.AddonPreferences):
    """Preferences of the add-on: the size of the frame cache."""

    bl_idname = __package__

    megabytes: IntProperty(
        name="Frame Cache (MB)",
        default=DEFAULT_CACHE_BYTES >> 20,
        min=1,
        description="Memory limit of decoded frames; the least recently used are freed first",
    )

    def draw(self, context: Any) -> None:
        """Draw the preferences."""
        self.layout.prop(self, "megabytes")


def max_cache_bytes() -> int:
    """Return the memory limit of the frame cache, in bytes."""
    addon = bpy.context.preferences.addons.get(__package__)
    return DEFAULT_CACHE_BYTES if addon is None or addon.preferences is None else addon.preferences.megabytes << 20


_register, _unregister = bpy.utils.register_classes_factory((MotionSettings, Preferences))


def register() -> None:
    """Add the properties to all meshes."""
    _register()
    bpy.types.Mesh.mixseq = PointerProperty(type=MotionSettings)


def unregister() -> None:
    """Remove the properties; .blend files keep their values."""
    del bpy.types.Mesh.mixseq
    _unregister()
