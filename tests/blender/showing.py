"""What Blender shows of files: python -m tests.blender.showing JOBS.json. Needs bpy.

A job opens a scene or imports a file into an empty one, goes through frames, and leaves two files: OUTPUT.npz with
points (and velocities) in the world and the camera's matrices, OUTPUT.json with names.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

STEP = 0.125
"""Frames between the matrices whose differences are an object's own motion."""


def main() -> None:
    for job in json.loads(Path(sys.argv[1]).read_text()):
        opened(**job["open"])
        frames = job["frames"]
        arrays, names = shown(frames if frames is not None else scene_frames())
        np.savez(f"{job['output']}.npz", **arrays)
        Path(f"{job['output']}.json").write_text(json.dumps(names))


def opened(file: str, fps: int, cache: str | None = None) -> None:
    """Open a file by its extension; modifiers of an imported Alembic file are then pointed at `cache`."""
    if file.endswith(".blend"):
        bpy.ops.wm.open_mainfile(filepath=file)
        return
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = fps
    if file.endswith(".abc"):
        bpy.ops.wm.alembic_import(filepath=file, as_background_job=False, always_add_cache_reader=True)
    elif file.endswith(".glb"):
        bpy.ops.import_scene.gltf(filepath=file, disable_bone_shape=True)
    else:
        bpy.ops.wm.usd_import(filepath=file)
    bpy.context.scene.render.fps = fps
    if cache:
        for each in bpy.data.cache_files:
            each.filepath = cache


def scene_frames() -> list[float]:
    scene = bpy.context.scene
    return list(range(scene.frame_start, scene.frame_end + 1))


def shown(frames: list[float]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return ``points/NAME`` and ``velocities/NAME`` (T, V, 3), ``camera`` (T, 4, 4); and names.

    Vertices of glTF that were split have ``vertices/NAME`` (V,), the vertices that they were.
    """
    scene = bpy.context.scene
    meshes = sorted((each for each in scene.objects if each.type == "MESH"), key=lambda each: each.name)
    cameras = [each for each in scene.objects if each.type == "CAMERA"]
    arrays: dict[str, list[Any]] = {}
    for frame in frames:
        moves = _rates(meshes, frame)
        graph = _at(frame)
        for each in meshes:
            seen = each.evaluated_get(graph)
            matrix = np.array(seen.matrix_world)
            mesh = seen.to_mesh()
            arrays.setdefault(f"points/{each.name}", []).append(
                _vectors(mesh.vertices, "co") @ matrix[:3, :3].T + matrix[:3, 3]
            )
            if "velocity" in mesh.attributes:
                own = _vectors(mesh.attributes["velocity"].data, "vector")
                moved = _vectors(mesh.vertices, "co") @ moves[each.name][:3, :3].T + moves[each.name][:3, 3]
                arrays.setdefault(f"velocities/{each.name}", []).append(own @ matrix[:3, :3].T + moved)
            seen.to_mesh_clear()
        for camera in cameras[:1]:
            arrays.setdefault("camera", []).append(np.array(camera.evaluated_get(graph).matrix_world))
    names = {
        "meshes": {each.name: _mesh_names(each) for each in meshes},
        "objects": sorted((_path(each), each.type) for each in scene.objects),
        "bones": [
            [bone.name, bone.parent.name if bone.parent else ""]
            for each in scene.objects
            if each.type == "ARMATURE"
            for bone in each.data.bones
        ],
        "lenses": [round(each.data.lens, 3) for each in cameras],
        "frame_start": scene.frame_start,
        "frame_end": scene.frame_end,
        "actions": [list(action.frame_range) for action in bpy.data.actions],
        "modifiers": [
            [each.name, modifier.type, getattr(modifier, "object_path", "")]
            for each in meshes
            for modifier in each.modifiers
        ],
    }
    for each in meshes:
        if "_VERTEX" in each.data.attributes:
            arrays[f"vertices/{each.name}"] = [one.value for one in each.data.attributes["_VERTEX"].data]
    return {name: np.array(values) for name, values in arrays.items()}, names


def _at(frame: float) -> bpy.types.Depsgraph:
    whole = int(frame // 1)
    bpy.context.scene.frame_set(whole, subframe=frame - whole)
    return bpy.context.evaluated_depsgraph_get()


def _rates(meshes: list[bpy.types.Object], frame: float) -> dict[str, np.ndarray]:
    """Return how fast the matrices of objects change, per second; velocities of points are in their object's space."""
    before, after = (
        {each.name: np.array(each.evaluated_get(graph).matrix_world) for each in meshes}
        for graph in (_at(frame + step) for step in (-STEP, STEP))
    )
    seconds = 2 * STEP / bpy.context.scene.render.fps
    return {name: (after[name] - matrix) / seconds for name, matrix in before.items()}


def _vectors(data: Any, field: str) -> np.ndarray:
    values = np.empty(3 * len(data), dtype=np.float32)
    data.foreach_get(field, values)
    return values.astype(np.float64).reshape(-1, 3)


def _path(thing: bpy.types.Object) -> str:
    above = f"{_path(thing.parent)}/" if thing.parent else "/"
    return f"{above}{thing.name}"


def _mesh_names(thing: bpy.types.Object) -> dict[str, Any]:
    mesh = thing.data
    used = [slot.material.name if slot.material else "" for slot in thing.material_slots]
    return {
        "path": _path(thing),
        "materials": [used[polygon.material_index] if used else "" for polygon in mesh.polygons],
        "corners": [list(polygon.vertices) for polygon in mesh.polygons],
        "uvs": {layer.name: [list(corner.uv) for corner in layer.data] for layer in mesh.uv_layers},
    }


if __name__ == "__main__":
    main()
