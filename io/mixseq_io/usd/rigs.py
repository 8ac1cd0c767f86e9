"""Writer of skins and morphs as stand-alone USD files (UsdSkel), and reader of the joints of skeletons.

The reader maps bind transforms from skeleton space to the world by the skeleton's transform at the stage's start. USD's
matrices act on row vectors.

A written file has a SkelRoot with the meshes, a Skeleton and a SkelAnimation. Bind transforms are in world space, with
the axes ``A_b`` at the pivot ``p_b``. The animation moves joints relative to their parents by `Skin.local_motion`.
UsdSkel thus maps a point from the bind pose to ``R_tb (r_v - p_b) + c_tb``, the skin's formula, after blend shapes. The
Skeleton of a morph has no joints. Joints are identified by paths of valid names (``hips/leg``), and ``jointNames``
holds their original names. Materials are copied from the sequence's original USD file.

Specification: https://openusd.org/release/api/_usd_skel__schemas.html
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import FormatError
from mixseq.rigging.rigs import Morph, Skeleton, Skin, rotation_matrices
from mixseq.types import Float
from mixseq_io.reader import as_float32
from mixseq_io.rig_arrays import (
    build_skeleton,
    choose_skeleton,
    four_influences,
    local_joint_transforms,
    move_rig,
    normalise_morph_weights,
    target_names,
)
from mixseq_io.surfaces import RoundingMonitor
from mixseq_io.usd.layers import SampledMesh, compute_frame_values, declare_attributes
from mixseq_io.usd.motion import TimeMap
from mixseq_io.usd.stage import (
    Identifiers,
    WorldTransform,
    capture_diagnostics,
    open_stage,
    time_codes,
    translate_usd_read_errors,
    traverse_prims,
)
from mixseq_io.usd.writer import (
    author_time_range,
    check_not_overwritten,
    check_up_axis,
    define_component,
    new_layer,
)


def read_skel_joints(path: Path, name: str | None) -> Skeleton:
    """Read the joints of a skeleton; see `mixseq_io.read_skeleton`."""
    with capture_diagnostics(), translate_usd_read_errors(path):
        stage = open_stage(path)
        prim = find_skeleton_prim(path, stage, name)
        skeleton = UsdSkel.Skeleton(prim)
        joints = skeleton.GetJointsAttr().Get() or []
        binds = skeleton.GetBindTransformsAttr().Get() or []
        if not joints or len(binds) != len(joints):
            raise FormatError(
                f"{path}: {prim.GetPath()} has {len(joints)} joints and {len(binds)} bind transforms; one bind "
                "transform per joint, and at least one joint, are expected: export the character again"
            )
        topology = UsdSkel.Topology(joints)
        is_valid, reason = topology.Validate()
        if not is_valid:
            raise FormatError(f"{path}: the joints of {prim.GetPath()} are not a tree: {reason}")
        parents = [int(each) for each in topology.GetParentIndices()]
        to_world = np.array(WorldTransform(prim).at(stage.GetStartTimeCode()))
        bind = (np.array(binds, dtype=np.float64).reshape(-1, 4, 4) @ to_world).swapaxes(1, 2)
        names = list(skeleton.GetJointNamesAttr().Get() or [])
        if len(names) != len(joints):
            names = [Sdf.Path(joint).name for joint in joints]
        return build_skeleton(names, parents, bind)


def find_skeleton_prim(path: Path, stage: Usd.Stage, name: str | None) -> Usd.Prim:
    """Return the skeleton with a name, or the only skeleton; see `mixseq_io.rig_arrays.choose_skeleton`."""
    prims = [prim for prim in traverse_prims(path, stage) if UsdSkel.Skeleton(prim)]
    names = [(str(prim.GetPath()), prim.GetName(), prim.GetDisplayName()) for prim in prims]
    return prims[choose_skeleton(path, names, name)]


def define_rig(layer: Sdf.Layer, target: Path, rig: Skin | Morph) -> None:
    """Author a skin or a morph in a layer."""
    rig, origin = move_rig(rig)
    shape = normalise_morph_weights(rig)
    prims = define_component(layer, target, rig.header, has_velocities=False, origin=origin)
    declare_attributes(layer, prims)
    base_block = (0, shape.base[None] + origin, None)
    ((_, values),) = compute_frame_values(
        prims, np.zeros(1), np.zeros(1), [base_block], RoundingMonitor(target, "USD", rig.header)
    )
    for path, value in values.items():
        layer.GetAttributeAtPath(path).default = value
    stage = Usd.Stage.Open(layer)
    root = stage.GetDefaultPrim()
    root.SetTypeName("SkelRoot")
    identifiers = Identifiers(*(child.GetName() for child in root.GetChildren()))
    skeleton_path = root.GetPath().AppendChild(identifiers.reserve("skeleton"))
    skeleton = UsdSkel.Skeleton.Define(stage, skeleton_path)
    animation = UsdSkel.Animation.Define(stage, skeleton.GetPath().AppendChild("animation"))
    codes = time_codes(rig.header.times, rig.header.fps)
    shape_names = target_names(len(shape.targets))
    if isinstance(rig, Skin):
        _define_joints(skeleton, rig.skeleton)
        _animate_joints(animation, skeleton, rig, codes)
    if shape_names:
        animation.CreateBlendShapesAttr(Vt.TokenArray(shape_names))
        weights = [Vt.FloatArrayFromBuffer(each) for each in shape.weights.astype(np.float32)]
        _set_samples(animation.CreateBlendShapeWeightsAttr(), weights, codes)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    for mesh in prims.meshes:
        binding = UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath(mesh.path))
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        _add_shapes(stage, binding, mesh, shape_names, shape.targets)
        if isinstance(rig, Skin):
            _add_influences(binding, mesh, rig)
    extent = UsdGeom.Boundable(root).CreateExtentAttr()
    frames = (points for block in rig.blocks() for points in block)
    for code, points in zip(codes.tolist(), frames, strict=True):
        extent.Set(UsdGeom.PointBased.ComputeExtent(Vt.Vec3fArrayFromBuffer(points.astype(np.float32))), code)


def _define_joints(skeleton: UsdSkel.Skeleton, joints: Skeleton) -> None:
    paths: list[str] = []
    siblings: dict[int, Identifiers] = {}
    for name, parent in zip(joints.names, joints.parents.tolist(), strict=True):
        identifier = siblings.setdefault(parent, Identifiers()).reserve(name)
        paths.append(identifier if parent < 0 else f"{paths[parent]}/{identifier}")
    skeleton.CreateJointsAttr(Vt.TokenArray(paths))
    skeleton.CreateJointNamesAttr(Vt.TokenArray(joints.names))
    skeleton.CreateBindTransformsAttr(_matrices(joints.axes, joints.pivots))
    skeleton.CreateRestTransformsAttr(_matrices(*joints.local_rest()))


def _matrices(rotations: Float, translations: Float) -> Any:
    """Return the matrices M of quaternions ``(B, 4)`` and translations ``(B, 3)``, for row vectors: x' = x M."""
    matrices = np.tile(np.eye(4), (len(rotations), 1, 1))
    matrices[:, :3, :3] = rotation_matrices(rotations).swapaxes(1, 2)
    matrices[:, 3, :3] = translations
    return Vt.Matrix4dArrayFromBuffer(matrices)


