"""Import models as new objects, or attach them to an existing mesh.

New meshes have polygons, UVs, colour attributes, materials and sharp edges. The scene's frame drives the frame that is
shown, as Blender's exporters write only one frame of meshes without a driver or keyframes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from mixseq.blender.motion import MeshParts, Placement, find_placement, part_names, part_slices
from mixseq.mesh.polygons import Polygons, match_polygons
from mixseq.sequence.header import SequenceHeader
from mixseq.signals.model import Model

from . import live

BLUR_MODIFIER_NAME = "mixseq motion blur"


class _ModelFile(ImportHelper):
    """Base class of operators that open a model and pass it to their method `import_model`."""

    bl_options = {"REGISTER", "UNDO"}
    filename_ext = ".h5"
    filter_glob: StringProperty(default="*.h5;*.hdf5;*.glb", options={"HIDDEN"})
    set_frame_range: BoolProperty(
        name="Set Frame Range", default=True, description="Set the scene's frame range to that of the model"
    )

    def execute(self, context: Any) -> set[str]:
        """Run the operator; report errors in Blender."""
        try:
            model = live.models.get(Path(bpy.path.abspath(self.filepath)))
            self.import_model(context, model)
        except Exception as error:
            self.report({"ERROR"}, live.format_error(error))
            return {"CANCELLED"}
        if self.set_frame_range:
            first, last = (round(time * live.scene_fps(context.scene)) for time in (model.start, model.end))
            context.scene.frame_start, context.scene.frame_end = first, max(first, last)
        if not context.scene.render.use_lock_interface:
            context.scene.render.use_lock_interface = True
            self.report({"INFO"}, "Turned on Render > Lock Interface: meshes change while Blender renders")
        context.view_layer.update()
        return {"FINISHED"}

    def set_model(self, target: bpy.types.Object, part: str, placement: Placement) -> None:
        """Set the model, part and placement that move the mesh of an object."""
        settings = target.data.mixseq
        settings.part, settings.up_axis, settings.scale = part, placement.up_axis, placement.scale
        settings.is_live = True
        settings.filepath = _stored_path(self.filepath)
        _drive_by_scene(target.data)
        _enable_motion_blur(target)


class ImportModel(bpy.types.Operator, _ModelFile):
    """Import a mixseq model as one object per mesh, updated at every frame."""

    bl_idname = "mixseq.import_model"
    bl_label = "Import mixseq Model"

    def import_model(self, context: Any, model: Model) -> None:
        """Create one object per mesh of the model, and select these objects."""
        bpy.ops.object.select_all(action="DESELECT")
        for part in part_names(model.header):
            mesh = _new_mesh(model.header, part)
            created = bpy.data.objects.new(mesh.name, mesh)
            context.collection.objects.link(created)
            self.set_model(created, part, Placement.from_header(model.header))
            created.select_set(True)
            context.view_layer.objects.active = created


class AttachModel(bpy.types.Operator, _ModelFile):
    """Move the mesh of the active object by a mixseq model with the same vertex order."""

    bl_idname = "mixseq.attach_model"
    bl_label = "Open mixseq Model"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Whether the active object is a mesh in object mode."""
        active = context.object
        return active is not None and active.type == "MESH" and active.mode == "OBJECT"

    def import_model(self, context: Any, model: Model) -> None:
        """Find the part and placement of the model that match the mesh, and let them move it."""
        mesh = context.object.data
        points = np.empty((len(mesh.vertices), 3), dtype=np.float32)
        mesh.attributes["position"].data.foreach_get("vector", points.reshape(-1))
        part, placement = find_placement(model, points.astype(np.float64))
        if not _has_same_polygons(mesh, model, part):
            text = "The polygons of the mesh differ from the model's: if the mesh explodes, its vertex order differs"
            self.report({"WARNING"}, text)
        self.set_model(context.object, part, placement)


class DropModel(bpy.types.FileHandler):
    """Import model files that are dropped into the 3D viewport."""

    bl_idname = "MIXSEQ_FH_model"
    bl_label = "mixseq model"
    bl_import_operator = ImportModel.bl_idname
    bl_file_extensions = ".h5;.hdf5"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        """Whether the mouse is over a 3D viewport."""
        return context.area is not None and context.area.type == "VIEW_3D"


