"""Build a rigged walker with a sword, hair, a camera and a light, and export it: walker FOLDER. Needs bpy."""

from __future__ import annotations

import sys
from math import radians
from pathlib import Path

import bpy
from bpy_extras.anim_utils import action_get_channelbag_for_slot
from mathutils import Euler, Matrix, Vector

from tests.blender import gait
from tests.blender.gait import BASE, FIRST, LAST, RATES

KEYS = 8
"""Poses that are keyed in a stride: contact, down, passing, up, of both feet."""

BONES = {
    "hips": (None, (0, 0, 0.92), (0, 0, 1.08)),
    "spine": ("hips", (0, 0, 1.08), (0, 0, 1.46)),
    "head": ("spine", (0, 0, 1.46), (0, 0, 1.76)),
    "thigh.left": ("hips", (0.10, 0, 0.90), (0.11, -0.01, 0.49)),
    "shin.left": ("thigh.left", (0.11, -0.01, 0.49), (0.12, 0.02, 0.09)),
    "foot.left": ("shin.left", (0.12, 0.02, 0.09), (0.13, -0.17, 0.03)),
    "arm.left": ("spine", (0.19, 0, 1.40), (0.40, 0.02, 1.19)),
    "forearm.left": ("arm.left", (0.40, 0.02, 1.19), (0.62, -0.02, 0.98)),
}
"""Parent, head and tail, in metres; the right side is its mirror image."""

THICKNESS = {
    "hips": 0.13,
    "spine": 0.13,
    "head": 0.10,
    "thigh": 0.075,
    "shin": 0.05,
    "foot": 0.045,
    "arm": 0.05,
    "forearm": 0.04,
}


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


