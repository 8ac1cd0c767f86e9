"""Table of formats, and reading and writing by file extension."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, OutputError, SettingsError
from mixseq.runtime.public import public
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence, collect
from mixseq.types import FloatArray, PathLike
from mixseq_io.files import memory_limit
from mixseq_io.format import HDF5_SIGNATURE, OPAQUE_PER_VERTEX, PER_VERTEX, Capabilities, Format
from mixseq_io.reader import SequenceReader, check_regular_file, prefix_errors

if TYPE_CHECKING:
    from mixseq.signals.model import Model


_FPS = "frames per second, 24 by default"
_GAPS = "accept missing numbers; the frames keep the times of their numbers"
_START = "number of the first file, by default that of the first frame"
_MESH = "file of the mesh; by default one of the same name beside it"
_PRIM = "path of a mesh or of something above it; / takes all meshes, by default all that move are taken"
_FLATTEN = "write a file that stands alone, not one that builds on the file that the sequence came from"
_SOURCES = "times of the original that the frames show, where these are others than their own"
_ONTO = "the file to build on, if it is another one than the sequence came from"


_NO_PARTS: dict[str, Any] = {"hard_edges": False, "face_sets": False, "objects": False, "materials": "no"}


def _numbered(name: str, module: str, *signatures: bytes, **holds: Any) -> Format:
    """Return a format of numbered files, an object of this name in a module of `mixseq_io.numbered`."""
    return Format(
        name=name,
        extensions=(f".{name.lower()}",),
        holds=Capabilities(animation="a file per frame", times="no", **holds),
        reader=f"mixseq_io.numbered.{module}:{name}.open",
        writer=f"mixseq_io.numbered.{module}:{name}.write",
        read_options={"fps": _FPS, "allow_gaps": _GAPS},
        write_options={"start": _START},
        signatures=signatures,
        numbered=True,
    )


FORMATS: tuple[Format, ...] = (
    Format(
        name="USD",
        extensions=(".usd", ".usda", ".usdc", ".usdz"),
        holds=Capabilities(
            animation="point samples, transforms, skeletons, blend shapes, value clips",
            units=True,
            velocities=True,
            materials="carried along",
        ),
        reader="mixseq_io.usd.reader:open_usd",
        writer="mixseq_io.usd.writer:write_usd",
        read_options={"prim": _PRIM},
        write_options={
            "flatten": _FLATTEN,
            "onto": _ONTO,
            "clips": "frames per file of value clips, for long shots; 0, the default, keeps all in one file",
            "pack_from": "folder from which textures may be packed into .usdz, besides that of the original",
            "sources": _SOURCES,
            "whole_stage": "retime everything else that moves in the original, too, by sources",
        },
        signatures=(b"PXR-USDC", b"#usda", b"#sdf", b"PK\x03\x04"),
        isolated=True,
    ),
    Format(
        name="HDF5 sequence",
        extensions=(".h5", ".hdf5"),
        holds=Capabilities(
            animation="point samples, models", points="float32, float64", units=True, velocities=True
        ),
        reader="mixseq_io.loading:open_h5",
        writer="mixseq_io.hdf5.sequences:write_h5",
        signatures=(HDF5_SIGNATURE,),
    ),
    Format(
        name="Alembic",
        extensions=(".abc",),
        holds=Capabilities(animation="point samples, transforms", velocities=True, materials="carried along"),
        reader="mixseq_io.alembic.reader:open_alembic",
        writer="mixseq_io.alembic.writer:write_alembic",
        read_options={"prim": _PRIM},
        write_options={"flatten": _FLATTEN, "onto": _ONTO, "sources": _SOURCES},
        signatures=(b"Ogawa", HDF5_SIGNATURE),
        isolated=True,
    ),
    Format(
        name="glTF",
        extensions=(".glb", ".gltf"),
        holds=Capabilities(
            animation="skins, morph targets, transforms, compressed models",
            polygons="triangles",
            times="float32, from 0 on",
            materials="carried along",
        ),
        reader="mixseq_io.loading:open_gltf",
        writer="mixseq_io.gltf.writer:write_gltf",
        read_options={
            "prim": _PRIM,
            "animation": "name or number of the animation, the first by default",
            "fps": "frames per second; by default the frames are the animation's keys",
        },
        write_options={
            "flatten": _FLATTEN,
            "onto": _ONTO,
            "keep_start": "let the animation begin when the sequence does, and not at 0",
            "sources": _SOURCES,
        },
        signatures=(b"glTF",),
    ),
    Format(
        name="npz",
        extensions=(".npz",),
        holds=Capabilities(animation="point samples", points="float32, float64", units=True, velocities=True),
        reader="mixseq_io.npz:open_npz",
        writer="mixseq_io.npz:write_npz",
        read_options={"fps": "frames per second, where the file has neither fps nor times; 24 by default"},
        write_options={"compress": "deflate the arrays (False by default: slow, and points hardly shrink)"},
        signatures=(b"PK\x03\x04",),
    ),
    Format(
        name="PC2",
        extensions=(".pc2",),
        holds=Capabilities(animation="point samples", times="even, rate not told", colours=OPAQUE_PER_VERTEX),
        reader="mixseq_io.point_caches:open_pc2",
        writer="mixseq_io.point_caches:write_pc2",
        read_options={"mesh": _MESH, "fps": _FPS},
        signatures=(b"POINTCACHE2\x00",),
    ),
    Format(
        name="MDD",
        extensions=(".mdd",),
        holds=Capabilities(animation="point samples", times="float32", colours=OPAQUE_PER_VERTEX),
        reader="mixseq_io.point_caches:open_mdd",
        writer="mixseq_io.point_caches:write_mdd",
        read_options={"mesh": _MESH},
    ),
    _numbered("OBJ", "obj", points="all digits", colours=OPAQUE_PER_VERTEX),
    _numbered("PLY", "ply", b"ply", points="float32, float64", **_NO_PARTS),
    _numbered("STL", "stl_off", polygons="triangles", uvs=False, colours=False, **_NO_PARTS),
    _numbered(
        "OFF",
        "stl_off",
        b"OFF",
        b"COFF",
        polygons="triangles",
        points="all digits",
        uvs=False,
        colours=PER_VERTEX,
        **_NO_PARTS,
    ),
)


def capability_table() -> list[tuple[str, ...]]:
    """Return the formats' capabilities as a table: a row of titles, then a row per format."""
    columns = [column.name for column in fields(Capabilities) if column.name != "animation"]
    titles = ("format", "reads", "writes", *(column.replace("_", " ") for column in columns))
    rows = [
        (
            form.name,
            " ".join(form.extensions),
            " ".join(form.extensions),
            *(
                {True: "yes", False: "no"}.get(held := getattr(form.holds, column), held)
                for column in columns
            ),
        )
        for form in FORMATS
    ]
    return [titles, *rows]


