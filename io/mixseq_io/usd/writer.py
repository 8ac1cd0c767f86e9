"""USD, writing (.usd and .usdc binary, .usda text, .usdz packages).

Sequences from a USD file become a layer over it (`overlay`), others a stand-alone file (`component`). Samples
(`frame_values`) are in the file itself (`layers`) or in value clips (`clips`). Points are rounded to float32.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path

from numpy.typing import ArrayLike
from pxr import Ar, Sdf

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.sequence import SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.blocks import checked, warn
from mixseq_io.usd.clips import new_folder, save_in_clips
from mixseq_io.usd.component import define_component
from mixseq_io.usd.diagnostics import quiet, reading_usd, save_layer, writing_usd
from mixseq_io.usd.frame_values import Cast, Frame, frames
from mixseq_io.usd.layers import declare, pack, save
from mixseq_io.usd.materials import is_gone
from mixseq_io.usd.original import Original, open_original
from mixseq_io.usd.overlay import lay_over, put_over
from mixseq_io.usd.part_labels import Parts, define_parts
from mixseq_io.usd.played import author_times
from mixseq_io.usd.prims import open_stage, shortened
from mixseq_io.usd.rest import retime_rest, warn_of_rest
from mixseq_io.usd.shown import shown_by, source_times


def write_usd(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | PathLike[str] | None = None,
    clips: int = 0,
    pack_from: str | PathLike[str] | None = None,
    sources: ArrayLike | None = None,
    whole_stage: bool = False,
    parts: Parts | None = None,
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
        Frames per sample file in a folder ``<file>.clips`` beside the file; 0: all samples in the file itself.
    pack_from : path-like, optional
        Folder from which textures may be packed into a .usdz, besides the original file's folder and those below.
    sources : (T,) array-like, optional
        Time of the original that every frame shows, in seconds, if it differs from its own; NaN for no single time.
        Other motion of the original is reported, or retimed.
    whole_stage : bool
        Retime all other motion of the original, too: cameras, hair, lights, other meshes.
    parts : Parts, optional
        Parts to write as subsets of the faces, see `mixseq_io.labels.writing`.
    """
    packed = path.suffix.lower() == ".usdz"
    _check_options(packed, flatten, onto, clips, pack_from)
    if whole_stage and (flatten or packed or sources is None):
        raise SettingsError(
            "whole_stage retimes what a layer is laid over; leave out flatten, write .usdc, and give sources=..., the "
            "time of the original that every frame shows"
        )
    check_up_axis(path, header)
    original = _original(path, header, flatten, onto)
    if whole_stage and not original:
        raise OutputError(
            f"{path} stands alone, without a stage that could be retimed; leave out whole_stage"
        )
    times = None if sources is None else source_times(header, sources)
    shown = shown_by(header, original.rate if original else header.fps, times if whole_stage else None)
    _, numbered = checked(header, blocks, velocities)

    def begun(file: Path) -> tuple[Sdf.Layer, Cast, Iterable[Frame]]:
        layer = Sdf.Layer.CreateNew(str(file))
        author_times(layer, header, shown, original)
        moving = velocities is not None
        cast = (
            lay_over(layer, path, original, shown, moving)
            if original
            else define_component(layer, path, header, moving)
        )
        declare(layer, cast)
        if original and whole_stage:
            retime_rest(layer, path, original, shown)
        elif original and times is not None:
            warn_of_rest(path, header, original, times)
        if parts is not None:
            define_parts(layer, [each.path for each in cast.meshes], _laid(parts, original))
        return layer, cast, frames(cast, shown.codes, header.times, numbered)

    elsewhere: list[str] = []
    with (
        new_folder(path) as folder,
        replacing(path) as temporary,
        quiet(),
        writing_usd(path),
    ):
        if packed:
            unpacked = temporary.with_suffix(".usdc")
            layer, _, samples = begun(unpacked)
            save(layer, samples)
            elsewhere = pack(layer, temporary, path.with_suffix(".usdc").name, folders_of(header, pack_from))
        elif clips:
            folder.make()
            save_in_clips(*begun(temporary), clips, folder)
            folder.install()
        else:
            layer, _, samples = begun(temporary)
            save(layer, samples)
    warn_of_unpacked(path, elsewhere)
    if not clips:
        folder.warn_if_unused()


