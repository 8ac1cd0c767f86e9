"""Skeletons of characters, from the files that engines and animators exchange."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import AmbiguousError, FormatError
from mixseq.public import public
from mixseq_io.choosing import listed
from mixseq_io.reader import check_regular, naming
from mixseq_io.rig_files import GLTF, RIG_EXTENSIONS

if TYPE_CHECKING:
    from mixseq.rigging.skeletons import Skeleton
    from mixseq.sequence import MeshSequence


@public
def read_skeleton(path: str | os.PathLike[str], name: str | None = None) -> Skeleton:
    """Read a skeleton: the joints of a glTF skin, or of a UsdSkel skeleton.

    Joints stand where the mesh was bound to them, in the space of the world, as points of `mixseq_io.read` do. Joints
    that have no name are called ``joint_000`` and so on, and those whose name occurs twice get a number, too.

    Parameters
    ----------
    path : path-like
        A ``.glb``, ``.gltf``, ``.usd``, ``.usda``, ``.usdc`` or ``.usdz`` file. Nothing of its meshes is read.
    name : str, optional
        Which one, where there are several: name of the skin, ``skin 0`` and so on if it has none; path or name of the
        skeleton's prim. Skins of the same joints are one skeleton.

    Returns
    -------
    Skeleton
        Pivots and axes of the bind pose; scales of joints are left out. Bones that files list after their children
        stand before them.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another type, or has no skeleton of that name.
    AmbiguousError
        If there are several skeletons; the message names them.
    """
    file = Path(path)
    _check_skeleton_file(file)
    with naming(file):
        if file.suffix.lower() in GLTF:
            from mixseq_io.gltf.joints import read_joints

            return read_joints(file, name)
        from mixseq_io.usd.joints import read_skel_joints

        return read_skel_joints(file, name)


@public
def read_bind_pose(path: str | os.PathLike[str], name: str | None = None) -> MeshSequence:
    """Read the meshes of a skeleton as they were when they were bound to it, as a sequence of one frame.

    They have the vertices of `mixseq_io.read`, and stand around the joints of `read_skeleton`. What hangs on joints of
    glTF is among them. Morph targets of glTF are mixed as the file has them without animations, those of USD are not.

    Parameters
    ----------
    path, name
        See `read_skeleton`.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another type, or has no skeleton of that name.
    NoMeshError
        If there is no mesh on the skeleton.
    AmbiguousError
        If there are several skeletons; the message names them.
    """
    from mixseq.sequence import collect

    file = Path(path)
    _check_skeleton_file(file)
    if file.suffix.lower() in GLTF:
        from mixseq_io.gltf.reader import open_gltf_bind_pose as open_bind_pose
    else:
        from mixseq_io.usd.reader import open_usd_bind_pose as open_bind_pose
    with open_bind_pose(file, name) as reader:
        return collect(reader.header, reader.blocks())


def _check_skeleton_file(file: Path) -> None:
    """Refuse what is no file with skeletons."""
    check_regular(file, "a file")
    if file.suffix.lower() not in RIG_EXTENSIONS:
        raise FormatError(
            f"{file}: skeletons are read from glTF and USD; a file that ends in {', '.join(RIG_EXTENSIONS[:-1])} or "
            f"{RIG_EXTENSIONS[-1]} is expected"
        )


def choose_skeleton(file: Path, names: Sequence[tuple[str, ...]], name: str | None) -> int:
    """Return the number of the skeleton that is meant.

    Examples
    --------
    >>> choose_skeleton(Path("a.glb"), [("fox",), ("skin 1", "cat")], "cat")
    1
    """
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
    """Return a skeleton of joints in any order: bind ``(B, 4, 4)``."""
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
    """Return the joints in their order, but for parents that stand after a child: these come before it."""
    order: dict[int, None] = {}
    for joint in range(len(parents)):
        above = []
        while joint >= 0 and joint not in order:
            above.append(joint)
            joint = parents[joint]
        order.update(dict.fromkeys(reversed(above)))
    return list(order)


def _different(names: Sequence[str]) -> list[str]:
    """Return names of which no two are alike, and none is empty."""
    taken = set(names)
    found: list[str] = []
    for bone, name in enumerate(names):
        new, number = name or f"joint_{bone:03d}", 1
        while new in found or (new != name and new in taken):
            number += 1
            new = f"{name or f'joint_{bone:03d}'}_{number}"
        found.append(new)
    return found
