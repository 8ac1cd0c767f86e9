"""Skins and morphs in USD (UsdSkel): stand-alone files with joints and blend shapes, and skeletons read.

Bind transforms are in skeleton space, placed in the world by the skeleton's transform at the start of the stage. USD's
matrices act on row vectors.

Written, a SkelRoot holds the meshes, a Skeleton and a SkelAnimation. Bind transforms are in world space, with the axes
``A_b`` at the pivot ``p_b``. The animation moves joints relative to their parents by `Skin.local_motion`,
so that UsdSkel takes a point from the bind pose to ``R_tb (r_v - p_b) + c_tb``, the skin's formula; blend shapes come
before joints. A morph has a Skeleton without joints. Joints are named by paths (``hips/leg``) of
valid names; ``jointNames`` keeps the others. Materials are copied from the sequence's original USD file.

Specification: https://openusd.org/release/api/_usd_skel__schemas.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import FormatError
from mixseq.rigging.rigs import Morph, Skeleton, Skin, rotation_matrices
from mixseq.types import Float
from mixseq_io.files import atomic_file
from mixseq_io.reader import as_float32
from mixseq_io.rig_arrays import (
    build_skeleton,
    choose_skeleton,
    four_influences,
    local_joint_transforms,
    normalise_morph_weights,
    numbered_names,
)
from mixseq_io.usd.layers import Cast, Placed, declare, extent_of, frames, pack
from mixseq_io.usd.motion import shown_by
from mixseq_io.usd.stage import (
    Identifiers,
    Placement,
    open_stage,
    prims_of,
    quiet,
    save_layer,
    time_codes,
    translate_usd_read_errors,
    translate_usd_write_errors,
)
from mixseq_io.usd.writer import (
    author_times,
    check_not_needed,
    check_up_axis,
    define_component,
    folders_of,
    warn_of_unpacked,
)


def read_skel_joints(path: Path, name: str | None) -> Skeleton:
    """Read the joints of a skeleton; see `mixseq_io.read_skeleton`."""
    with quiet(), translate_usd_read_errors(path):
        stage = open_stage(path)
        prim = skeleton_prim(path, stage, name)
        skeleton = UsdSkel.Skeleton(prim)
        joints = skeleton.GetJointsAttr().Get() or []
        binds = skeleton.GetBindTransformsAttr().Get() or []
        if not joints or len(binds) != len(joints):
            raise FormatError(
                f"{path}: {prim.GetPath()} has {len(joints)} joints and {len(binds)} bind transforms; as many of "
                "both, and one at least, are expected: export the character again"
            )
        topology = UsdSkel.Topology(joints)
        sound, reason = topology.Validate()
        if not sound:
            raise FormatError(f"{path}: the joints of {prim.GetPath()} are no tree: {reason}")
        parents = [int(each) for each in topology.GetParentIndices()]
        to_world = np.array(Placement(prim).to_world(stage.GetStartTimeCode()))
        bind = (np.array(binds, dtype=np.float64).reshape(-1, 4, 4) @ to_world).swapaxes(1, 2)
        told = list(skeleton.GetJointNamesAttr().Get() or [])
        names = told if len(told) == len(joints) else [Sdf.Path(joint).name for joint in joints]
        return build_skeleton(names, parents, bind)


def skeleton_prim(path: Path, stage: Usd.Stage, name: str | None) -> Usd.Prim:
    """Return the chosen skeleton; see `mixseq_io.rig_arrays.choose_skeleton`."""
    prims = [prim for prim in prims_of(path, stage) if UsdSkel.Skeleton(prim)]
    names = [(str(prim.GetPath()), prim.GetName(), prim.GetDisplayName()) for prim in prims]
    return prims[choose_skeleton(path, names, name)]


def define_rig(layer: Sdf.Layer, target: Path, rig: Skin | Morph) -> None:
    """Author a skin or a morph."""
    shape = normalise_morph_weights(rig)
    cast = define_component(layer, target, rig.header, velocities=False)
    _put_base(layer, cast, shape)
    stage = Usd.Stage.Open(layer)
    root = stage.GetDefaultPrim()
    root.SetTypeName("SkelRoot")
    names = Identifiers(*(child.GetName() for child in root.GetChildren()))
    skeleton = UsdSkel.Skeleton.Define(stage, root.GetPath().AppendChild(names.take("skeleton")))
    animation = UsdSkel.Animation.Define(stage, skeleton.GetPath().AppendChild("animation"))
    codes = time_codes(rig.header.times, rig.header.fps)
    modes = numbered_names("mode", len(shape.targets))
    if isinstance(rig, Skin):
        _define_joints(skeleton, rig.skeleton)
        _animate_joints(animation, skeleton, rig, codes)
    _animate_shapes(animation, modes, shape, codes)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    for mesh in cast.meshes:
        binding = UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath(mesh.path))
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        _add_shapes(stage, binding, mesh, modes, shape.targets)
        if isinstance(rig, Skin):
            _add_influences(binding, mesh, rig)
    extent = UsdGeom.Boundable(root).CreateExtentAttr()
    every = (points for block in rig.blocks() for points in block)
    for code, points in zip(codes.tolist(), every, strict=True):
        extent.Set(extent_of(points), code)


def _put_base(layer: Sdf.Layer, cast: Cast, shape: Morph) -> None:
    """Author the base points of the meshes and derived attributes, without time samples."""
    declare(layer, cast)
    ((_, values),) = frames(cast, np.zeros(1), np.zeros(1), [(0, shape.base[None], None)])
    for path, value in values.items():
        layer.GetAttributeAtPath(path).default = value


def _define_joints(skeleton: UsdSkel.Skeleton, joints: Skeleton) -> None:
    paths: list[str] = []
    siblings: dict[int, Identifiers] = {}
    for name, parent in zip(joints.names, joints.parents.tolist(), strict=True):
        own = siblings.setdefault(parent, Identifiers()).take(name)
        paths.append(own if parent < 0 else f"{paths[parent]}/{own}")
    rest = joints.local_rest()
    skeleton.CreateJointsAttr(Vt.TokenArray(paths))
    skeleton.CreateJointNamesAttr(Vt.TokenArray(joints.names))
    skeleton.CreateBindTransformsAttr(_matrices(joints.axes, joints.pivots))
    skeleton.CreateRestTransformsAttr(_matrices(rest.rotations, rest.translations))


def _matrices(rotations: Float, translations: Float) -> Any:
    """Return matrices of quaternions ``(B, 4)`` and translations ``(B, 3)`` for row vectors: x' = x M."""
    matrices = np.tile(np.eye(4), (len(rotations), 1, 1))
    matrices[:, :3, :3] = rotation_matrices(rotations).swapaxes(1, 2)
    matrices[:, 3, :3] = translations
    return Vt.Matrix4dArrayFromBuffer(matrices)


