"""Move the vertices of meshes whenever Blender evaluates a frame or sub-frame.

Blender calls `_evaluated` with the scene at a frame and the dependency graph that evaluates it: that of the viewport,
or of a render, with sub-frames for motion blur. Animated settings are read from the evaluated mesh, as only the
viewport writes them back to the original one. The vertices of the original are moved, whose tag makes Blender evaluate
it again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from mixseq.blender.motion import Frames, Models, Motion, Placement, part_of, seconds
from mixseq.errors import MixseqError, SettingsError
from mixseq.signals.model import Model
from mixseq_io.loading import load

from .settings import MotionSettings, memory

models = Models(load)
frames = Frames()

_shown: dict[int, tuple[Any, ...]] = {}
"""State shown by every mesh, by its number in this session."""

_problems: dict[int, str] = {}
"""Error that stops a mesh, by its number."""

_paths: dict[int, str] = {}
"""Relative paths of models, while a file is saved elsewhere."""

_rendering = False


def model_of(settings: MotionSettings) -> Model:
    """Return the model that moves a mesh; raises a `MixseqError` if it cannot be read."""
    return models.get(settings.path)


def problem(mesh: bpy.types.Mesh) -> str:
    """Return the error that stops a mesh, "" for none."""
    return _problems.get(mesh.session_uid, "")


def in_words(error: Exception) -> str:
    """Return the message of an error, also of an unexpected one: Blender goes on."""
    return str(error) if isinstance(error, MixseqError | RuntimeError) else f"{type(error).__name__}: {error}"


def rate(scene: bpy.types.Scene) -> float:
    """Return the frames per second of a scene."""
    return float(scene.render.fps / scene.render.fps_base)


def show(mesh: bpy.types.Mesh, animated: MotionSettings, fps: float) -> None:
    """Move a mesh to the model's points, by evaluated settings; errors are shown in the panel."""
    try:
        _move(mesh, animated, fps)
        told = ""
    except Exception as error:
        told = in_words(error)
    if told:
        _shown.pop(mesh.session_uid, None)
        if told != problem(mesh):
            print(f"mixseq: {mesh.name}: {told}")  # one line, for renders without a panel
    _problems[mesh.session_uid] = told


def _move(mesh: bpy.types.Mesh, settings: MotionSettings, fps: float) -> None:
    if mesh.shape_keys is not None:
        raise SettingsError(
            "the mesh has shape keys, which would move it back; delete them, or switch Live off"
        )
    motion = Motion(model_of(mesh.mixseq), Placement(settings.up_axis, settings.scale))
    time = motion.held(seconds(settings.frame, settings.frame_offset, fps))
    shown = motion, time, settings.part
    if _shown.get(mesh.session_uid) == shown or mesh.is_editmode:
        return
    rows, _ = part_of(motion.model.header, settings.part)
    points = frames.get((motion, time), lambda: motion.points(time))[rows]
    if len(mesh.vertices) != len(points):
        raise SettingsError(
            f"the mesh has {len(mesh.vertices):,} vertices, the model {len(points):,}; apply no modifiers to it, and "
            "delete nothing of it"
        )
    # The attribute "position" would leave the bounds as they were.
    mesh.vertices.foreach_set("co", points.reshape(-1))
    mesh.update()
    _shown[mesh.session_uid] = shown


@persistent
def _evaluated(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if _rendering and depsgraph.mode != "RENDER":
        return  # the viewport waits until the render is done
    frames.memory = memory()
    for mesh in bpy.data.meshes:
        evaluated = mesh.evaluated_get(depsgraph)
        if mesh.mixseq.moves and evaluated.is_evaluated:
            show(mesh, evaluated.mixseq, rate(scene))


@persistent
def _begin_render(*_: Any) -> None:
    global _rendering
    _rendering = True


@persistent
def _end_render(*_: Any) -> None:
    global _rendering
    _rendering = False
    _look_again()


@persistent
def _look_again(*_: Any) -> None:
    """Clear the states of meshes, after undoing or opening a file, and have them evaluated."""
    _shown.clear()
    _problems.clear()
    for mesh in bpy.data.meshes:
        if mesh.mixseq.moves:
            mesh.update_tag()


@persistent
def _before_saving(filepath: str, *_: Any) -> None:
    """Change relative paths to reach the same models from the new place of the .blend file."""
    _paths.clear()
    for mesh in bpy.data.meshes:
        settings = mesh.mixseq
        if settings.filepath.startswith("//") and mesh.library is None:
            _paths[mesh.session_uid] = settings.filepath
            settings.filepath = bpy.path.relpath(str(settings.path), start=str(Path(filepath).parent))


@persistent
def _after_saving(filepath: str, *_: Any) -> None:
    """Restore the paths after a copy was saved."""
    if filepath == bpy.data.filepath:
        return
    for mesh in bpy.data.meshes:
        if mesh.session_uid in _paths:
            mesh.mixseq.filepath = _paths[mesh.session_uid]


_HANDLERS = {
    "frame_change_post": _evaluated,
    "depsgraph_update_post": _evaluated,
    "render_init": _begin_render,
    "render_complete": _end_render,
    "render_cancel": _end_render,
    "undo_post": _look_again,
    "redo_post": _look_again,
    "load_post": _look_again,
    "save_pre": _before_saving,
    "save_post": _after_saving,
}


def register() -> None:
    """Register the handlers."""
    for event, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, event).append(handler)


def unregister() -> None:
    """Remove the handlers, and free the memory."""
    for event, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, event).remove(handler)
    frames.clear()
    models.clear()
