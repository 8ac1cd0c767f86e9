"""Skins and morphs in files for engines."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from mixseq.errors import OutputError
from mixseq.public import public

if TYPE_CHECKING:
    from mixseq.rigging.rigs import Morph, Skin

RIG_EXTENSIONS = (".glb", ".gltf")
"""Of the files that hold skins and morphs."""


@public
def write_rig(path: str | os.PathLike[str], rig: Skin | Morph, meshopt: float | None = None) -> None:
    """Write a skin or a morph as glTF, which engines play: ``.glb`` is binary, ``.gltf`` text with everything in it.

    Texture coordinates, hard edges and names of materials go along, pictures do not. Numbers are float32. The file
    appears when it is complete, as those of `mixseq_io.write_blocks` do, and `mixseq_io.read` reads it.

    Parameters
    ----------
    path : path-like
        The file.
    rig : Skin or Morph
        What to write, made by `mixseq.fit_skin` or `mixseq.fit_morph`. Keys are at its frames; ``rig.resampled``
        moves them.
    meshopt : float, optional
        Quantise and pack everything (``EXT_meshopt_compression``), points off by at most so many diagonals of their
        mesh, each target, too; weights and bones are exact.

    Raises
    ------
    OutputError
        If the name does not end in .glb or .gltf, the file cannot be written or would be too large, or a skin has
        more than 65535 bones.
    SettingsError
        If `meshopt` is not between 0 and 1.
    TypeError
        If `rig` is something else.
    InvalidSequenceError
        If points or times do not fit into float32.

    Warns
    -----
    MixseqWarning
        If glTF cannot hold something of the mesh, shows it under a node that turns and scales it, or times are moved.
    """
    file = Path(path)
    check_rig_target(file)
    from mixseq.rigging.rigs import Skin
    from mixseq_io.atomic import replacing
    from mixseq_io.gltf.morph_rig import morphed_scene
    from mixseq_io.gltf.packing import check_error, writing_document
    from mixseq_io.gltf.skin_rig import skinned_scene
    from mixseq_io.gltf.writer import lost_alone, warn_of_changes

    check_error(meshopt)
    layout = skinned_scene(rig) if isinstance(rig, Skin) else morphed_scene(rig)
    warn_of_changes(file, rig.header, lost_alone(rig.header))
    with replacing(file) as temporary, writing_document(file, temporary, layout, meshopt):
        pass  # all of it is in the layout already


def check_rig_target(path: Path) -> None:
    """Refuse what is no place for a skin or a morph.

    Raises
    ------
    OutputError
        If the name does not end in .glb or .gltf.
    """
    if path.suffix.lower() not in RIG_EXTENSIONS:
        raise OutputError(
            f"{path}: skins and morphs are written as glTF; end the name in {' or '.join(RIG_EXTENSIONS)}"
        )
