"""Rows about rigs: skins and morphs of glTF and USD, imported by Blender, beside what mixseq says of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import mixseq
from mixseq.arrays import Float
from mixseq.creature import walk_cycle
from mixseq.rigging.rigs import Morph, Skin
from mixseq.sequence import MeshSequence
from mixseq_io.rig_measuring import measure
from scripts.benchmarks.blender.environment import show
from scripts.benchmarks.blender.live_rows import LiveRow
from scripts.benchmarks.blender.seen import Seen

FORMATS = {"glTF": ".glb", "USD": ".usdz"}

NEAR = 5e-6
"""What single precision along a chain of bones may be off by, in diagonals; ours."""


def rig_rows(folder: Path, data: Path | None) -> Iterator[LiveRow]:
    """Have Blender import rigs, and compare every frame.

    Parameters
    ----------
    folder : Path
        For all files.
    data : Path, optional
        The folder of real animations, for two more.
    """
    made = {
        (name, form): (sequence, rig, folder / f"{name}{suffix}".replace(" ", "_"))
        for name, (sequence, rig) in _rigs(data).items()
        for form, suffix in FORMATS.items()
    }
    jobs = []
    for sequence, rig, file in made.values():
        mixseq.write_rig(file, rig)
        jobs.append(
            {
                "open": {"file": str(file), "fps": round(sequence.fps)},
                "frames": [*range(sequence.frame_count), *_between(sequence)],
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
    return found


def _rows(name: str, sequence: MeshSequence, rig: Skin | Morph, file: Path, seen: Seen) -> Iterator[LiveRow]:
    (key,) = (key for key in seen.arrays if key.startswith("points/"))
    shown, later = np.split(_upright(seen.arrays[key]), [sequence.frame_count])
    diagonal = float(np.linalg.norm(np.ptp(sequence.points[0], axis=0)))
    yield LiveRow(f"{name}, beside the rig", float(np.abs(shown - rig.points()).max()) / diagonal, NEAR)
    halves = rig.resampled(sequence.times[0] + np.array(_between(sequence)) / sequence.fps).points()
    yield LiveRow(f"{name}, between frames", float(np.abs(later - halves).max()) / diagonal, NEAR)
    told = measure(file, sequence).max_error
    found = mixseq.compare(sequence, MeshSequence.from_header(sequence.header, shown)).max_error
    yield LiveRow(f"{name}, its error, beside {told:.3g} that is told", abs(found - told), NEAR)
    if isinstance(rig, Skin):
        bones = dict(seen.names["bones"])
        names, parents = rig.skeleton.names, rig.skeleton.parents.tolist()
        meant = {
            bone: names[parent] if parent >= 0 else "" for bone, parent in zip(names, parents, strict=True)
        }
        others = sum(bones.get(bone) not in (parent, parent or "skeleton") for bone, parent in meant.items())
        yield LiveRow(f"{name}, bones with other names or parents", others, 0, "bones")


def _between(sequence: MeshSequence) -> list[float]:
    """Return some moments in the middle between frames."""
    return [frame + 0.5 for frame in range(0, sequence.frame_count - 1, 5)]


def _upright(points: Float) -> Float:
    """Return points ``(T, V, 3)`` of Blender's world, with Z up, with Y up."""
    return np.asarray(points[..., [0, 2, 1]] * [1, 1, -1])
