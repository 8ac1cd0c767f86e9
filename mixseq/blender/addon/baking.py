"""Retime models by F-curves; bake the scene's frames to shape keys or Alembic, which play without add-on and model."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy
import numpy as np
from bpy.props import IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from mixseq.errors import SettingsError
from mixseq.types import Single

from . import live
from .importing import BLUR_MODIFIER_NAME


class Retime(bpy.types.Operator):
    """Replace the driver of Frame by an F-curve at the original speed; edit the curve to retime the model."""

    bl_idname = "mixseq.retime"
    bl_label = "Retime by F-Curve"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Whether a model moves the active object."""
        return live.is_driven(context.object)

    def execute(self, context: Any) -> set[str]:
        """Insert keyframes at the first and the last frame of the model."""
        mesh = context.object.data
        settings = mesh.mixseq
        try:
            model = live.load_model(settings)
        except Exception as error:
            self.report({"ERROR"}, live.format_error(error))
            return {"CANCELLED"}
        settings.driver_remove("frame")
        for time in (model.start, model.end):
            settings.frame = time * live.scene_fps(context.scene) + settings.frame_offset
            settings.keyframe_insert("frame", frame=settings.frame)
        _make_linear(mesh)
        context.view_layer.update()
        return {"FINISHED"}


class _Bake:
    """Base class of operators that bake the scene's frames and then turn off Live."""

    bl_options = {"REGISTER", "UNDO"}
    report: Any
    samples: IntProperty(name="Samples", default=1, min=1, max=64, description="Samples per frame, for motion blur")

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Whether a model moves the active object and this object is in object mode."""
        return live.is_driven(context.object) and context.object.mode == "OBJECT"

    def execute(self, context: Any) -> set[str]:
        """Run the operator; report errors in Blender."""
        mesh = context.object.data
        try:
            with _keep_frame(context.scene):
                self.bake(context)
        except Exception as error:
            self.report({"ERROR"}, live.format_error(error))
            return {"CANCELLED"}
        mesh.mixseq.is_live = False
        context.view_layer.update()
        return {"FINISHED"}

    def bake(self, context: Any) -> None:
        """Bake the active object."""
        raise NotImplementedError


class BakeShapeKeys(_Bake, bpy.types.Operator):
    """Bake every frame of the scene to an absolute shape key, animated by the evaluation time."""

    bl_idname = "mixseq.bake_shape_keys"
    bl_label = "Bake to Shape Keys"

    def bake(self, context: Any) -> None:
        """Add one absolute shape key per sample, and an F-curve of the evaluation time."""
        scene, active = context.scene, context.object
        count = (scene.frame_end - scene.frame_start) * self.samples + 1
        frames = scene.frame_start + np.arange(count) / self.samples
        poses = [_evaluate_pose(scene, active.data, frame) for frame in frames.tolist()]
        for frame, pose in zip(frames.tolist(), poses, strict=True):
            key = active.shape_key_add(name=f"{frame:g}", from_mix=False)
            key.data.foreach_set("co", pose.reshape(-1))
            key.interpolation = "KEY_LINEAR"
        keys = active.data.shape_keys
        keys.use_relative = False
        for frame, block in ((frames[0], keys.key_blocks[0]), (frames[-1], keys.key_blocks[-1])):
            keys.eval_time = block.frame
            keys.keyframe_insert("eval_time", frame=frame)
        _make_linear(keys)


class BakeAlembic(_Bake, bpy.types.Operator, ExportHelper):
    """Bake the mesh, without its modifiers, to an Alembic file, and play that file."""

    bl_idname = "mixseq.bake_alembic"
    bl_label = "Bake to Alembic"
    filename_ext = ".abc"
    filter_glob: StringProperty(default="*.abc", options={"HIDDEN"})

    def bake(self, context: Any) -> None:
        """Export a temporary object with the mesh, and add a Mesh Sequence Cache modifier to the active object."""
        active, scene = context.object, context.scene
        _evaluate_pose(scene, active.data, scene.frame_start)  # errors occur here, before a file is written
        with _temporary_object(context, active.data) as exported:
            bpy.ops.wm.alembic_export(
                filepath=self.filepath,
                start=scene.frame_start,
                end=scene.frame_end,
                gsamples=self.samples,
                selected=True,
                face_sets=True,
                as_background_job=False,
            )
            object_path = "".join("/" + re.sub("[ .:]", "_", block.name) for block in (exported, active.data))
        bpy.ops.cachefile.open(filepath=self.filepath)
        modifier = active.modifiers.new("mixseq", "MESH_SEQUENCE_CACHE")
        modifier.cache_file = bpy.data.cache_files[-1]
        modifier.object_path = object_path
        active.modifiers.move(len(active.modifiers) - 1, 0)
        if BLUR_MODIFIER_NAME in active.modifiers:
            active.modifiers.remove(active.modifiers[BLUR_MODIFIER_NAME])


def _make_linear(animated: bpy.types.ID) -> None:
    """Set all keyframes of a data-block to linear interpolation."""
    for curve in _fcurves(animated):
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
        curve.update()
    animated.update_tag()


def _fcurves(animated: bpy.types.ID) -> Any:
    """Return the F-curves of a data-block; since Blender 4.4 they belong to its slot in the action."""
    animation = animated.animation_data
    slot = getattr(animation, "action_slot", None)
    if slot is None:
        return animation.action.fcurves
    return animation.action.layers[0].strips[0].channelbag(slot).fcurves


def _evaluate_pose(scene: bpy.types.Scene, mesh: bpy.types.Mesh, frame: float) -> Single:
    """Return the vertices ``(V, 3)`` of a mesh at a frame or sub-frame of the scene, in Blender's axes."""
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    if message := live.error_message(mesh):
        raise SettingsError(message)
    pose = np.empty((len(mesh.vertices), 3), dtype=np.float32)
    mesh.attributes["position"].data.foreach_get("vector", pose.reshape(-1))
    return pose


@contextmanager
def _keep_frame(scene: bpy.types.Scene) -> Iterator[None]:
    """Restore the scene's frame after the block."""
    frame, subframe = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=subframe)


@contextmanager
def _temporary_object(context: Any, mesh: bpy.types.Mesh) -> Iterator[bpy.types.Object]:
    """Yield a temporary object with a mesh as the only selected object; restore the selection afterwards."""
    selection, active = context.selected_objects, context.object
    temporary = bpy.data.objects.new(f"{active.name}_baked", mesh)
    context.scene.collection.objects.link(temporary)
    bpy.ops.object.select_all(action="DESELECT")
    temporary.select_set(True)
    try:
        yield temporary
    finally:
        bpy.data.objects.remove(temporary)
        for item in selection:
            item.select_set(True)
        context.view_layer.objects.active = active


register, unregister = bpy.utils.register_classes_factory((Retime, BakeShapeKeys, BakeAlembic))
