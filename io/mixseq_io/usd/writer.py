"""USD, writing (.usd and .usdc binary, .usda text, .usdz packages).

A sequence that was read from a USD file is written as a layer over that file (`overlay`), other sequences as files
that stand alone (`standalone`). Either has its samples (`frames`) in itself (`layers`) or in value clips (`clips`).
USD's points are float32; larger precision is rounded to that.
"""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf

from mixseq.errors import OutputError, SettingsError
from mixseq.sequence import FloatArray, SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.blocks import checked, warn
from mixseq_io.usd.base import Base, open_base
from mixseq_io.usd.clips import new_folder, save_in_clips
from mixseq_io.usd.diagnostics import quiet, writing_usd
from mixseq_io.usd.frames import Cast, Frame, frames
from mixseq_io.usd.layers import declare, save
from mixseq_io.usd.overlay import lay_over
from mixseq_io.usd.package import pack
from mixseq_io.usd.paths import time_codes
from mixseq_io.usd.standalone import define_component


def write_usd(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | PathLike[str] | None = None,
    clips: int = 0,
) -> None:
    """Write a USD file; see `mixseq_io.write_blocks`.

    Parameters
    ----------
    path, header, blocks, velocities
        See `mixseq_io.write_blocks`.
    flatten : bool
        Write a file that stands alone, even if the sequence was read from a USD file; .usdz always does.
    onto : path-like, optional
        The USD file to lay the points over; by default the one that the sequence was read from.
    clips : int
        Put the samples into files of this many frames each, in a folder ``<file>.clips`` beside the file; 0: into
        the file itself.

    Raises
    ------
    OutputError
        If the up axis is X, which USD does not know, if `onto` does not fit the sequence, or if the file would
        replace one that it is laid over.
    SettingsError
        If the options contradict each other.

    Warns
    -----
    MixseqWarning
        If the file that the sequence was read from is gone or does not fit, so that the new one stands alone; and of
        what is lost, see `lay_over` and `define_component`.
    """
    packed = path.suffix.lower() == ".usdz"
    _check_options(packed, flatten, onto, clips)
    if header.up_axis == "X":
        raise OutputError(
            f"{path}: USD stages have Y or Z up, this mesh has X; turn it first, or write .npz or .h5"
        )
    base = None if flatten else _base(path, header, onto)
    codes = time_codes(header.times, header.fps)
    _, numbered = checked(header, blocks, velocities)

    def begun(file: Path) -> tuple[Sdf.Layer, Cast, Iterable[Frame]]:
        layer = Sdf.Layer.CreateNew(str(file))
        _author_times(layer, header, codes, base)
        moving, start = velocities is not None, float(header.times[0])
        cast = (
            lay_over(layer, path, base, start, moving)
            if base
            else define_component(layer, path, header, moving)
        )
        declare(layer, cast)
        return layer, cast, frames(cast, codes, header.times, numbered)

    with (
        new_folder(path) as folder,
        replacing(path) as temporary,
        quiet(),
        writing_usd(path),
    ):
        if packed:
            unpacked = temporary.with_suffix(".usdc")
            try:
                layer, _, samples = begun(unpacked)
                save(layer, samples)
                pack(layer, temporary, path.with_suffix(".usdc").name)
            finally:
                unpacked.unlink(missing_ok=True)
        elif clips:
            folder.make()
            save_in_clips(*begun(temporary), clips, folder)
            folder.install()
        else:
            layer, _, samples = begun(temporary)
            save(layer, samples)


def _check_options(packed: bool, flatten: bool, onto: object, clips: int) -> None:
    if clips < 0:
        raise SettingsError(f"clips is {clips}; give the number of frames per file, or 0 for a single file")
    if onto is not None and flatten:
        raise SettingsError("a flattened USD file stands alone; leave out either onto or flatten")
    if packed and (onto is not None or clips):
        raise SettingsError("a .usdz file has everything in itself; leave out onto and clips, or write .usdc")


def _base(path: Path, header: SequenceHeader, onto: str | PathLike[str] | None) -> Base | None:
    """Return the file to lay the points over, None if there is none."""
    origin = header.surface.origin
    known = origin.path if origin and origin.format == "USD" else None
    if onto is None and known is None:
        return None
    file = Path(onto or known or "")
    if path.suffix.lower() == ".usdz":
        warn(f"{path} stands alone, as .usdz files do: only the mesh and its materials are kept of {file}")
        return None
    try:
        with quiet():
            base = open_base(file, header)
    except OutputError as error:
        if onto is not None:
            raise
        warn(f"{path} stands alone: {error}; onto=... (--onto) names the file where it is now")
        return None
    used = [Path(layer.realPath) for layer in base.stage.GetUsedLayers() if layer.realPath]
    if path.exists() and any(each.exists() and each.samefile(path) for each in used):
        raise OutputError(
            f"{path} is laid over {file} and cannot replace it; write to another name, or a file that stands alone, "
            "with flatten=True (--flatten)"
        )
    return base


def _author_times(
    layer: Sdf.Layer, header: SequenceHeader, codes: NDArray[np.float64], base: Base | None
) -> None:
    """Author units and times; over a file its range is kept, and grows where frames are outside of it."""
    layer.timeCodesPerSecond = layer.framesPerSecond = header.fps
    start, end = float(codes[0]), float(codes[-1])
    if base:
        below = base.stage
        scale = header.fps / below.GetTimeCodesPerSecond()
        if scale == 1.0:
            layer.framesPerSecond = below.GetFramesPerSecond()
        if below.HasAuthoredTimeCodeRange():
            start, end = (
                min(start, scale * below.GetStartTimeCode()),
                max(end, scale * below.GetEndTimeCode()),
            )
    layer.startTimeCode, layer.endTimeCode = start, end
    layer.pseudoRoot.SetInfo("upAxis", header.up_axis)
    layer.pseudoRoot.SetInfo("metersPerUnit", header.metres_per_unit)
