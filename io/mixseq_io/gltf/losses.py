"""What a glTF file cannot hold of a sequence, or not as it is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mixseq.sequence import SequenceHeader
from mixseq_io.blocks import warn
from mixseq_io.gltf.morphs import time_shift
from mixseq_io.gltf.splitting import distinguishes, owners
from mixseq_io.gltf.standalone import material_name, upright
from mixseq_io.losses import warn_of_losses
from mixseq_io.scene_meshes import SceneMesh, split

# Of browsers: WebGL holds weights in uniforms, usually 1024 or 4096, and targets in layers of a texture, usually 2048.
_USUAL_LIMIT_OF_FRAMES = 1000


def lost_alone(header: SequenceHeader) -> list[str]:
    """Return what of the mesh itself is lost in a document of its own."""
    lost = []
    if not header.polygons.only_triangles:
        lost.append("polygons other than triangles (they are cut)")
    if header.surface.subdivision != "none":
        lost.append(f"{header.surface.subdivision} subdivision")
    meshes = split(header)
    if any(_overlap(mesh) for mesh in meshes):
        lost.append("face sets that overlap")
    if any(each.name != material_name(each) for mesh in meshes for each in mesh.face_sets):
        lost.append("names of face sets other than their materials'")
    empty = [mesh.name for mesh in meshes if not mesh.polygons.counts.size]
    if empty:
        lost.append(f"objects without polygons ({', '.join(map(repr, empty[:20]))})")
    return lost


def warn_of_changes(path: Path, header: SequenceHeader, lost: Sequence[str]) -> None:
    """Warn of what is lost, of what is read in another way than it is in the sequence."""
    warn_of_losses(path, "glTF files", lost)
    if upright(header):
        warn(
            f"{path}: glTF is in metres with Y up; the points stay as they are, in {header.metres_per_unit:g} metres "
            f"per unit with {header.up_axis} up, under a node that turns and scales them"
        )
    shift = time_shift(header)
    if shift:
        warn(f"{path}: glTF's times begin at 0; all times are moved by {-shift:g} s")


def warn_of_many_frames(path: Path, header: SequenceHeader) -> None:
    """Warn of more frames than browsers show, where each is a morph target."""
    if header.frame_count > _USUAL_LIMIT_OF_FRAMES:
        warn(
            f"{path}: {header.frame_count} frames are as many morph targets; browsers usually show no more than "
            f"about {_USUAL_LIMIT_OF_FRAMES}, so resample it for them"
        )


def _overlap(mesh: SceneMesh) -> bool:
    owner = owners(mesh)
    return any(
        (owner[each.polygons] != number).any()
        for number, each in enumerate(mesh.face_sets)
        if distinguishes(each, mesh)
    )
