"""Skins and morphs in files for engines."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from mixseq.errors import OutputError
from mixseq.public import public

if TYPE_CHECKING:
    from mixseq.rigging.rigs import Morph, Skin

GLTF = (".glb", ".gltf")
USD = (".usd", ".usda", ".usdc", ".usdz")
RIG_EXTENSIONS = (*GLTF, *USD)
"""Of the files that hold skins and morphs."""


@public
def write_rig(path: str | os.PathLike[str], rig: Skin | Morph) -> None:
    """Write a skin or a morph, for engines and for animators.

    glTF: ``.glb`` is binary, ``.gltf`` text with everything in it. USD: ``.usd`` and ``.usdc`` are binary, ``.usda``
    is text, ``.usdz`` a package; a skin has a skeleton and blend shapes there (UsdSkel).

    Texture coordinates, hard edges and names of materials go along, and into USD the materials of a USD file that the
    sequence came from. Numbers are float32. The file appears when it is complete, as those of
    `mixseq_io.write_blocks` do, and `mixseq_io.read` reads it.

    Parameters
    ----------
    path : path-like
        The file.
    rig : Skin or Morph
        What to write, made by `mixseq.fit_skin` or `mixseq.fit_morph`. Keys are at its frames; ``rig.resampled``
        moves them.

    Raises
    ------
    OutputError
        If the name does not end in one of these, the file cannot be written or would be too large, a skin for glTF
        has more than 65535 bones, or USD does not know the up axis.
    TypeError
        If `rig` is something else.
    InvalidSequenceError
        If points or times do not fit into float32.

    Warns
    -----
    MixseqWarning
        If the format cannot hold something of the mesh, glTF shows it under a node that turns and scales it, times are
        moved, or materials of USD are only names.
    """
    file = Path(path)
    check_rig_target(file)
    if file.suffix.lower() in USD:
        from mixseq_io.usd.rig_writer import write_usd_rig

        write_usd_rig(file, rig)
    else:
        _write_gltf_rig(file, rig)


def _write_gltf_rig(file: Path, rig: Skin | Morph) -> None:
    from mixseq.rigging.rigs import Skin
    from mixseq_io.atomic import replacing
    from mixseq_io.gltf.buffers import writing_buffer
    from mixseq_io.gltf.morph_rig import morphed_scene
    from mixseq_io.gltf.skin_rig import skinned_scene
    from mixseq_io.gltf.writer import lost_alone, warn_of_changes

    layout = skinned_scene(rig) if isinstance(rig, Skin) else morphed_scene(rig)
    warn_of_changes(file, rig.header, lost_alone(rig.header))
    with replacing(file) as temporary, writing_buffer(file, temporary, layout):
        pass  # all of it is in the layout already


def check_rig_target(path: Path) -> None:
    """Refuse what is no place for a skin or a morph."""
    if path.suffix.lower() not in RIG_EXTENSIONS:
        raise OutputError(
            f"{path}: skins and morphs are written as glTF or USD; end the name in {', '.join(RIG_EXTENSIONS[:-1])} "
            f"or {RIG_EXTENSIONS[-1]}"
        )
