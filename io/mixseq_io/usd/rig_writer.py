"""USD, writing: stand-alone files of skins and morphs (.usd and .usdc binary, .usda text, .usdz packages).

Materials are copied from the sequence's original USD file.
"""

from __future__ import annotations

from pathlib import Path

from pxr import Sdf

from mixseq.rigging.rigs import Morph, Skin
from mixseq_io.atomic import replacing
from mixseq_io.usd.diagnostics import quiet, save_layer, writing_usd
from mixseq_io.usd.layers import pack
from mixseq_io.usd.played import author_times
from mixseq_io.usd.shown import shown_by
from mixseq_io.usd.skel_rig import define_rig
from mixseq_io.usd.writer import check_not_needed, check_up_axis, folders_of, warn_of_unpacked


def write_usd_rig(path: Path, rig: Skin | Morph) -> None:
    """Write a skin or a morph."""
    header = rig.header
    check_up_axis(path, header)
    origin = header.surface.origin
    if origin is not None:
        check_not_needed(path, Path(origin.path))
    packed = path.suffix.lower() == ".usdz"
    elsewhere: list[str] = []
    with replacing(path) as temporary, quiet(), writing_usd(path):
        layer = Sdf.Layer.CreateNew(str(temporary.with_suffix(".usdc") if packed else temporary))
        author_times(layer, header, shown_by(header, header.fps), None)
        define_rig(layer, path, rig)
        save_layer(layer)
        if packed:
            elsewhere = pack(layer, temporary, path.with_suffix(".usdc").name, folders_of(header))
    warn_of_unpacked(path, elsewhere)
