"""Import models: as new objects, or onto an existing mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from mixseq.blender.motion import Placement, fitting, part_names, part_of
from mixseq.mesh.polygons import Polygons, matched
from mixseq.signals.model import Model

from . import live
from .making import new_mesh
from .timing import follow_scene, let_blur


class _ModelFile(ImportHelper):
    """Base of the operators that open a model."""

    bl_options = {"REGISTER", "UNDO"}
    filename_ext = ".h5"
    filter_glob: StringProperty(default="*.h5;*.hdf5;*.glb", options={"HIDDEN"})
    set_frame_range: BoolProperty(
        name="Set Frame Range", default=True, description="The scene begins and ends with the model"
    )

    def execute(self, context: Any) -> set[str]:
        """Run the operator; report an error as a message of Blender's."""
        try:
            model = live.models.get(Path(bpy.path.abspath(self.filepath)))
            self.bring(context, model)
        except Exception as error:
            self.report({"ERROR"}, live.in_words(error))
            return {"CANCELLED"}
        if self.set_frame_range:
            first, last = (round(time * live.rate(context.scene)) for time in (model.start, model.end))
            context.scene.frame_start, context.scene.frame_end = first, max(first, last)
        if not context.scene.render.use_lock_interface:
            context.scene.render.use_lock_interface = True
            self.report({"INFO"}, "Render > Lock Interface is on: meshes move while Blender renders")
        context.view_layer.update()
        return {"FINISHED"}

    def bring(self, context: Any, model: Model) -> None:
        """Import the model."""
        raise NotImplementedError

    def settle(self, thing: bpy.types.Object, part: str, placing: Placement) -> None:
        """Set the model that moves the mesh of an object."""
        settings = thing.data.mixseq
        settings.part, settings.up_axis, settings.scale = part, placing.up_axis, placing.scale
        settings.is_live = True
        settings.filepath = _kept_path(self.filepath)
        follow_scene(thing.data)
        let_blur(thing)


class ImportModel(bpy.types.Operator, _ModelFile):
    """Make an object of every mesh in a mixseq model, which moves it."""

    bl_idname = "mixseq.import_model"
    bl_label = "Import mixseq Model"

    def bring(self, context: Any, model: Model) -> None:
        """Make the objects, and select them."""
        bpy.ops.object.select_all(action="DESELECT")
        for part in part_names(model.header):
            mesh = new_mesh(model.header, part)
            made = bpy.data.objects.new(mesh.name, mesh)
            context.collection.objects.link(made)
            self.settle(made, part, Placement.from_header(model.header))
            made.select_set(True)
            context.view_layer.objects.active = made


class AttachModel(bpy.types.Operator, _ModelFile):
    """Have a mixseq model move the mesh of the active object, whose vertices are in the model's order."""

    bl_idname = "mixseq.attach_model"
    bl_label = "Open mixseq Model"

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Return whether there is a mesh."""
        thing = context.object
        return thing is not None and thing.type == "MESH" and thing.mode == "OBJECT"

    def bring(self, context: Any, model: Model) -> None:
        """Find which part of the model the mesh is, and its placing."""
        mesh = context.object.data
        points = np.empty((len(mesh.vertices), 3), dtype=np.float32)
        mesh.attributes["position"].data.foreach_get("vector", points.reshape(-1))
        part, placing = fitting(model, points.astype(np.float64))
        if not _has_polygons_of(mesh, model, part):
            text = "the mesh has other polygons than the model: where it bursts, its vertices are in another order"
            self.report({"WARNING"}, text)
        self.settle(context.object, part, placing)


class DropModel(bpy.types.FileHandler):
    """Models that are dropped into the viewport."""

    bl_idname = "MIXSEQ_FH_model"
    bl_label = "mixseq model"
    bl_import_operator = ImportModel.bl_idname
    bl_file_extensions = ".h5;.hdf5"

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        """Return whether models can be dropped there."""
        return context.area is not None and context.area.type == "VIEW_3D"


def _kept_path(path: str) -> str:
    """Return a path as Blender stores it: relative to the .blend file if there is one and users prefer that."""
    wanted = bpy.data.filepath and bpy.context.preferences.filepaths.use_relative_paths
    try:
        return str(bpy.path.relpath(path) if wanted else bpy.path.abspath(path))
    except ValueError:  # on another drive of Windows
        return path


def _has_polygons_of(mesh: bpy.types.Mesh, model: Model, part: str) -> bool:
    own = model.header.polygons
    rows, polygons = part_of(model.header, part)
    counts, corners = (np.empty(len(each), dtype=np.int32) for each in (mesh.polygons, mesh.loops))
    mesh.polygons.foreach_get("loop_total", counts)
    mesh.loops.foreach_get("vertex_index", corners)
    ends = np.concatenate([[0], np.cumsum(own.counts)])
    indices = own.indices[ends[polygons.start] : ends[polygons.stop]] - rows.start
    return matched(Polygons(own.counts[polygons], indices), Polygons(counts, corners)) is not None


def _menu(menu: Any, context: Any) -> None:
    menu.layout.operator(ImportModel.bl_idname, text="mixseq Model (.h5, .glb)")


_register, _unregister = bpy.utils.register_classes_factory((ImportModel, AttachModel, DropModel))


def register() -> None:
    """Register the operators, and an entry in File > Import."""
    _register()
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    """Unregister the operators."""
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    _unregister()