def build(fps: int) -> None:
    """Make the scene from nothing; the same motion, whatever the frames per second."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = fps
    scene.frame_start, scene.frame_end = FIRST * fps // BASE, LAST * fps // BASE
    rig = _armature()
    body = _body(rig)
    _hang(_sword(), rig, "forearm.right", Matrix.Translation(Vector((-0.64, -0.02, 0.96))))
    _hang(_hair(), rig, "head", Matrix.Identity(4))
    _clothe(body)
    _animate(rig, fps)
    _camera(fps)
    lamp = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    lamp.rotation_euler = (radians(40), radians(10), 0)
    scene.collection.objects.link(lamp)


def _sides() -> dict[str, tuple[str | None, Vector, Vector]]:
    bones = {}
    for name, (parent, head, tail) in BONES.items():
        bones[name] = (parent, Vector(head), Vector(tail))
        if name.endswith(".left"):
            other = (parent or "").replace(".left", ".right")
            mirrored = [Vector((-place[0], *place[1:])) for place in (head, tail)]
            bones[name.replace(".left", ".right")] = (other, *mirrored)
    return bones


def _armature() -> bpy.types.Object:
    rig = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for name, (parent, head, tail) in _sides().items():
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail = head, tail
        bone.parent = rig.data.edit_bones[parent] if parent else None
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


def _body(rig: bpy.types.Object) -> bpy.types.Object:
    """Return one closed mesh of quads around the bones, bound to them as Blender weighs them."""
    places: list[Vector] = []
    sizes: list[float] = []
    edges: list[tuple[int, int]] = []
    ends: dict[str, int] = {}

    def vertex(place: Vector, size: float) -> int:
        places.append(place)
        sizes.append(size)
        return len(places) - 1

    for name, (parent, head, tail) in _sides().items():
        size = THICKNESS[name.partition(".")[0]]
        start = vertex(head, size) if parent is None or (head - places[ends[parent]]).length > 1e-6 else ends[parent]
        if parent and start != ends[parent]:
            edges.append((ends[parent] if name.startswith("arm") else 0, start))
        ends[name] = vertex(tail, 0.8 * size)
        edges.append((start, ends[name]))
    mesh = bpy.data.meshes.new("body")
    mesh.from_pydata(places, edges, [])
    body = bpy.data.objects.new("body", mesh)
    bpy.context.scene.collection.objects.link(body)
    bpy.context.view_layer.objects.active = body
    body.select_set(True)
    body.modifiers.new("skin", "SKIN").use_smooth_shade = True
    for each, size in zip(mesh.skin_vertices[0].data, sizes, strict=True):
        each.radius = (size, size)
    mesh.skin_vertices[0].data[0].use_root = True
    body.modifiers.new("smooth", "SUBSURF").levels = 2
    for name in ("skin", "smooth"):
        bpy.ops.object.modifier_apply(modifier=name)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.delete_loose()
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.objects.active = rig
    rig.select_set(True)
    bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    bpy.context.view_layer.objects.active = body
    bpy.ops.object.vertex_group_limit_total(limit=4)  # as many as glTF takes
    bpy.ops.object.vertex_group_normalize_all(lock_active=False)
    return body


def _sword() -> bpy.types.Object:
    corners = [(x, y, z) for y in (-0.9, -0.1) for x in (-0.02, 0.02) for z in (-0.006, 0.006)]
    hilt = [(x, y, z) for y in (-0.1, 0.1) for x in (-0.05, 0.05) for z in (-0.02, 0.02)]
    box = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new("sword")
    mesh.from_pydata(corners + hilt, [], box + [tuple(8 + corner for corner in face) for face in box])
    mesh.materials.append(_material("steel", (0.6, 0.62, 0.7)))
    uvs = mesh.uv_layers.new(name="UVMap")
    for number, corner in enumerate(uvs.data):
        corner.uv = ((number % 4 in (1, 2)) / 2, (number % 4 in (2, 3)) / 2)
    return bpy.data.objects.new("sword", mesh)


def _hair() -> bpy.types.Object:
    hair = bpy.data.hair_curves.new("hair")
    hair.add_curves(12 * [4])
    for number, point in enumerate(hair.points):
        strand, along = divmod(number, 4)
        point.position = Vector((0.01 * (strand - 5.5), 0.05 + 0.04 * along, 1.8 - 0.08 * along))
    return bpy.data.objects.new("hair", hair)


def _hang(thing: bpy.types.Object, rig: bpy.types.Object, bone: str, place: Matrix) -> None:
    """Parent an object to a bone, at its place in the world when the rig is at rest."""
    bpy.context.scene.collection.objects.link(thing)
    thing.parent, thing.parent_type, thing.parent_bone = rig, "BONE", bone
    own = rig.data.bones[bone]
    thing.matrix_parent_inverse = (own.matrix_local @ Matrix.Translation((0, own.length, 0))).inverted() @ place


def _material(name: str, colour: tuple[float, float, float]) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*colour, 1)
    return material


def _clothe(body: bpy.types.Object) -> None:
    """Give the body texture coordinates, and two materials: skin, and cloth below the chest."""
    for name, colour in (("skin", (0.8, 0.5, 0.4)), ("cloth", (0.1, 0.2, 0.5))):
        body.data.materials.append(_material(name, colour))
    for polygon in body.data.polygons:
        polygon.material_index = int(0.12 < polygon.center.z < 1.3 and abs(polygon.center.x) < 0.3)
    bpy.ops.object.select_all(action="DESELECT")
    body.select_set(True)
    bpy.context.view_layer.objects.active = body
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(angle_limit=radians(66), island_margin=0.01)
    bpy.ops.object.mode_set(mode="OBJECT")


def _animate(rig: bpy.types.Object, fps: int) -> None:
    """Key the poses, from before the first frame until after the last one."""
    start = FIRST / BASE
    for pose in range(-KEYS, round((LAST - FIRST) / BASE * KEYS / gait.STRIDE) + KEYS + 1):
        time = pose * gait.STRIDE / KEYS
        frame = (start + time) * fps
        rig.location = gait.place(time)
        rig.keyframe_insert("location", frame=frame)
        for name, angles in gait.turns(time).items():
            bone = rig.pose.bones[name]
            own = bone.bone.matrix_local.to_3x3()
            turn = own.inverted() @ Euler(angles).to_matrix() @ own
            bone.rotation_quaternion = turn.to_quaternion()
            bone.keyframe_insert("rotation_quaternion", frame=frame)
        hips = rig.pose.bones["hips"]
        hips.location = hips.bone.matrix_local.to_3x3().inverted() @ Vector(gait.sway(time))
        hips.keyframe_insert("location", frame=frame)
    _smoothen(rig)


def _smoothen(thing: bpy.types.Object) -> None:
    """Give f-curves automatic handles: speed and acceleration are continuous. Blender's default flattens extrema."""
    animation = thing.animation_data
    for curve in action_get_channelbag_for_slot(animation.action, animation.action_slot).fcurves:
        for key in curve.keyframe_points:
            key.handle_left_type = key.handle_right_type = "AUTO"
        curve.update()


def _camera(fps: int) -> None:
    """A camera that goes along, from the side to the front."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.lens = 35
    scene.collection.objects.link(camera)
    scene.camera = camera
    for place, number in (((5, 0, 1.4), FIRST), ((4, -5, 1.6), (FIRST + LAST) // 2), ((1, -10, 1.4), LAST)):
        camera.location = place
        target = Vector(gait.place((number - FIRST) / BASE)) + Vector((0, 0, 1))
        camera.rotation_euler = (target - camera.location).to_track_quat("-Z", "Y").to_euler()
        for channel in ("location", "rotation_euler"):
            camera.keyframe_insert(channel, frame=number / BASE * fps)
    _smoothen(camera)


if __name__ == "__main__":
    main()