def _new_mesh(header: SequenceHeader, part: str) -> bpy.types.Mesh:
    """Create the mesh of one part of a model, or of all parts for ""; `live` moves the vertices."""
    parts = MeshParts.from_header(header, part)
    vertices, _ = part_slices(header, part)
    mesh = bpy.data.meshes.new(part.rpartition("/")[2] or header.name)
    mesh.vertices.add(vertices.stop - vertices.start)
    mesh.loops.add(len(parts.corners))
    mesh.loops.foreach_set("vertex_index", parts.corners.astype(np.int32))
    mesh.polygons.add(len(parts.counts))
    mesh.polygons.foreach_set("loop_start", parts.starts.astype(np.int32))
    for name in parts.materials:
        mesh.materials.append(_material(name))
    mesh.polygons.foreach_set("material_index", parts.material_of_polygon.astype(np.int32))
    mesh.shade_smooth()
    mesh.update(calc_edges=True)
    if parts.uvs is not None:
        mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.ravel(parts.uvs).astype(np.float32))
    if parts.colours is not None:  # linear, like Blender's float colours
        attribute = mesh.color_attributes.new(name="Color", type="FLOAT_COLOR", domain="CORNER")
        attribute.data.foreach_set("color", np.ravel(parts.colours).astype(np.float32))
    _mark_sharp_edges(mesh, parts)
    mesh.validate(clean_customdata=False)  # removes polygons with a repeated vertex, which Blender forbids
    return mesh


def _material(name: str) -> bpy.types.Material | None:
    """Return the material with a name; create the material if it is missing."""
    return (bpy.data.materials.get(name) or bpy.data.materials.new(name)) if name else None


def _mark_sharp_edges(mesh: bpy.types.Mesh, parts: MeshParts) -> None:
    edge_of_corner = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("edge_index", edge_of_corner)
    is_sharp = parts.sharp_edges(edge_of_corner)
    if is_sharp.any():
        mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE").data.foreach_set("value", is_sharp)


def _drive_by_scene(mesh: bpy.types.Mesh) -> None:
    """Drive the displayed frame by the scene's frame, unless the frame is already animated."""
    animation = mesh.animation_data
    if animation is None or not (animation.action or animation.drivers or animation.nla_tracks):
        mesh.mixseq.driver_add("frame").driver.expression = "frame"


def _enable_motion_blur(target: bpy.types.Object) -> None:
    """Add a modifier without effect, because renderers evaluate sub-frames only for objects with modifiers."""
    if BLUR_MODIFIER_NAME not in target.modifiers:
        modifier = target.modifiers.new(BLUR_MODIFIER_NAME, "SMOOTH")
        modifier.iterations = 0
        modifier.show_viewport = False


def _stored_path(path: str) -> str:
    """Return a path in Blender's form: relative to the .blend file if the preferences request this."""
    is_relative = bpy.data.filepath and bpy.context.preferences.filepaths.use_relative_paths
    try:
        return str(bpy.path.relpath(path) if is_relative else bpy.path.abspath(path))
    except ValueError:  # the .blend file is on another drive of Windows
        return path


def _has_same_polygons(mesh: bpy.types.Mesh, model: Model, part: str) -> bool:
    """Whether a mesh has the polygons of a part of a model."""
    expected = MeshParts.from_header(model.header, part)
    counts, corners = (np.empty(len(elements), dtype=np.int32) for elements in (mesh.polygons, mesh.loops))
    mesh.polygons.foreach_get("loop_total", counts)
    mesh.loops.foreach_get("vertex_index", corners)
    return match_polygons(Polygons(expected.counts, expected.corners), Polygons(counts, corners)) is not None


def _add_menu_entry(menu: Any, context: Any) -> None:
    menu.layout.operator(ImportModel.bl_idname, text="mixseq Model (.h5, .glb)")


_register, _unregister = bpy.utils.register_classes_factory((ImportModel, AttachModel, DropModel))


def register() -> None:
    """Register the operators, and add one to the menu File > Import."""
    _register()
    bpy.types.TOPBAR_MT_file_import.append(_add_menu_entry)


def unregister() -> None:
    """Unregister the operators."""
    bpy.types.TOPBAR_MT_file_import.remove(_add_menu_entry)
    _unregister()
