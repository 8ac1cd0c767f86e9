"""Skins and morphs on the command line: fit and write them, and measure the written file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mixseq
from mixseq.errors import MixseqWarning, NoMeshError, SettingsError
from mixseq.frame_rates import rate_text

if TYPE_CHECKING:
    from mixseq.progress import Progress
    from mixseq.rigging.rigs import Morph, Skin
    from mixseq.sequence import MeshSequence

_ONLY_FOR = {
    "bones": "skin",
    "skeleton": "skin",
    "kg": "skin",
    "correctives": "skin",
    "max_error": "skin or morph (or a target .vat)",
    "max_targets": "skin or morph",
}
_BONES = ("bones", "skeleton", "max_error", "kg")
_USELESS = {"velocities": "velocities", "onto": "other files to build on", "clips": "clips"}


@dataclass(frozen=True)
class RigSettings:
    """Settings of a skin or a morph; None is the default of the fit."""

    kind: str | None  # kind of the rig; None for a sequence
    bones: int | None  # number of bones
    skeleton: Path | None  # a file with the bones, and mostly with the mesh on them
    correctives: float | None  # largest error of a vertex with a skin's correctives, in diagonals
    max_error: float | None  # largest error of a vertex with a skin's bones alone, or a morph, in diagonals
    kg: float | None  # KG error of a skin's bones, in percent
    max_targets: int | None  # number of morph targets at most

    def check(self, velocities: bool, writing: Mapping[str, Any], texture: str | None = None) -> None:
        """Raise an error for options that exclude each other."""
        if texture is not None:
            raise SettingsError(
                "texture is for vertex animation textures; leave it out, or end the target in .vat"
            )
        for name, kinds in _ONLY_FOR.items():
            if getattr(self, name) is not None and (self.kind is None or self.kind not in kinds):
                raise SettingsError(f"{_option(name)} is for --as {kinds}; leave it out, or give both")
        telling = [_option(name) for name in _BONES if getattr(self, name) is not None]
        if self.kind == "skin" and len(telling) > 1:
            raise SettingsError(
                f"{telling[0]} and {telling[1]} both tell which bones there are; give one of them"
            )
        if self.kind is not None:
            for name in ["velocities"] * velocities + list(writing):
                if name in _USELESS:
                    raise SettingsError(
                        f"a {self.kind} has no place for {_USELESS[name]}; leave out --{name}, or --as"
                    )

    def fit(self, sequence: MeshSequence, progress: Progress) -> Skin | Morph:
        """Fit the rig to a sequence; a mesh on the skeleton with the same vertices is the bind pose."""
        targets = {} if self.max_targets is None else {"max_targets": self.max_targets}
        if self.kind == "morph":
            return mixseq.fit_morph(sequence, self.max_error, **targets, progress=progress)
        skeleton = bind_pose = None
        if self.skeleton is not None:
            skeleton = mixseq.read_skeleton(self.skeleton)
            bind_pose = _bind_pose(self.skeleton, sequence)
        return mixseq.fit_skin(
            sequence,
            self.bones,
            self.correctives,
            **targets,
            progress=progress,
            skeleton=skeleton,
            bind_pose=bind_pose,
            max_error=self.max_error,
            kg=self.kg,
        )


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _bind_pose(path: Path, sequence: MeshSequence) -> MeshSequence | None:
    """Return the mesh on the skeleton of a file, None if there is none, or if it differs from that of a sequence."""
    try:
        found = mixseq.read_bind_pose(path)
    except NoMeshError:  # a skeleton alone
        return None
    if found.vertex_count == sequence.vertex_count:
        return found
    more = sequence.vertex_count > found.vertex_count
    cure = (
        "; if the sequence has other meshes as well, encode that one alone (mixseq encode --prim)"
        if more
        else ""
    )
    warnings.warn(
        f"{path}: the mesh on the skeleton has {found.vertex_count} vertices, that of the sequence has "
        f"{sequence.vertex_count}; it is left out, and the skeleton is taken as it would stand in the first frame"
        + cure,
        MixseqWarning,
        stacklevel=2,
    )
    return None


def rows(path: Path, rig: Skin | Morph, sequence: MeshSequence) -> list[tuple[str, str]]:
    """Return table rows of a written file's contents and its distance from the sequence."""
    from mixseq.cli.console import format_bytes
    from mixseq.rigging.rigs import Skin
    from mixseq_io.rig_files import GLTF
    from mixseq_io.rig_measuring import measure, size_as_frames

    found = measure(path, sequence)
    first, last = rig.header.times[[0, -1]]
    frames = f"{rig.header.frame_count:,} from {first:g} to {last:g} s at {rate_text(rig.header.fps)} frames per second"
    table = [
        ("keys", frames),
        *([("bones", f"{rig.bone_count}")] if isinstance(rig, Skin) else []),
        ("morph targets", f"{len(rig.targets)}"),
        ("max error", f"{found.max_error:.4g} diagonals"),
        ("rms error", f"{found.rms_error:.4g} diagonals"),
        ("KG error", f"{found.kg_percent:.4g} %"),
    ]
    if path.suffix.lower() in GLTF:
        size = format_bytes(size_as_frames(sequence.header))
        table.append(("every frame", f"would be {size} as a morph target each"))
    return table
