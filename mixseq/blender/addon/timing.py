"""The frame of a model that is shown: that of the scene, by a driver, or by keys after retiming.

Either makes the mesh animated data, without which Blender's exporters write one frame.
"""

from __future__ import annotations

from typing import Any

import bpy

from . import live

BLUR = "mixseq motion blur"
"""Name of the empty modifier for motion blur."""


def follow_scene(mesh: bpy.types.Mesh) -> None:
    """Drive a mesh by the frame of the scene; keys of an earlier model are kept."""
    animation = mesh.animation_data
    if animation is None or not (animation.action or animation.drivers or animation.nla_tracks):
        mesh.mixseq.driver_add("frame").driver.expression = "frame"


def let_blur(thing: bpy.types.Object) -> None:
    """Add an empty modifier to an object: renderers evaluate sub-frames of objects with modifiers only."""
    if BLUR not in thing.modifiers:
        nothing = thing.modifiers.new(BLUR, "SMOOTH")
        nothing.iterations = 0
        nothing.show_viewport = False


def linear(animated: bpy.types.ID) -> None:
    """Make all F-curves of a data-block linear."""
    for curve in _curves(animated):
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
        curve.update()
    animated.update_tag()


def _curves(animated: bpy.types.ID) -> Any:
    """Return the F-curves of a data-block; since Blender 4.4 it has a slot of an action that it may share."""
    animation = animated.animation_data
    slot = getattr(animation, "action_slot", None)
    if slot is None:
        return animation.action.fcurves
    return animation.action.layers[0].strips[0].channelbag(slot).fcurves


class Retime(bpy.types.Operator):
    """Replace the driver of Frame by an F-curve that plays the model as it is: edit that to retime it."""

    bl_idname = "mixseq.retime"
    bl_label = "Retime by F-Curve"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Return whether a model moves the active object."""
        thing = context.object
        return thing is not None and thing.type == "MESH" and thing.data.mixseq.moves

    def execute(self, context: Any) -> set[str]:
        """Key the first and the last frame."""
        mesh = context.object.data
        settings = mesh.mixseq
        try:
            model = live.model_of(settings)
        except Exception as error:
            self.report({"ERROR"}, live.in_words(error))
            return {"CANCELLED"}
        settings.driver_remove("frame")
        for time in (model.start, model.end):
            settings.frame = time * live.rate(context.scene) + settings.frame_offset
            settings.keyframe_insert("frame", frame=settings.frame)
        linear(mesh)
        context.view_layer.update()
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((Retime,))
