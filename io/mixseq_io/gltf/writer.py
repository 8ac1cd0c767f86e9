"""glTF, writing: morph targets, laid over the original file, or in a document of its own.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from numpy.typing import ArrayLike

from mixseq.arrays import FloatArray
from mixseq.errors import SettingsError
from mixseq.sequence import SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.blocks import as_float32, checked, warn
from mixseq_io.gltf.buffers import Layout, writing_buffer
from mixseq_io.gltf.carry import lay_over
from mixseq_io.gltf.compression import plain
from mixseq_io.gltf.document import load_document
from mixseq_io.gltf.morphs import Morphs, MovingMesh, time_shift
from mixseq_io.gltf.new_document import distinguishes, material_name, new_scene, owners, upright
from mixseq_io.gltf.other_motion import NOTHING, OtherMotion
from mixseq_io.losses import lost_colours, lost_subdivision, warn_of_losses
from mixseq_io.originals import opened_original
from mixseq_io.reader import reading
from mixseq_io.scene_meshes import SceneMesh, split

_DAMAGE = (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError)


def write_gltf(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | os.PathLike[str] | None = None,
    keep_start: bool = False,
    sources: ArrayLike | None = None,
) -> None:
    """Write a glTF file: ``.glb`` is binary, ``.gltf`` text with everything in it.

    Parameters
    ----------
    path : Path
        The file.
    header, blocks, velocities
        See `mixseq_io.write_blocks`; velocities are lost.
    flatten : bool
        Write the sequence alone. By default, everything else of its original glTF file is kept.
    onto : path-like, optional
        The file whose materials, textures and other nodes are kept, in place of the original.
    keep_start : bool
        Start the animation at the sequence's first time. By default it starts at 0, and its extras store that time.
    sources : (T,) array-like, optional
        Times of the original that the frames show, in seconds; where they differ, a warning lists other motion.
    """
    if flatten and onto is not None:
        raise SettingsError("flatten writes the sequence alone, onto lays it over a file; give one of them")
    overlay = None if flatten else _overlay(path, header, onto, sources)
    layout, meshes, others = overlay or (*new_scene(header), NOTHING)
    lost = [] if overlay else lost_alone(header)
    warn_of_changes(path, header, [*(["velocities"] if velocities is not None else []), *lost], keep_start)
    warn_of_many_frames(path, header)
    morphs = Morphs(layout, meshes, header, keep_start, others)
    _, numbered = checked(header, blocks, velocities)
    with replacing(path) as temporary, writing_buffer(path, temporary, layout) as writer:
        for first, block, _ in numbered:
            # One by one, because a block may be the whole sequence.
            for frame, points in enumerate(block, start=first):
                morphs.write(frame, as_float32(points[None], frame, "glTF", header=header)[0], writer)


def _overlay(
    path: Path, header: SequenceHeader, onto: str | os.PathLike[str] | None, sources: ArrayLike | None
) -> tuple[Layout, list[MovingMesh], OtherMotion] | None:
    """Return the document of the file that the sequence is laid over, None if there is none."""

    def opened(file: Path) -> tuple[Layout, list[MovingMesh], OtherMotion]:
        with reading(file, "glTF", *_DAMAGE):
            return lay_over(plain(load_document(file)), header, sources)

    return opened_original(path, header, onto, "glTF", opened)


# Of browsers: WebGL holds weights in uniforms, usually 1024 or 4096, and targets in layers of a texture, usually 2048.
_USUAL_LIMIT_OF_FRAMES = 1000


def lost_alone(header: SequenceHeader) -> list[str]:
    """Return the losses of a mesh in a document of its own, in words."""
    lost = []
    if not header.polygons.only_triangles:
        lost.append("polygons other than triangles (they are cut)")
    lost += lost_colours(header)
    subdivision = lost_subdivision(header.surface)
    if subdivision:
        lost.append(subdivision)
    meshes = split(header)
    if any(_overlap(mesh) for mesh in meshes):
        lost.append("face sets that overlap")
    if any(each.name != material_name(each) for mesh in meshes for each in mesh.face_sets):
        lost.append("names of face sets other than their materials'")
    empty = [mesh.name for mesh in meshes if not mesh.polygons.counts.size]
    if empty:
        lost.append(f"objects without polygons ({', '.join(map(repr, empty[:20]))})")
    return lost


def warn_of_changes(
    path: Path, header: SequenceHeader, lost: Sequence[str], keep_start: bool = False
) -> None:
    """Warn of losses, and of differences when the file is read again."""
    warn_of_losses(path, "glTF files", lost)
    if upright(header):
        warn(
            f"{path}: glTF is in metres with Y up; the points stay as they are, in {header.metres_per_unit:g} metres "
            f"per unit with {header.up_axis} up, under a node that turns and scales them; convert_units "
            "(--convert-axes Y, --convert-units m) turns and scales the points"
        )
    shift = time_shift(header, keep_start)
    if shift and (keep_start or header.frame_count == 1):  # else the file stores its start
        warn(f"{path}: glTF's times begin at 0; all times are moved by {-shift:g} s")


def warn_of_many_frames(path: Path, header: SequenceHeader) -> None:
    """Warn of more frames than browsers show, since each is a morph target."""
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
