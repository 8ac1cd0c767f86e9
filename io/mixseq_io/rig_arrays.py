"""Convert skins and morph targets to arrays for writers, and joint lists of readers to skeletons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError
from mixseq.mesh.measures import choose_origin
from mixseq.rigging.rigs import Morph, Skeleton, Skin
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.types import Float, Index, Single
from mixseq_io.reader import as_float32
from mixseq_io.scene_meshes import format_names

RigType = TypeVar("RigType", bound=Skin | Morph)

_ROUNDING_FRACTION = 4 * float(np.finfo(np.float32).eps)
"""Largest motion that counts as a rounding error, relative to the largest magnitude."""


def move_rig(rig: RigType) -> tuple[RigType, Float]:
    """Return a rig relative to the origin ``(3,)`` of its rest or base shape, see `choose_origin`, and this origin."""
    if isinstance(rig, Morph):
        origin = choose_origin(rig.base)
        return replace(rig, base=rig.base - origin), origin
    origin = choose_origin(rig.rest)
    skeleton = replace(rig.skeleton, pivots=rig.skeleton.pivots - origin)
    return replace(rig, rest=rig.rest - origin, skeleton=skeleton, translations=rig.translations - origin), origin


def four_influences(skin: Skin) -> tuple[Index, Single]:
    """Return distinct bones and float32 weights ``(V, 4)`` with sum 1, by decreasing weight; bone 0 for weight 0."""
    bones = skin.influences.copy()
    weights = skin.weights.copy()
    for column in range(1, bones.shape[1]):
        for earlier in range(column):
            repeated = bones[:, column] == bones[:, earlier]
            weights[repeated, earlier] += weights[repeated, column]
            weights[repeated, column] = 0.0
    order = np.argsort(-weights, axis=1, kind="stable")
    bones = np.take_along_axis(bones, order, axis=1)
    rounded = np.take_along_axis(weights, order, axis=1).astype(np.float32)
    rounded[:, 0] = 1 - rounded[:, 1:].astype(np.float64).sum(axis=1)
    return np.where(rounded > 0, bones, 0), rounded


def normalise_morph_weights(rig: Skin | Morph) -> Morph:
    r"""Return the morph targets of a rig with weights from 0 to 1; Blender and Unity clip negative weights.

    With the minimum :math:`w^-_m` and maximum :math:`w^+_m` of the weights of every target over the frames,

    .. math:: x + \sum_m w_{tm} d_m = \Bigl( x + \sum_m w^-_m d_m \Bigr)
              + \sum_m \frac{w_{tm} - w^-_m}{w^+_m - w^-_m} (w^+_m - w^-_m) d_m .

    Targets of constant weight are added to the base.
    """
    morph = rig if isinstance(rig, Morph) else Morph(rig.header, rig.rest, rig.targets, rig.target_weights)
    if not len(morph.targets):
        return morph
    minimum = morph.weights.min(axis=0)
    extent = morph.weights.max(axis=0) - minimum
    varying = extent > 0
    return replace(
        morph,
        base=morph.base + np.einsum("m,mvi->vi", minimum, morph.targets),
        targets=morph.targets[varying] * extent[varying, None, None],
        weights=(morph.weights[:, varying] - minimum[varying]) / extent[varying],
    )


def target_names(count: int) -> list[str]:
    """Return names of morph targets with zero-padded numbers: "mode_00", "mode_01"."""
    width = max(2, len(str(count - 1)))
    return [f"mode_{number:0{width}d}" for number in range(count)]


def remove_rounding_motion(values: Float, unit: float) -> Float:
    """Freeze tracks ``(T, n, k)`` that vary only by rounding, relative to `unit` or the largest magnitude."""
    magnitude = max(unit, float(np.abs(values).max(initial=0.0)))
    motion = np.abs(values - values[:1]).max(axis=(0, 2), keepdims=True)
    return np.where(motion <= _ROUNDING_FRACTION * magnitude, values[:1], values)


def local_joint_transforms(skin: Skin, file_format: str, header: SequenceHeader | None = None) -> tuple[Single, Single]:
    """Return parent-relative rotations ``(T, B, 4)`` and translations ``(T, B, 3)`` in float32 for a file format."""
    rotations, translations = skin.local_motion()
    rotations = remove_rounding_motion(rotations, 1.0)
    translations = remove_rounding_motion(translations, bounding_diagonal(skin.rest))
    return rotations.astype(np.float32), as_float32(translations, 0, file_format, "bone", header)


def choose_skeleton(file: Path, names: Sequence[tuple[str, ...]], name: str | None) -> int:
    """Return the index of the only skeleton called `name`, or of the only skeleton if `name` is None."""
    if not names:
        raise FormatError(f"{file} has no skeleton; a file with a character that is bound to joints is expected")
    matching = [index for index, own in enumerate(names) if name is None or name in own]
    if not matching:
        available = format_names([own[0] for own in names])
        raise FormatError(f"{file} has no skeleton {name!r}; there are {available}")
    if len(matching) > 1:
        raise AmbiguousError(
            f"{file} has several skeletons, {format_names([names[i][0] for i in matching])}; choose one by name "
            "(in Python, as name= of mixseq.read_skeleton and mixseq.read_bind_pose), or export it alone"
        )
    return matching[0]


def build_skeleton(names: Sequence[str], parents: Sequence[int], bind: Float) -> Skeleton:
    """Build a skeleton from joints in any order, their parents (-1 for none) and bind matrices ``(B, 4, 4)``."""
    from scipy.spatial.transform import Rotation

    from mixseq.mesh.rigid import nearest_rotations

    if not np.isfinite(bind).all():
        joint = int(np.argmin(np.isfinite(bind).all(axis=(1, 2))))
        raise InvalidSequenceError(f"the bind pose of joint {joint} ({names[joint]!r}) is not finite")
    order = order_parents_first(parents)
    bone_of_joint = {joint: bone for bone, joint in enumerate(order)} | {-1: -1}
    axes = bind[order][:, :3, :3]
    # The matrices are normalised, since matrices in small units would count as singular.
    axes = axes / np.maximum(np.linalg.norm(axes, axis=(1, 2), keepdims=True), 1e-300)
    return Skeleton(
        tuple(_make_unique([names[joint] for joint in order])),
        np.array([bone_of_joint[parents[joint]] for joint in order]),
        bind[order][:, :3, 3],
        Rotation.from_matrix(nearest_rotations(axes)).as_quat(),
    )


def order_parents_first(parents: Sequence[int]) -> list[int]:
    """Return joint indices with parents before children, in the given order where possible."""
    order: dict[int, None] = {}
    for joint in range(len(parents)):
        chain = []
        while joint >= 0 and joint not in order:
            chain.append(joint)
            joint = parents[joint]
        order.update(dict.fromkeys(reversed(chain)))
    return list(order)


def _make_unique(names: Sequence[str]) -> list[str]:
    """Name unnamed bones, and number repeated names: "arm", "arm_2"."""
    given = set(names)
    unique: list[str] = []
    for bone, name in enumerate(names):
        base = name or f"joint_{bone:03d}"
        candidate, number = base, 1
        while candidate in unique or (candidate != name and candidate in given):
            number += 1
            candidate = f"{base}_{number}"
        unique.append(candidate)
    return unique
