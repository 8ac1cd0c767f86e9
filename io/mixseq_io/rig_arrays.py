"""Arrays of skins and morphs for files, and skeletons built from a file's list of joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import AmbiguousError, FormatError
from mixseq.rigging.rigs import Morph, Skin
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.types import Float, Index, Single
from mixseq_io.reader import as_float32
from mixseq_io.scene_meshes import format_names

if TYPE_CHECKING:
    from mixseq.rigging.rigs import Skeleton


_ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""Motion below this fraction of the largest number counts as rounding."""


def four_influences(skin: Skin) -> tuple[Index, NDArray[np.float32]]:
    """Return four bones and float32 weights ``(V, 4)`` per vertex, for engines.

    Bones of a vertex are distinct, the largest weight first, bones without weight are 0, and weights sum to 1.
    """
    bones = skin.influences.copy()
    weights = skin.weights.copy()
    for column in range(1, bones.shape[1]):
        for earlier in range(column):
            again = bones[:, column] == bones[:, earlier]
            weights[again, earlier] += weights[again, column]
            weights[again, column] = 0.0
    order = np.argsort(-weights, axis=1, kind="stable")
    bones = np.take_along_axis(bones, order, axis=1)
    rounded = np.take_along_axis(weights, order, axis=1).astype(np.float32)
    rounded[:, 0] = 1 - rounded[:, 1:].astype(np.float64).sum(axis=1)
    return np.where(rounded > 0, bones, 0), rounded


def normalise_morph_weights(rig: Skin | Morph) -> Morph:
    r"""Return a rig's shape before bones, with weights scaled to 0 to 1, the range of sliders.

    Blender and Unity clip smaller weights to 0. With the least and the largest weight of every target over the frames,

    .. math:: x + \sum_m w_{tm} d_m = \Bigl( x + \sum_m w^-_m d_m \Bigr)
              + \sum_m \frac{w_{tm} - w^-_m}{w^+_m - w^-_m} (w^+_m - w^-_m) d_m .

    Targets of constant weight move into the base.
    """
    shape = rig if isinstance(rig, Morph) else Morph(rig.header, rig.rest, rig.targets, rig.target_weights)
    if not len(shape.targets):
        return shape
    least = shape.weights.min(axis=0)
    spread = shape.weights.max(axis=0) - least
    used = spread > 0
    return replace(
        shape,
        base=shape.base + np.einsum("m,mvi->vi", least, shape.targets),
        targets=shape.targets[used] * spread[used, None, None],
        weights=(shape.weights[:, used] - least[used]) / spread[used],
    )


def numbered_names(word: str, count: int) -> list[str]:
    """Return numbered names that sort by number: "bone_00", "bone_01"."""
    width = max(2, len(str(count - 1)))
    return [f"{word}_{number:0{width}d}" for number in range(count)]


def remove_rounding_motion(values: Float, unit: float) -> Float:
    """Return values ``(T, n, k)`` with those of bones that only move by rounding set to the first frame's."""
    largest = max(unit, float(np.abs(values).max(initial=0.0)))
    moved = np.abs(values - values[:1]).max(axis=(0, 2), keepdims=True)
    return np.where(moved <= _ROUNDING * largest, values[:1], values)


def local_joint_transforms(
    skin: Skin, file_format: str, header: SequenceHeader | None = None
) -> tuple[Single, Single]:
    """Return local rotations ``(T, B, 4)`` and translations ``(T, B, 3)`` in float32; errors name the format."""
    local = skin.local_motion()
    places = remove_rounding_motion(local.translations, bounding_diagonal(skin.rest))
    return remove_rounding_motion(local.rotations, 1.0).astype(np.float32), as_float32(
        places, 0, file_format, "bone", header
    )


def choose_skeleton(file: Path, names: Sequence[tuple[str, ...]], name: str | None) -> int:
    """Return the index of the skeleton with a name; raise an error if several fit."""
    if not names:
        raise FormatError(
            f"{file} has no skeleton; a file with a character that is bound to joints is expected"
        )
    shown = format_names([each[0] for each in names])
    found = [number for number, each in enumerate(names) if name is None or name in each]
    if not found:
        raise FormatError(f"{file} has no skeleton {name!r}; there are {shown}")
    if len(found) > 1:
        raise AmbiguousError(
            f"{file} has several skeletons, {format_names([names[i][0] for i in found])}; choose one by name "
            "(in Python, as name= of mixseq.read_skeleton and mixseq.read_bind_pose), or export it alone"
        )
    return found[0]


def build_skeleton(names: Sequence[str], parents: Sequence[int], bind: Float) -> Skeleton:
    """Return a skeleton from joints in any order, with bind matrices ``(B, 4, 4)``."""
    from scipy.spatial.transform import Rotation

    from mixseq.errors import InvalidSequenceError
    from mixseq.mesh.rigid import nearest_rotations
    from mixseq.rigging.rigs import Skeleton

    if not np.isfinite(bind).all():
        joint = int(np.argmin(np.isfinite(bind).all(axis=(1, 2))))
        raise InvalidSequenceError(f"the bind pose of joint {joint} ({names[joint]!r}) is not finite")
    order = order_parents_first(parents)
    place = {joint: bone for bone, joint in enumerate(order)} | {-1: -1}
    axes = bind[order][:, :3, :3]
    # The length of the first column takes away the unit of the file, which would hide a small matrix.
    axes = axes / np.maximum(np.linalg.norm(axes, axis=(1, 2), keepdims=True), 1e-300)
    return Skeleton(
        tuple(_different([names[joint] for joint in order])),
        np.array([place[parents[joint]] for joint in order]),
        bind[order][:, :3, 3],
        Rotation.from_matrix(nearest_rotations(axes)).as_quat(),
    )


def order_parents_first(parents: Sequence[int]) -> list[int]:
    """Return joint indices with parents before their children, otherwise in order."""
    order: dict[int, None] = {}
    for joint in range(len(parents)):
        above = []
        while joint >= 0 and joint not in order:
            above.append(joint)
            joint = parents[joint]
        order.update(dict.fromkeys(reversed(above)))
    return list(order)


def _different(names: Sequence[str]) -> list[str]:
    """Return names made unique and non-empty."""
    taken = set(names)
    found: list[str] = []
    for bone, name in enumerate(names):
        new, number = name or f"joint_{bone:03d}", 1
        while new in found or (new != name and new in taken):
            number += 1
            new = f"{name or f'joint_{bone:03d}'}_{number}"
        found.append(new)
    return found
