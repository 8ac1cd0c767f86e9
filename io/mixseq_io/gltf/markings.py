"""glTF: what tells parts of meshes apart besides their materials: vertex colours, and the joints of skins.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#meshes-overview (COLOR_0, JOINTS_0, WEIGHTS_0)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.arrays import FloatArray
from mixseq_io.gltf.primitives import Primitive
from mixseq_io.gltf.scene import Scene
from mixseq_io.gltf.skinning import Shape
from mixseq_io.labels.markings import Skinning, joined_colours, joined_skinning


def colours_of(shapes: Sequence[Shape]) -> FloatArray | None:
    """Return COLOR_0 at the corners ``(sum of counts, 4)`` of all meshes, None if none has it."""
    primitives = [each for shape in shapes for each in shape.weld.primitives]
    return joined_colours(
        [_colours(each) for each in primitives], [each.triangles.size for each in primitives]
    )


def _colours(primitive: Primitive) -> FloatArray | None:
    index = primitive.attributes.index("COLOR_0")
    if index is None:
        return None
    width = 3 if primitive.document.item("accessors", index).text("type") == "VEC3" else 4
    values = primitive.attribute("COLOR_0", width)
    assert values is not None
    if values.dtype.kind == "u":  # exporters that forget to say "normalized"
        values = values / float(np.iinfo(values.dtype).max)
    return np.asarray(values[primitive.triangles.reshape(-1)])


def skinning_of(shapes: Sequence[Shape]) -> Skinning | None:
    """Return the joints of all meshes, None if none has a skin; meshes without one follow their nodes."""
    if all(shape.skin is None for shape in shapes):
        return None
    return joined_skinning([_skinning(shape) for shape in shapes])


def _skinning(shape: Shape) -> Skinning:
    if shape.skin is None:
        return Skinning.rigid(shape.scene.paths[shape.node], shape.weld.count)
    joints = shape.skin.joints
    return Skinning(
        shape.skin.weights,
        tuple(_path(shape.scene, joint) for joint in joints),
        tuple(_path_above(shape.scene, joint, joints) for joint in joints),
    )


def _path(scene: Scene, node: int) -> str:
    return scene.paths.get(node, f"node {node}")


def _path_above(scene: Scene, joint: int, joints: Sequence[int]) -> str:
    """Return the path of the nearest joint above a joint; nodes between them are none."""
    return next((_path(scene, each) for each in scene.above(joint)[1:] if each in joints), "")
