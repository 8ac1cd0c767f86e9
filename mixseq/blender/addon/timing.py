"""Drive the displayed frame of a model by the scene's frame, or by an F-curve that retimes it.

A driver or keyframes are necessary, since Blender's exporters write only one frame of other meshes.
"""

from __future__ import annotations

from typing import Any

import bpy

from . import live

BLUR_MODIFIER_NAME = "mixseq motion blur"


def drive_by_scene(mesh: bpy.types.Mesh) -> None:
    """Drive the displayed frame by the scene's frame, unless the frame is already animated."""
    animation = mesh.animation_data
    if animation is None or not (animation.action or animation.drivers or animation.nla_tracks):
        mesh.mixseq.driver_add("frame").driver.expression = "frame"


def enable_motion_blur(target: bpy.types.Object) -> None:
    """Add a modifier without effect, because renderers evaluate sub-frames only for objects with modifiers."""
    if BLUR_MODIFIER_NAME not in target.modifiers:
        modifier = target.modifiers.new(BLUR_MODIFIER_NAME, "SMOOTH")
        modifier.iterations = 0
        modifier.show_viewport = False


def make_linear(animated: bpy.types.ID) -> None:
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
        make_linear(mesh)
        context.view_layer.update()
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((Retime,))
