"""Baking: the scene's frames as shape keys or as Alembic, which play without the add-on or the model."""

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
from .timing import BLUR, linear


class _Bake:
    """Base of the operators: read the scene's frames, and stop the live motion of the mesh."""

    bl_options = {"REGISTER", "UNDO"}
    report: Any
    samples: IntProperty(
        name="Samples",
        default=1,
        min=1,
        max=64,
        description="Per frame; motion blur sees those between frames",
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Return whether a model moves the active object."""
        thing = context.object
        return (
            thing is not None and thing.type == "MESH" and thing.data.mixseq.moves and thing.mode == "OBJECT"
        )

    def execute(self, context: Any) -> set[str]:
        """Run the operator; report an error as a message of Blender's."""
        mesh = context.object.data
        try:
            with _frame_kept(context.scene):
                self.bake(context)
        except Exception as error:
            self.report({"ERROR"}, live.in_words(error))
            return {"CANCELLED"}
        mesh.mixseq.is_live = False
        context.view_layer.update()
        return {"FINISHED"}

    def bake(self, context: Any) -> None:
        """Bake the active object."""
        raise NotImplementedError


class BakeShapeKeys(_Bake, bpy.types.Operator):
    """Make a shape key of every frame of the scene, played by the evaluation time of the keys."""

    bl_idname = "mixseq.bake_shape_keys"
    bl_label = "Bake to Shape Keys"

    def bake(self, context: Any) -> None:
        """Add one absolute key per frame, and one F-curve for all of them."""
        scene, thing = context.scene, context.object
        count = (scene.frame_end - scene.frame_start) * self.samples + 1
        moments = scene.frame_start + np.arange(count) / self.samples
        poses = [_pose(scene, thing.data, moment) for moment in moments.tolist()]
        for moment, pose in zip(moments.tolist(), poses, strict=True):
            key = thing.shape_key_add(name=f"{moment:g}", from_mix=False)
            key.data.foreach_set("co", pose.reshape(-1))
            key.interpolation = "KEY_LINEAR"
        keys = thing.data.shape_keys
        keys.use_relative = False
        for moment, block in ((moments[0], keys.key_blocks[0]), (moments[-1], keys.key_blocks[-1])):
            keys.eval_time = block.frame
            keys.keyframe_insert("eval_time", frame=moment)
        linear(keys)


class BakeAlembic(_Bake, bpy.types.Operator, ExportHelper):
    """Write the mesh, before its modifiers, into an Alembic file, which then moves it."""

    bl_idname = "mixseq.bake_alembic"
    bl_label = "Bake to Alembic"
    filename_ext = ".abc"
    filter_glob: StringProperty(default="*.abc", options={"HIDDEN"})

    def bake(self, context: Any) -> None:
        """Export an object with only the mesh, and add a modifier that reads it to the original."""
        thing, scene = context.object, context.scene
        _pose(scene, thing.data, scene.frame_start)  # raises errors before a file is written
        with _alone(context, thing.data) as bare:
            bpy.ops.wm.alembic_export(
                filepath=self.filepath,
                start=scene.frame_start,
                end=scene.frame_end,
                gsamples=self.samples,
                selected=True,
                face_sets=True,
                as_background_job=False,
            )
            inside = "".join("/" + re.sub("[ .:]", "_", each.name) for each in (bare, thing.data))
        bpy.ops.cachefile.open(filepath=self.filepath)
        modifier = thing.modifiers.new("mixseq", "MESH_SEQUENCE_CACHE")
        modifier.cache_file = bpy.data.cache_files[-1]
        modifier.object_path = inside
        thing.modifiers.move(len(thing.modifiers) - 1, 0)
        if BLUR in thing.modifiers:
            thing.modifiers.remove(thing.modifiers[BLUR])


def _pose(scene: bpy.types.Scene, mesh: bpy.types.Mesh, moment: float) -> Single:
    """Return the vertices ``(V, 3)`` at a frame of the scene, in Blender's axes."""
    scene.frame_set(int(moment // 1), subframe=moment % 1)
    if told := live.problem(mesh):
        raise SettingsError(told)
    pose = np.empty((len(mesh.vertices), 3), dtype=np.float32)
    mesh.attributes["position"].data.foreach_get("vector", pose.reshape(-1))
    return pose


@contextmanager
def _frame_kept(scene: bpy.types.Scene) -> Iterator[None]:
    frame, part = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=part)


@contextmanager
def _alone(context: Any, mesh: bpy.types.Mesh) -> Iterator[bpy.types.Object]:
    """Yield a new object of a mesh, the only one selected."""
    selected, active = context.selected_objects, context.object
    bare = bpy.data.objects.new(f"{active.name}_baked", mesh)
    context.scene.collection.objects.link(bare)
    bpy.ops.object.select_all(action="DESELECT")
    bare.select_set(True)
    try:
        yield bare
    finally:
        bpy.data.objects.remove(bare)
        for each in selected:
            each.select_set(True)
        context.view_layer.objects.active = active


register, unregister = bpy.utils.register_classes_factory((BakeShapeKeys, BakeAlembic))
