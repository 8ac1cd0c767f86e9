"""Models live in Blender: install the extension, do with it what users do, and keep what was seen.

Run by its path, not as a module, so that mixseq comes out of the extension: python living.py FOLDER. FOLDER has
extension.zip and the models, and gets NAME.npz of every function that `TASKS` names. Needs bpy.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

Seen = dict[str, Any]

MOMENTS = (0.0, 0.25, 5.125, 11.5, 17.7, 22.9375)
"""Frames of the scene, at 24 per second."""

ADDON = "bl_ext.user_default.mixseq"


def several(folder: Path) -> Seen:
    """Two objects, of two models of which one begins later."""
    signals, compressed = (brought(folder / f"{name}.h5") for name in ("signals", "compressed"))
    compressed.data.mixseq.frame_offset = 3.0
    return {
        "moments": MOMENTS,
        "signals": [points_at(signals, moment) for moment in MOMENTS],
        "compressed": [points_at(compressed, moment) for moment in MOMENTS],
        "size": compressed.dimensions,
    }


def retimed(folder: Path) -> Seen:
    """A curve that eases in and out, and the same as a strip of half its speed that begins at frame 3."""
    thing = brought(folder / "compressed.h5")
    bpy.ops.mixseq.retime()
    animation = thing.data.animation_data
    action, slot = animation.action, animation.action_slot
    (curve,) = action.layers[0].strips[0].channelbag(slot).fcurves
    for key in curve.keyframe_points:
        key.interpolation = "BEZIER"
    curve.update()
    thing.data.update_tag()
    found: Seen = {"curve": [], "curve_frames": [], "strip": [], "strip_frames": [], "meant": []}
    for moment in MOMENTS:
        found["curve"].append(points_at(thing, moment))
        found["curve_frames"].append(thing.data.mixseq.frame)
    strip = animation.nla_tracks.new().strips.new("slow", 3, action)
    strip.action_slot, strip.scale = slot, 2.0
    animation.action = None
    for moment in MOMENTS[2:]:
        found["strip"].append(points_at(thing, moment))
        found["strip_frames"].append(thing.data.mixseq.frame)
        found["meant"].append(curve.evaluate((moment - 3) / 2))
    return found


def reopened(folder: Path) -> Seen:
    """A file that is saved, saved elsewhere, moved with its model, and opened again."""
    project = folder / "project"
    (project / "scenes" / "old").mkdir(parents=True)
    shutil.copy(folder / "signals.h5", project / "walk.h5")
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "scenes" / "shot.blend"))
    name = brought(project / "walk.h5").name
    path = bpy.data.objects[name].data.mixseq.filepath
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "scenes" / "old" / "shot.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=ADDON)
    project.rename(folder / "moved")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "moved" / "scenes" / "old" / "shot.blend"))
    thing = bpy.data.objects[name]
    paths = [path, thing.data.mixseq.filepath]
    return {"moments": MOMENTS, "points": [points_at(thing, moment) for moment in MOMENTS], "paths": paths}


def baked(folder: Path) -> Seen:
    """The same motion as Alembic, with a modifier that reads it, and as shape keys; two samples per frame."""
    moments = np.arange(0, 8.5, 0.5).tolist()
    thing = brought(folder / "compressed.h5")
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 0, 8
    found: Seen = {"moments": moments}
    bpy.ops.mixseq.bake_alembic(filepath=str(folder / "baked.abc"), samples=2)
    found["alembic"] = [points_at(thing, moment) for moment in moments]
    thing.modifiers.clear()
    thing.data.mixseq.is_live = True
    bpy.ops.mixseq.bake_shape_keys(samples=2)
    found["keys"] = [points_at(thing, moment) for moment in moments]
    return found


def rendered(folder: Path) -> Seen:
    """What Cycles sees of a shutter that is open for a frame, and the vectors that it finds for a compositor."""
    thing = brought(folder / "slide.h5")
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 4.0, (0, 0, 5)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 1, "CPU"
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    thing.cycles.motion_steps = 2
    found: Seen = {"steps": [], "step_frames": []}

    def look(scene: Any, depsgraph: Any) -> None:
        if depsgraph.mode == "RENDER":
            found["steps"].append(points(thing))  # which Blender evaluates when all handlers have run
            found["step_frames"].append(scene.frame_current_final)

    bpy.app.handlers.depsgraph_update_post.append(look)
    bpy.app.handlers.frame_change_post.append(look)
    scene.frame_set(9)
    scene.render.filepath = str(folder / "blurred.png")
    bpy.ops.render.render(write_still=True)
    bpy.app.handlers.depsgraph_update_post.remove(look)
    bpy.app.handlers.frame_change_post.remove(look)
    scene.render.use_motion_blur = False
    scene.view_layers[0].use_pass_vector = True
    found["vectors"] = _vectors(scene, folder / "vectors.exr")
    found["after"] = [points(thing.evaluated_get(bpy.context.evaluated_depsgraph_get()))]
    return found


def coloured(folder: Path) -> Seen:
    """Colours of corners: of a model, before and after its scene is saved and opened again, and of glTF and USD."""
    name = brought(folder / "slide.h5").name
    found: Seen = {"model": _colours(bpy.data.objects[name])}
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "coloured.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(folder / "coloured.blend"))
    found["opened"] = _colours(bpy.data.objects[name])
    for file, bring in (("glb", bpy.ops.import_scene.gltf), ("usdc", bpy.ops.wm.usd_import)):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bring(filepath=str(folder / f"slide.{file}"))
        (thing,) = (each for each in bpy.data.objects if each.type == "MESH")
        found[file] = _colours(thing)
    return found


def _colours(thing: Any) -> list[list[float]]:
    """Return red, green, blue and alpha of all corners, of the attribute that Blender shows."""
    return [list(corner.color) for corner in thing.data.color_attributes.active_color.data]


def _vectors(scene: Any, path: Path) -> Any:
    """Return the vector pass ``(height, width, 4)`` in pixels."""
    bpy.utils.expose_bundled_modules()
    import OpenImageIO as Images

    if hasattr(scene.render.image_settings, "media_type"):  # since Blender 5.0
        scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    for part in range(Images.ImageBuf(str(path)).nsubimages):  # since Blender 5.0 every pass is one
        image = Images.ImageBuf(str(path), part, 0)
        names = list(image.spec().channelnames)
        if "ViewLayer.Vector.X" in names:
            pixels = np.asarray(image.get_pixels(Images.FLOAT))
            return pixels[..., [names.index(f"ViewLayer.Vector.{letter}") for letter in "XYZW"]]
    raise SystemExit(f"{path} has no vectors")


def scrubbed(folder: Path) -> Seen:
    """A large cache, at moments in no order: frames per second of processor time, first not kept and then kept."""
    if not (folder / "large.h5").exists():
        return {}
    thing = brought(folder / "large.h5")
    end = bpy.context.scene.frame_end
    moments = np.random.default_rng(1).permutation(np.arange(0, end, 0.25)).tolist()
    points_at(thing, 0.1)  # the first one compiles and prepares
    rates = []
    for _ in range(2):
        began = time.process_time()
        for moment in moments:
            go(moment)
        rates.append(len(moments) / (time.process_time() - began))
    return {"rates": rates, "vertices": len(thing.data.vertices), "frames": len(moments)}


def told(folder: Path) -> Seen:
    """What users are told of models that are missing, damaged, or do not fit."""
    thing = brought(folder / "compressed.h5")
    settings, found = thing.data.mixseq, []
    (folder / "damaged.h5").write_bytes((folder / "signals.h5").read_bytes()[:4000])
    for name in ("missing.h5", "damaged.h5", "slide.h5", "compressed.h5"):
        settings.filepath = str(folder / name)
        go(2)
        found.append(sys.modules[f"{ADDON}.live"].error_message(thing.data))
    return {"messages": found}


TASKS: tuple[Callable[[Path], Seen], ...] = (several, retimed, reopened, baked, coloured, rendered, told, scrubbed)


def brought(path: Path) -> Any:
    """Import a model, and return its object."""
    bpy.ops.mixseq.import_model(filepath=str(path))
    return bpy.context.object


def go(moment: float) -> None:
    """Go to a frame, which may be between two."""
    bpy.context.scene.frame_set(int(moment // 1), subframe=moment % 1)


def points_at(thing: Any, moment: float) -> Any:
    """Return the vertices ``(V, 3)`` of an object at a frame, as Blender evaluates it."""
    go(moment)
    return points(thing.evaluated_get(bpy.context.evaluated_depsgraph_get()))


def points(thing: Any) -> Any:
    """Return the vertices ``(V, 3)`` of an object."""
    mesh = thing.data
    found = np.empty((len(mesh.vertices), 3), dtype=np.float32)
    mesh.attributes["position"].data.foreach_get("vector", found.reshape(-1))
    return found


def main() -> None:
    folder = Path(sys.argv[1])
    bpy.ops.preferences.addon_enable(module="bl_pkg")
    archive = str(folder / "extension.zip")
    bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
    for task in TASKS:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.preferences.addon_enable(module=ADDON)
        np.savez(folder / f"{task.__name__}.npz", **task(folder))


if __name__ == "__main__":
    main()