def motion_table() -> list[tuple[str, ...]]:
    """Return the kinds of motion that are read, and the options, as a table like `capability_table`."""
    titles = ("format", "motion that is read", "options for reading", "options for writing")
    rows = [
        (form.name, form.holds.animation, ", ".join(form.read_options), ", ".join(form.write_options))
        for form in FORMATS
    ]
    return [titles, *rows]


# Other formats that users may have under a wrong name; only for messages.
_FOREIGN_SIGNATURES = {
    b"Kaydara FBX": "FBX",
    b"BLENDER": "Blender",
}


@public
def open_sequence(
    path: PathLike,
    *,
    up_axis: str | None = None,
    metres_per_unit: float | None = None,
    start_frame: float | None = None,
    max_memory: float | None = None,
    **options: Any,
) -> SequenceReader:
    """Open a file for reading frame by frame.

    Parameters
    ----------
    path : path-like
        The file; numbered files (OBJ, PLY, STL, OFF) by folder or by pattern: ``walk_####.obj``,
        ``walk_%04d.obj``, ``walk_*.obj``.
    up_axis : {"X", "Y", "Z"}, optional
        Which axis points up, where the file lacks it or is wrong. Points stay as they are.
    metres_per_unit : float, optional
        Length of a unit, likewise.
    start_frame : float, optional
        Number of the first frame, likewise; times are shifted to match, see `mixseq.sequence.frame_rates`.
    max_memory : float, optional
        Bytes that one read may take; by default 8 GB, or half of the machine's memory if that is less,
        see `mixseq_io.files`.
    **options
        The format's ``read_options``, see `FORMATS`.

    Returns
    -------
    SequenceReader
        A context manager with ``.header`` and ``.blocks(size)``.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another type, or too new, or takes more than `max_memory`.
    AmbiguousError
        If there are several sequences; the message explains how to choose.
    InvalidSequenceError
        If its contents are not a mesh sequence.
    SettingsError
        If the format has no such option, or `start_frame` is not finite.
    """
    file = Path(path)
    check_regular_file(file, "a file")
    chosen = _format_to_read(file)
    if file.is_file():
        _check_signature(file, chosen)
    with memory_limit(max_memory):
        reader = chosen.open(file, **options)
    told: dict[str, Any] = {"up_axis": up_axis, "metres_per_unit": metres_per_unit}
    try:
        with prefix_errors(file):
            reader.header = replace(
                reader.header, **{key: value for key, value in told.items() if value is not None}
            )
            if start_frame is not None:
                reader.header = reader.header.numbered_from(start_frame)
    except (InvalidSequenceError, SettingsError):
        reader.close()
        raise
    return reader


