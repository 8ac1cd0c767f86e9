"""glTF, writing: morph targets, laid over the file which the sequence came from, or in a document of its own.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.sequence import SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.blocks import as_float32, checked, warn
from mixseq_io.gltf.buffers import Layout, writing_buffer
from mixseq_io.gltf.carry import lay_over
from mixseq_io.gltf.document import load_document
from mixseq_io.gltf.losses import lost_alone, warn_of_changes, warn_of_many_frames
from mixseq_io.gltf.morphs import Morphs, MovingMesh
from mixseq_io.gltf.standalone import new_scene
from mixseq_io.reader import reading

_DAMAGE = (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError)


def write_gltf(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | os.PathLike[str] | None = None,
) -> None:
    """Write a glTF file: ``.glb`` is binary, ``.gltf`` text with everything in it.

    Parameters
    ----------
    path : Path
        The file.
    header, blocks, velocities
        See `mixseq_io.write_blocks`; velocities are lost.
    flatten : bool
        Write the sequence alone. By default, everything else of the glTF file that it came from is taken along.
    onto : path-like, optional
        The file whose materials, textures and other nodes are taken along, in place of that one.

    Raises
    ------
    OutputError
        If the file cannot be written, would be too large, or is the one that everything else comes from; or if
        `onto` cannot be read or has other meshes.
    InvalidSequenceError
        If points or times do not fit into float32.
    SettingsError
        If both `flatten` and `onto` are given.

    Warns
    -----
    MixseqWarning
        If something is lost: of the sequence, of the file it came from, or all of that file because it is not there
        any more or has other meshes.
    """
    if flatten and onto is not None:
        raise SettingsError("flatten writes the sequence alone, onto lays it over a file; give one of them")
    overlay = None if flatten else _overlay(path, header, onto)
    layout, meshes = overlay or new_scene(header)
    lost = [] if overlay else lost_alone(header)
    warn_of_changes(path, header, [*(["velocities"] if velocities is not None else []), *lost])
    warn_of_many_frames(path, header)
    morphs = Morphs(layout, meshes, header)
    _, numbered = checked(header, blocks, velocities)
    with replacing(path) as temporary, writing_buffer(path, temporary, layout) as writer:
        for first, block, _ in numbered:
            # One by one, because a block may be the whole sequence.
            for frame, points in enumerate(block, start=first):
                morphs.write(frame, as_float32(points[None], frame, "glTF")[0], writer)


def _overlay(
    path: Path, header: SequenceHeader, onto: str | os.PathLike[str] | None
) -> tuple[Layout, list[MovingMesh]] | None:
    """Return the document of the file that the sequence is laid over, None if there is none."""
    if onto is not None:
        file = Path(onto)
    elif header.surface.origin is not None and header.surface.origin.format == "glTF":
        file = Path(header.surface.origin.path)
    else:
        return None
    if path.exists() and file.exists() and path.samefile(file):
        raise OutputError(f"{path} is the original and would be lost; write to another name")
    try:
        with reading(file, "glTF", *_DAMAGE):
            return lay_over(load_document(file), header)
    except FormatError as error:
        if onto is not None:
            raise OutputError(f"cannot write {path} onto another file: {error}") from error
        warn(
            f"{error}; the sequence is written alone, without what else that file had (onto=FILE names another)"
        )
        return None
