"""Skeletons built from a file's list of joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import AmbiguousError, FormatError
from mixseq_io.choosing import listed

if TYPE_CHECKING:
    from mixseq.rigging.skeletons import Skeleton


def choose_skeleton(file: Path, names: Sequence[tuple[str, ...]], name: str | None) -> int:
    """Return the index of the skeleton with a name; raise an error if several fit."""
    if not names:
        raise FormatError(
            f"{file} has no skeleton; a file with a character that is bound to joints is expected"
        )
    shown = listed([each[0] for each in names])
    found = [number for number, each in enumerate(names) if name is None or name in each]
    if not found:
        raise FormatError(f"{file} has no skeleton {name!r}; there are {shown}")
    if len(found) > 1:
        raise AmbiguousError(
            f"{file} has several skeletons, {listed([names[i][0] for i in found])}; choose one by name (in Python, as "
            "name= of mixseq.read_skeleton and mixseq.read_bind_pose), or export it alone"
        )
    return found[0]


def skeleton_of(names: Sequence[str], parents: Sequence[int], bind: Float) -> Skeleton:
    """Return a skeleton from joints in any order, with bind matrices ``(B, 4, 4)``."""
    from scipy.spatial.transform import Rotation

    from mixseq.errors import InvalidSequenceError
    from mixseq.geometry.rigid import nearest_rotations
    from mixseq.rigging.skeletons import Skeleton

    if not np.isfinite(bind).all():
        joint = int(np.argmin(np.isfinite(bind).all(axis=(1, 2))))
        raise InvalidSequenceError(f"the bind pose of joint {joint} ({names[joint]!r}) is not finite")
    order = parents_first(parents)
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


def parents_first(parents: Sequence[int]) -> list[int]:
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