@public
def read(path: PathLike, **options: Any) -> MeshSequence:
    """Read a file into memory; parameters and errors are those of `open_sequence`."""
    with open_sequence(path, **options) as reader:
        reader.check_whole()
        velocities = reader.velocity_blocks()
        sequence = collect(reader.header, reader.blocks())
        if velocities is None:
            return sequence
        return replace(sequence, velocities=np.concatenate(list(velocities)))


@public
def write(path: PathLike, sequence: MeshSequence | Model, **options: Any) -> None:
    """Write a sequence; see `write_blocks`.

    Parameters
    ----------
    path : path-like
        The file; for several frames of OBJ, PLY, STL or OFF a pattern, ``walk_####.obj``.
    sequence : MeshSequence or Model
        The sequence with its velocities, if any, or the model whose frames are written.
    **options
        The format's ``write_options``, see `FORMATS`.
    """
    if not isinstance(sequence, MeshSequence):
        sequence = sequence.sample()
    velocities = None if sequence.velocities is None else [sequence.velocities]
    write_blocks(path, sequence.header, [sequence.points], velocities, **options)


@public
def write_blocks(
    path: PathLike,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    **options: Any,
) -> None:
    """Write a sequence as its frames arrive.

    The file appears under its name when complete. Until then, and after any error, an existing file is unchanged.

    Parameters
    ----------
    path : path-like
        The file.
    header : SequenceHeader
        Everything but the points.
    blocks : iterable of (B, V, 3) float
        The points, any number of frames at a time, all of one dtype.
    velocities : iterable of (B, V, 3) float, optional
        Velocities of the vertices in units per second, in blocks of the same sizes, stored in the points' precision.
        Each block is fetched after its block of points (`mixseq_io.unzip_blocks` splits pairs of both).
    **options
        The format's ``write_options``, see `FORMATS`.

    Raises
    ------
    OutputError
        If the file cannot be written: no such folder, no permission, disk full, no such format.
    InvalidSequenceError
        If the blocks do not fit the header or the velocities, or the format cannot hold their values.
    SettingsError
        If the format has no such option.

    Warns
    -----
    MixseqWarning
        If the format cannot hold something, for example velocities.
    """
    file = Path(path)
    _format_to_write(file).write(file, header, blocks, velocities, **options)


def _format_to_read(path: Path) -> Format:
    if path.is_dir():
        return _format_of_folder(path)
    if known := _by_extension(path):
        return known
    if not path.exists():
        raise FormatError(f"{path} does not exist")
    found = _recognised(path)
    holds = f"it holds {found} data" if found else "its contents are of no known format"
    raise FormatError(
        f"{path}: the extension {path.suffix.lower()!r} is not known, and {holds}; known are {_extensions()}"
    )


def _format_of_folder(path: Path) -> Format:
    """Return the format of the numbered files in a folder."""
    present = {file.suffix.lower() for file in path.iterdir() if not file.name.startswith(".")}
    numbered = [each for each in FORMATS if each.numbered]
    found = [each for each in numbered if present & set(each.extensions)]
    if len(found) > 1:
        names = " and ".join(each.name for each in found)
        raise AmbiguousError(
            f"{path} holds {names} files; give a pattern such as {path}/*{found[0].extensions[0]}"
        )
    if not found:
        names = ", ".join(each.name for each in numbered)
        raise FormatError(f"{path} is a folder without numbered files; {names} files are expected in it")
    return found[0]


def _format_to_write(path: Path) -> Format:
    if known := _by_extension(path):
        return known
    raise OutputError(
        f"{path}: the extension {path.suffix.lower()!r} is not known; write one of {_extensions()}"
    )


def _by_extension(path: Path) -> Format | None:
    return next((each for each in FORMATS if path.suffix.lower() in each.extensions), None)


def _extensions() -> str:
    return ", ".join(extension for candidate in FORMATS for extension in candidate.extensions)


def _check_signature(path: Path, chosen: Format) -> None:
    """Raise an error if a file's first bytes belong to another format than its extension."""
    start = _start(path)
    if start.startswith(chosen.signatures):
        return
    found = _recognised(path)
    if found:
        raise FormatError(f"{path} holds {found} data, not {chosen.name}; give it the extension of {found}")


def _recognised(path: Path) -> str | None:
    """Return the name of the format that a file's first bytes belong to."""
    start = _start(path)
    for candidate in FORMATS:
        if start.startswith(candidate.signatures):
            return "zip (npz or usdz)" if start.startswith(b"PK") else candidate.name
    for signature, name in _FOREIGN_SIGNATURES.items():
        if start.startswith(signature):
            return name
    return None


def _start(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(16)
    except OSError:
        return b""  # the reader reports the error