def _animate_joints(
    animation: UsdSkel.Animation, skeleton: UsdSkel.Skeleton, skin: Skin, codes: NDArray[np.float64]
) -> None:
    rotations, translations = local_joint_transforms(skin, "USD", skin.header)
    animation.CreateJointsAttr(skeleton.GetJointsAttr().Get())
    # The numbers of a Gf.Quatf lie in memory as x, y, z, w.
    _set(animation.CreateRotationsAttr(), [Vt.QuatfArrayFromBuffer(each) for each in rotations], codes)
    _set(animation.CreateTranslationsAttr(), [Vt.Vec3fArrayFromBuffer(each) for each in translations], codes)
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * skin.bone_count))


def _animate_shapes(
    animation: UsdSkel.Animation, modes: list[str], shape: Morph, codes: NDArray[np.float64]
) -> None:
    if not modes:
        return
    animation.CreateBlendShapesAttr(Vt.TokenArray(modes))
    weights = [Vt.FloatArrayFromBuffer(each) for each in shape.weights.astype(np.float32)]
    _set(animation.CreateBlendShapeWeightsAttr(), weights, codes)


def _set(attribute: Usd.Attribute, values: list[Any], codes: NDArray[np.float64]) -> None:
    """Set an attribute at every time code, or a single value if it is constant."""
    if all(value == values[0] for value in values):
        attribute.Set(values[0])
        return
    for code, value in zip(codes.tolist(), values, strict=True):
        attribute.Set(value, code)


def _add_influences(binding: UsdSkel.BindingAPI, mesh: Placed, skin: Skin) -> None:
    bones, weights = (each[mesh.scene_mesh.vertices] for each in four_influences(skin))
    of_vertex, width = False, bones.shape[1]
    joints = Vt.IntArrayFromBuffer(bones.astype(np.int32).reshape(-1))
    binding.CreateJointIndicesPrimvar(of_vertex, width).Set(joints)
    binding.CreateJointWeightsPrimvar(of_vertex, width).Set(Vt.FloatArrayFromBuffer(weights.reshape(-1)))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))


def _add_shapes(
    stage: Usd.Stage, binding: UsdSkel.BindingAPI, mesh: Placed, modes: list[str], targets: Float
) -> None:
    """Add the targets that move a mesh, each with its moved points only."""
    path = Sdf.Path(mesh.path)
    names = Identifiers(*(child.GetName() for child in stage.GetPrimAtPath(path).GetChildren()))
    used, paths = [], []
    for mode, target in zip(modes, as_float32(targets, 0, "USD", "a target of vertex"), strict=True):
        offsets = target[mesh.scene_mesh.vertices]
        moved = np.flatnonzero(offsets.any(axis=1))
        if not moved.size:
            continue
        shape = UsdSkel.BlendShape.Define(stage, path.AppendChild(names.take(mode)))
        shape.CreateOffsetsAttr(Vt.Vec3fArrayFromBuffer(offsets[moved]))
        shape.CreatePointIndicesAttr(Vt.IntArrayFromBuffer(moved.astype(np.int32)))
        used.append(mode)
        paths.append(shape.GetPath())
    if used:
        binding.CreateBlendShapesAttr(Vt.TokenArray(used))
        binding.CreateBlendShapeTargetsRel().SetTargets(paths)


def write_usd_rig(path: Path, rig: Skin | Morph) -> None:
    """Write a skin or a morph."""
    header = rig.header
    check_up_axis(path, header)
    origin = header.surface.origin
    if origin is not None:
        check_not_needed(path, Path(origin.path))
    packed = path.suffix.lower() == ".usdz"
    elsewhere: list[str] = []
    with atomic_file(path) as temporary, quiet(), translate_usd_write_errors(path):
        layer = Sdf.Layer.CreateNew(str(temporary.with_suffix(".usdc") if packed else temporary))
        author_times(layer, header, shown_by(header, header.fps), None)
        define_rig(layer, path, rig)
        save_layer(layer)
        if packed:
            elsewhere = pack(layer, temporary, path.with_suffix(".usdc").name, folders_of(header))
    warn_of_unpacked(path, elsewhere)
