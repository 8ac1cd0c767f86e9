"""Rows about rigs: skins and morphs of glTF and USD, imported by Blender, beside what mixseq says of them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import mixseq
from mixseq.creature import walk_cycle
from mixseq.rigging.rigs import Morph, Skin
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, FloatArray
from mixseq_io.rig_files import measure_rig_file
from tests.blender.environment import show
from tests.blender.live_rows import LiveRow
from tests.blender.seen import Seen

FORMATS = {"glTF": ".glb", "USD": ".usdz"}

GIVEN: dict[str, tuple[str, dict[str, Any]]] = {
    "CesiumMan": ("gltf/CesiumMan.glb", {}),
    "KhronosFox": ("gltf/KhronosFox.glb", {"animation": "Run"}),
    "RiggedFigure": ("usd/RiggedFigure.usdz", {}),
}
"""Characters that are fitted to the skeletons of their own files: the file, and how it is read."""

NEAR = 5e-6
"""What single precision along a chain of bones may be off by, in diagonals"""

MIXED = 5e-3
"""What bones may be off by that are not half-way between keys, where Blender mixes quaternions as numbers"""


def rig_rows(folder: Path, data: Path | None) -> Iterator[LiveRow]:
    """Have Blender import rigs, and compare every frame; `data` is the folder of real animations, for five more."""
    made = {
        (name, form): (sequence, rig, folder / f"{name}{suffix}".replace(" ", "_"))
        for name, (sequence, rig) in _rigs(data).items()
        for form, suffix in FORMATS.items()
    }
    jobs = []
    for sequence, rig, file in made.values():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of materials, which stay in the character's file
            mixseq.write_rig(file, rig)
        jobs.append(
            {
                "open": {"file": str(file), "fps": round(sequence.fps)},
                "frames": (sequence.fps * np.concatenate(_moments(sequence))).tolist(),
                "output": str(file.with_suffix("")) + file.suffix[1:],
            }
        )
    show(jobs, folder)
    for ((name, form), (sequence, rig, file)), job in zip(made.items(), jobs, strict=True):
        yield from _rows(f"{name}, {form}", sequence, rig, file, Seen.read(Path(str(job["output"]))))


def _rigs(data: Path | None) -> dict[str, tuple[MeshSequence, Skin | Morph]]:
    walk = walk_cycle(24)
    found: dict[str, tuple[MeshSequence, Skin | Morph]] = {
        "fox, skin": (walk, mixseq.fit_skin(walk)),
        "fox, morph": (walk, mixseq.fit_morph(walk, max_error=0.01)),
    }
    if data is not None:
        for name in ("q_wolf_gallop", "horse_gallop"):
            sequence = mixseq.read(data / "npz" / f"{name}.npz")
            found[f"{name}, skin"] = sequence, mixseq.fit_skin(sequence, bones=20)
        for name, (file, options) in GIVEN.items():
            found[f"{name}, own skeleton"] = _given(data / file, options)
    return found


def _given(file: Path, options: Mapping[str, Any]) -> tuple[MeshSequence, Skin]:
    """Bake a character, and fit it to the skeleton of its own file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what else is in a file
        sequence = mixseq.read(file, **options)
        skeleton, bind_pose = mixseq.read_skeleton(file), mixseq.read_bind_pose(file)
    return sequence, mixseq.fit_skin(sequence, skeleton=skeleton, bind_pose=bind_pose)


def _rows(name: str, sequence: MeshSequence, rig: Skin | Morph, file: Path, seen: Seen) -> Iterator[LiveRow]:
    ((key, points),) = ((key, each) for key, each in seen.arrays.items() if key.startswith("points/"))
    own = seen.arrays.get(key.replace("points", "vertices"), np.arange(points.shape[1])).astype(np.int64)
    moments = _moments(sequence)
    shown, halves, quarters = np.split(_upright(points), np.cumsum([len(times) for times in moments])[:2])

    def off(points: Float, times: Float) -> float:
        return _farthest(points, rig.resampled(times).points()[:, own]) / sequence.diagonal

    yield LiveRow(f"{name}, compared with the rig", off(shown, moments[0]), NEAR)
    yield LiveRow(f"{name}, half-way between frames", off(halves, moments[1]), NEAR)
    mixed = MIXED if isinstance(rig, Skin) else NEAR
    yield LiveRow(f"{name}, a quarter after frames", off(quarters, moments[2]), mixed)
    told = measure_rig_file(file, sequence).max_error
    found = _farthest(shown, sequence.points[:, own]) / sequence.diagonal
    yield LiveRow(f"{name}, its error, compared with {told:.3g} printed", abs(found - told), NEAR)
    if isinstance(rig, Skin):
        bones = dict(seen.names["bones"])
        names, parents = rig.skeleton.names, rig.skeleton.parents.tolist()
        meant = {bone: names[parent] if parent >= 0 else "" for bone, parent in zip(names, parents, strict=True)}
        others = sum(bones.get(bone) not in (parent, parent or "skeleton") for bone, parent in meant.items())
        yield LiveRow(f"{name}, bones with different names or parents", others, 0, "bones")


def _farthest(points: FloatArray, others: FloatArray) -> float:
    """Return the largest distance of a point ``(T, V, 3)`` from the other one."""
    return float(np.linalg.norm(points - others, axis=2).max())


def _moments(sequence: MeshSequence) -> tuple[Float, Float, Float]:
    """Return times in seconds: of all frames, and half-way and a quarter of the way from each to the next."""
    times = sequence.times
    before, steps = times[:-1], np.diff(times)
    return times, before + steps / 2, before + steps / 4


def _upright(points: Float) -> Float:
    """Return points ``(T, V, 3)`` of Blender's world, with Z up, with Y up."""
    return np.asarray(points[..., [0, 2, 1]] * [1, 1, -1])
