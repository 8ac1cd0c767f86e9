"""Build the walker and export it: python -m scripts.benchmarks.blender.exporting FOLDER. Needs bpy."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

from scripts.benchmarks.blender.shot import RATES
from scripts.benchmarks.blender.walker import build


def main() -> None:
    folder = Path(sys.argv[1])
    for fps in RATES:
        build(fps)
        scene = bpy.context.scene
        scene.frame_set(scene.frame_start)
        stem = str(folder / f"walker{fps}")
        bpy.ops.wm.save_as_mainfile(filepath=f"{stem}.blend")
        bpy.ops.wm.usd_export(filepath=f"{stem}.usdc", export_animation=True)
        bpy.ops.wm.alembic_export(filepath=f"{stem}.abc", start=scene.frame_start, end=scene.frame_end, face_sets=True)
        bpy.ops.export_scene.gltf(
            filepath=f"{stem}.glb",
            export_cameras=True,
            export_lights=True,
            export_animation_mode="SCENE",
            export_anim_scene_split_object=False,  # camera and walker in one animation
        )


if __name__ == "__main__":
    main()
