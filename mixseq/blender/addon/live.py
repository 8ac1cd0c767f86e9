"""Settings of meshes that models move, and the vertices, moved whenever Blender evaluates a frame or sub-frame.

Settings are stored in .blend files, with the names of Blender's cache file properties. Blender calls `_update_meshes`
with the scene and the dependency graph of the viewport or of a render. Renders evaluate sub-frames for motion blur.
Animated settings are read from the evaluated mesh, since only the viewport writes them back to the original mesh.
Setting the vertices of the original mesh then tags this mesh for evaluation.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from mixseq.blender.motion import DEFAULT_CACHE_BYTES, FrameCache, ModelCache, Motion, Placement, part_slices
from mixseq.errors import MixseqError, SettingsError
from mixseq.signals.model import Model
from mixseq_io.model_files import load

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


models = ModelCache(load)
frame_cache = FrameCache()

_mesh_states: dict[int, tuple[Any, ...]] = {}
"""Motion, time and part currently shown by each mesh, by session UID of the mesh."""

_error_messages: dict[int, str] = {}
"""Messages of errors that prevent the update of meshes, by session UID of the mesh."""

_relative_paths: dict[int, str] = {}
"""Original relative paths of models while a copy of the .blend file is saved, by session UID of the mesh."""

_is_rendering = False


def load_model(settings: MotionSettings) -> Model:
    """Return the model that moves a mesh, from the cache if possible."""
    return models.get(settings.path)


def is_driven(target: bpy.types.Object | None) -> bool:
    """Whether a model moves the mesh of an object."""
    return target is not None and target.type == "MESH" and target.data.mixseq.is_driven


def error_message(mesh: bpy.types.Mesh) -> str:
    """Return the message of the error that prevents the update of a mesh, or "" without an error."""
    return _error_messages.get(mesh.session_uid, "")


def format_error(error: Exception) -> str:
    """Return the message of an error, with the type of the error if it is a bug."""
    return str(error) if isinstance(error, MixseqError | RuntimeError) else f"{type(error).__name__}: {error}"


def scene_fps(scene: bpy.types.Scene) -> float:
    """Return the frames per second of a scene."""
    return float(scene.render.fps / scene.render.fps_base)


def update_mesh(mesh: bpy.types.Mesh, settings: MotionSettings, fps: float) -> None:
    """Move the vertices of a mesh to its model's points by evaluated settings; store an error for the panel."""
    message = ""
    try:
        _move_vertices(mesh, settings, fps)
    except Exception as error:
        message = format_error(error)
        _mesh_states.pop(mesh.session_uid, None)
        if message != error_message(mesh):
            print(f"mixseq: {mesh.name}: {message}")  # printed for renders without a user interface
    _error_messages[mesh.session_uid] = message


def _move_vertices(mesh: bpy.types.Mesh, settings: MotionSettings, fps: float) -> None:
    if mesh.shape_keys is not None:
        raise SettingsError("the mesh has shape keys, which override the model; delete them, or turn Live off")
    motion = Motion(load_model(mesh.mixseq), Placement(settings.up_axis, settings.scale))
    time = motion.clamp_time((settings.frame - settings.frame_offset) / fps)
    state = motion, time, settings.part
    if _mesh_states.get(mesh.session_uid) == state or mesh.is_editmode:
        return
    vertices, _ = part_slices(motion.model.header, settings.part)
    points = frame_cache.get((motion, time), lambda: motion.points(time))[vertices]
    if len(mesh.vertices) != len(points):
        raise SettingsError(
            f"the mesh has {len(mesh.vertices):,} vertices, the model {len(points):,}; undo applied modifiers and "
            "deleted vertices, or import the model again"
        )
    mesh.vertices.foreach_set("co", points.reshape(-1))  # the attribute "position" does not update the bounds
    mesh.update()
    _mesh_states[mesh.session_uid] = state


@persistent
def _update_meshes(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if _is_rendering and depsgraph.mode != "RENDER":
        return  # the viewport waits until the render is done
    frame_cache.max_bytes = max_cache_bytes()
    for mesh in bpy.data.meshes:
        evaluated = mesh.evaluated_get(depsgraph)
        if mesh.mixseq.is_driven and evaluated.is_evaluated:
            update_mesh(mesh, evaluated.mixseq, scene_fps(scene))


@persistent
def _begin_render(*_: Any) -> None:
    global _is_rendering
    _is_rendering = True


@persistent
def _end_render(*_: Any) -> None:
    global _is_rendering
    _is_rendering = False
    _reset()


@persistent
def _reset(*_: Any) -> None:
    """Clear the stored states of all meshes, and tag the driven meshes for evaluation."""
    _mesh_states.clear()
    _error_messages.clear()
    for mesh in bpy.data.meshes:
        if mesh.mixseq.is_driven:
            mesh.update_tag()


@persistent
def _remap_paths(filepath: str, *_: Any) -> None:
    """Make relative paths of models relative to the .blend file that is about to be saved."""
    _relative_paths.clear()
    for mesh in bpy.data.meshes:
        settings = mesh.mixseq
        if settings.filepath.startswith("//") and mesh.library is None:
            _relative_paths[mesh.session_uid] = settings.filepath
            settings.filepath = bpy.path.relpath(str(settings.path), start=str(Path(filepath).parent))


@persistent
def _restore_paths(filepath: str, *_: Any) -> None:
    """Restore the relative paths after a copy of the .blend file was saved."""
    if filepath == bpy.data.filepath:
        return
    for mesh in bpy.data.meshes:
        if mesh.session_uid in _relative_paths:
            mesh.mixseq.filepath = _relative_paths[mesh.session_uid]


_HANDLERS = {
    "frame_change_post": _update_meshes,
    "depsgraph_update_post": _update_meshes,
    "render_init": _begin_render,
    "render_complete": _end_render,
    "render_cancel": _end_render,
    "undo_post": _reset,
    "redo_post": _reset,
    "load_post": _reset,
    "save_pre": _remap_paths,
    "save_post": _restore_paths,
}


_register, _unregister = bpy.utils.register_classes_factory((MotionSettings, Preferences))


def register() -> None:
    """Add the settings to all meshes, and register the handlers."""
    _register()
    bpy.types.Mesh.mixseq = PointerProperty(type=MotionSettings)
    for event, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, event).append(handler)


def unregister() -> None:
    """Remove handlers and settings, whose values stay in .blend files, and free the memory of the caches."""
    for event, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, event).remove(handler)
    del bpy.types.Mesh.mixseq
    _unregister()
    frame_cache.clear()
    models.clear()