def write_usd_parts(path: Path, header: SequenceHeader, parts: Parts) -> bool:
    """Write a layer over a sequence's original file that only adds parts; return whether that was possible."""
    original = _original(path, header, flatten=False, onto=None)
    if original is None:
        return False
    with replacing(path) as temporary, quiet(), writing_usd(path):
        layer = Sdf.Layer.CreateNew(str(temporary))
        author_times(layer, header, shown_by(header, original.rate), original)
        put_over(layer, path, original)
        define_parts(layer, [str(fit.mesh.GetPath()) for fit in original.fits], _laid(parts, original))
        save_layer(layer)
    return True


def check_up_axis(path: Path, header: SequenceHeader) -> None:
    """Raise an error for an up axis that USD does not support."""
    if header.up_axis == "X":
        raise OutputError(
            f"{path}: USD stages have Y or Z up, this mesh has X; turn it with convert_units (--convert-axes Y), or "
            "write .npz or .h5"
        )


def warn_of_unpacked(path: Path, files: list[str]) -> None:
    """Warn of files that `pack` left out."""
    if files:
        warn(
            f"{path}: what is no texture in the original's folder is not packed: {shortened(files)}; if textures "
            "may be shared, name their folder with pack_from=... (--pack-from)"
        )


def folders_of(header: SequenceHeader, pack_from: str | PathLike[str] | None = None) -> list[Path]:
    """Return the folders of textures that may be packed, and the file itself, which may be a package."""
    origin = header.surface.origin
    file = [Path(origin.path)] if origin and origin.format == "USD" else []
    return [*file, *(each.parent for each in file), *([] if pack_from is None else [Path(pack_from)])]


def _laid(parts: Parts, original: Original | None) -> Parts:
    """Return parts by the polygons of the file that they are laid over."""
    if original is None:
        return parts
    own = zip(parts.of_polygon, original.fits, strict=True)
    return replace(parts, of_polygon=tuple(of_polygon[fit.match.polygons] for of_polygon, fit in own))


def _check_options(packed: bool, flatten: bool, onto: object, clips: int, pack_from: object) -> None:
    if clips < 0:
        raise SettingsError(f"clips is {clips}; give the number of frames per file, or 0 for a single file")
    if onto is not None and flatten:
        raise SettingsError("a flattened USD file stands alone; leave out either onto or flatten")
    if packed and (onto is not None or clips):
        raise SettingsError("a .usdz file has everything in itself; leave out onto and clips, or write .usdc")
    if pack_from is not None and not packed:
        raise SettingsError("only .usdz files have textures packed; leave out pack_from, or write .usdz")


def _original(
    path: Path, header: SequenceHeader, flatten: bool, onto: str | PathLike[str] | None
) -> Original | None:
    """Return the file to lay the points over, None for a stand-alone file."""
    origin = header.surface.origin
    known = origin.path if origin and origin.format == "USD" else None
    if onto is None and known is None:
        return None
    file, packed = Path(onto or known or ""), path.suffix.lower() == ".usdz"
    named = is_gone(origin) and any(each.material for each in header.surface.face_sets)
    bare = ", and materials are written by name only" if named else ""
    if not flatten:
        check_not_needed(path, file)
    if flatten or packed:
        if is_gone(origin) and (bare or not flatten):
            warn(f"{path} stands alone: the original {file} is gone{bare}")
        elif not flatten:
            warn(
                f"{path} stands alone, as .usdz files do: only the mesh and its materials are kept of {file}"
            )
        return None
    try:
        with quiet():
            return open_original(file, header)
    except OutputError as error:
        if onto is not None:
            raise
        warn(f"{path} stands alone: {error}{bare}; onto=... (--onto) names the file where it is now")
        return None


def check_not_needed(path: Path, original: Path) -> None:
    """Raise an error if an original, or a layer that it uses, would be replaced."""
    if not path.exists():
        return
    stage = None
    with suppress(FormatError), quiet(), reading_usd(original):
        stage = open_stage(original)
    layers = stage.GetUsedLayers() if stage else []
    files = [Path(Ar.SplitPackageRelativePathOuter(each.realPath)[0]) for each in layers if each.realPath]
    if any(each.exists() and each.samefile(path) for each in (original, *files)):
        raise OutputError(
            f"{path} is the original, or a layer that it uses, and would be lost; write to another name"
        )
