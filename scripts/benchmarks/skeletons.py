"""Characters baked and fitted to their own skeletons, beside skins of as many bones that are found.

Errors of joints, axes and weights are those against the file's own; its weights are not given to the fit.

Usage: scripts/bench skeletons [FILE[:ANIMATION] ...]   (in $MIXSEQ_DATA; eight of four characters by default)
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import mixseq
from mixseq.mesh.rigid import nearest_rotations
from mixseq.rigging.rigs import Skin, rotation_matrices
from mixseq.types import Float
from mixseq_io.rig_arrays import order_parents_first
from scripts.benchmarks.common.harness import DATA, compile_skins, cpu_timed, print_table

FILES = (
    "gltf/CesiumMan.glb",
    "usd/CesiumMan.usdz",
    "gltf/KhronosFox.glb:Survey",
    "gltf/KhronosFox.glb:Run",
    "gltf/RiggedFigure.glb",
    "usd/RiggedFigure.usdz",
    "gltf/RiggedSimple.glb",
    "usd/RiggedSimple.usdz",
)

COLUMNS = (
    "character", "bones", "KG %", "max error", "joints", "axes (degrees)", "weights", "seconds (processor)",
    "found bones, KG %",
)  # fmt: skip


@dataclass(frozen=True)
class Rig:
    """A character's own: weights ``(V, B)``, and matrices ``(T, B, 4, 4)`` from joints to the world."""

    weights: Float
    joints: Float


def rows(file: str) -> Iterator[tuple[str, ...]]:
    """Fit a character to its own skeleton, and to as many bones that are found."""
    name, _, animation = file.partition(":")
    path = DATA / name
    options: dict[str, Any] = {"animation": animation} if animation else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what else is in a file
        sequence = mixseq.read(path, **options)
        skeleton, bind_pose = mixseq.read_skeleton(path), mixseq.read_bind_pose(path)
        rig = _rig(path, options, sequence.times)
    seconds, skin = cpu_timed(lambda: mixseq.fit_skin(sequence, skeleton=skeleton, bind_pose=bind_pose))
    fitted = mixseq.compare(sequence, skin)
    found = mixseq.compare(sequence, mixseq.fit_skin(sequence, skin.bone_count))
    used = rig.weights.max(axis=0) > 0  # where joints are that move nothing cannot be seen
    away = np.linalg.norm(skin.translations - rig.joints[..., :3, 3], axis=2)[:, used] / sequence.diagonal
    yield (
        file,
        f"{used.sum()} of {skin.bone_count}",
        f"{fitted.kg_percent:.2g}",
        f"{fitted.max_error:.2g}",
        f"{away.mean():.2g}",
        f"{_turned(skin, rig)[:, used].mean():.2g}",
        f"{np.abs(_weights(skin) - rig.weights).sum(axis=1).mean():.2g}",
        f"{seconds:.1f}",
        f"{found.kg_percent:.2g}",
    )


def _weights(skin: Skin) -> Float:
    found = np.zeros((len(skin.weights), skin.bone_count))
    np.add.at(found, (np.arange(len(found))[:, None], skin.influences), skin.weights)
    return found


def _turned(skin: Skin, rig: Rig) -> Float:
    """Return the angles ``(T, B)`` between the axes of joints that were fitted and those of the file, in degrees."""
    own = nearest_rotations(rig.joints[..., :3, :3])
    fitted = rotation_matrices(skin.rotations) @ rotation_matrices(skin.skeleton.axes)
    between = Rotation.from_matrix((np.swapaxes(own, 2, 3) @ fitted).reshape(-1, 3, 3))
    return np.degrees(between.magnitude()).reshape(own.shape[:2])


def _rig(path: Path, options: dict[str, Any], times: Float) -> Rig:
    with mixseq.open_sequence(path, **options) as reader:
        skinning = reader.markings().skinning
    assert skinning is not None, "it is a character"
    parents = [skinning.joints.index(parent) if parent else -1 for parent in skinning.parents]
    order = order_parents_first(parents)
    usd = path.suffix.startswith(".usd")
    joints = _usd_joints(path, times) if usd else _gltf_joints(path, options, times)
    return Rig(
        np.asarray(skinning.weights.todense())[:, order],
        np.stack([joints[skinning.joints[number]] for number in order], axis=1),
    )


def _gltf_joints(path: Path, options: dict[str, Any], times: Float) -> dict[str, Float]:
    """Return the matrices ``(T, 4, 4)`` of all nodes by path."""
    from mixseq_io.gltf.animation import choose_animation, evaluate_pose, read_channels
    from mixseq_io.gltf.codecs import load_plain_document
    from mixseq_io.gltf.scene import read_scene

    document = load_plain_document(path)
    scene = read_scene(document)
    nodes = set(scene.paths)
    channels = read_channels(document, choose_animation(document, options.get("animation")), nodes)
    world = scene.world_matrices(nodes, evaluate_pose(channels, times))
    shape = (len(times), 4, 4)
    return {path: np.broadcast_to(world[node], shape) for node, path in scene.paths.items()}


def _usd_joints(path: Path, times: Float) -> dict[str, Float]:
    """Return the matrices ``(T, 4, 4)`` of the joints of the only skeleton by path, as USD computes them."""
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(path))
    skeleton = next(UsdSkel.Skeleton(prim) for prim in stage.Traverse() if UsdSkel.Skeleton(prim))
    root = next(UsdSkel.Root(prim) for prim in stage.Traverse() if UsdSkel.Root(prim))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skeleton)
    found = []
    for time_code in times * stage.GetTimeCodesPerSecond():
        at = UsdGeom.XformCache(time_code)
        found.append(np.array(query.ComputeJointWorldTransforms(at)).swapaxes(1, 2))
    paths = [f"{skeleton.GetPath()}/{joint}" for joint in query.GetJointOrder()]
    return {path: np.stack(found)[:, number] for number, path in enumerate(paths)}


if __name__ == "__main__":
    compile_skins()
    sys.exit(print_table(COLUMNS, rows, FILES))