def _animate_joints(
    animation: UsdSkel.Animation, skeleton: UsdSkel.Skeleton, skin: Skin, codes: NDArray[np.float64]
) -> None:
    rotations, translations = local_joint_transforms(skin, "USD", skin.header)
    animation.CreateJointsAttr(skeleton.GetJointsAttr().Get())
    # Gf.Quatf is stored as x, y, z, w.
    _set_samples(animation.CreateRotationsAttr(), [Vt.QuatfArrayFromBuffer(each) for each in rotations], codes)
    _set_samples(animation.CreateTranslationsAttr(), [Vt.Vec3fArrayFromBuffer(each) for each in translations], codes)
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * skin.bone_count))


def _set_samples(attribute: Usd.Attribute, values: list[Any], codes: NDArray[np.float64]) -> None:
    """Set an attribute's values at all time codes, or a single value if the values are constant."""
    if all(value == values[0] for value in values):
        attribute.Set(values[0])
        return
    for code, value in zip(codes.tolist(), values, strict=True):
        attribute.Set(value, code)


def _add_influences(binding: UsdSkel.BindingAPI, mesh: SampledMesh, skin: Skin) -> None:
    bones, weights = (each[mesh.scene_mesh.vertices] for each in four_influences(skin))
    is_constant, width = False, bones.shape[1]
    joints = Vt.IntArrayFromBuffer(bones.astype(np.int32).reshape(-1))
    binding.CreateJointIndicesPrimvar(is_constant, width).Set(joints)
    binding.CreateJointWeightsPrimvar(is_constant, width).Set(Vt.FloatArrayFromBuffer(weights.reshape(-1)))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))


def _add_shapes(
    stage: Usd.Stage, binding: UsdSkel.BindingAPI, mesh: SampledMesh, names: list[str], targets: Float
) -> None:
    """Add the morph targets that move a mesh, each with offsets of only the points that it moves."""
    path = Sdf.Path(mesh.path)
    identifiers = Identifiers(*(child.GetName() for child in stage.GetPrimAtPath(path).GetChildren()))
    used, paths = [], []
    for name, target in zip(names, as_float32(targets, 0, "USD", "a target of vertex"), strict=True):
        offsets = target[mesh.scene_mesh.vertices]
        point_ids = np.flatnonzero(offsets.any(axis=1))
        if not point_ids.size:
            continue
        shape = UsdSkel.BlendShape.Define(stage, path.AppendChild(identifiers.reserve(name)))
        shape.CreateOffsetsAttr(Vt.Vec3fArrayFromBuffer(offsets[point_ids]))
        shape.CreatePointIndicesAttr(Vt.IntArrayFromBuffer(point_ids.astype(np.int32)))
        used.append(name)
        paths.append(shape.GetPath())
    if used:
        binding.CreateBlendShapesAttr(Vt.TokenArray(used))
        binding.CreateBlendShapeTargetsRel().SetTargets(paths)


def write_usd_rig(path: Path, rig: Skin | Morph, check: Callable[[Path], object] | None) -> None:
    """Write a skin or a morph as a USD file; `check` is that of `atomic_file`."""
    header = rig.header
    check_up_axis(path, header)
    origin = header.surface.origin
    if origin is not None:
        check_not_overwritten(path, Path(origin.path))
    with new_layer(path, header, check=check) as layer:
        author_time_range(layer, header, TimeMap.from_header(header, header.fps), None)
        define_rig(layer, path, rig)
