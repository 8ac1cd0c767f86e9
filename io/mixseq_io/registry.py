"""Define the table of formats, and read and write files by extension."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from mixseq.errors import (
    AmbiguousError,
    FormatError,
    InvalidSequenceError,
    MissingFileError,
    OutputError,
    SettingsError,
)
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence, join_blocks
from mixseq.types import FloatArray, PathLike
from mixseq_io.files import memory_limit
from mixseq_io.isolation import import_function, open_isolated
from mixseq_io.reader import SequenceReader, check_regular_file, prefix_errors
from mixseq_io.surfaces import RoundingMonitor

if TYPE_CHECKING:
    from mixseq.signals.model import Model

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of every HDF5 file."""

SINGLE_PRECISION = "float32"
PER_VERTEX, OPAQUE_PER_VERTEX = "of vertices", "of vertices, opaque"


@dataclass(frozen=True, kw_only=True)
class Capabilities:
    """Parts of a sequence that a format can store, as cells of the table of formats; writers warn of others."""

    animation: str
    polygons: str = "any"
    points: str = SINGLE_PRECISION
    times: str = "any"
    uvs: bool = True
    colours: bool | str = True  # a text if colours are stored per vertex instead of per corner
    hard_edges: bool = True
    face_sets: bool = True
    objects: bool = True
    units: bool = False
    velocities: bool = False
    materials: str = "names"


@dataclass(frozen=True)
class Format:
    """File format: name in messages, lower-case extensions, capabilities, options, reader and writer.

    `reader` and `writer` are ``"module:function"``, imported at first use: ``(path, **options) -> SequenceReader`` and
    ``(path, header, blocks, velocities, **options) -> None``. `signatures` are possible first bytes of files. Writers
    of formats that `has_nodes` also get ``rounding``, see `RoundingMonitor`. `numbered` formats store one frame per
    file. `isolated` formats are read in a worker, see `mixseq_io.isolation`.
    """

    name: str
    extensions: tuple[str, ...]
    capabilities: Capabilities
    reader: str
    writer: str
    read_options: Mapping[str, str] = field(default_factory=dict)
    write_options: Mapping[str, str] = field(default_factory=dict)
    signatures: tuple[bytes, ...] = ()
    has_nodes: bool = False
    numbered: bool = False
    isolated: bool = False

    def open(self, path: Path, **options: Any) -> SequenceReader:
        """Open a file for reading; see `mixseq_io.open_sequence`."""
        self._check_options("read", self.read_options, options)
        fps = options.get("fps")
        if fps is not None:
            if not 0 < fps < inf:
                raise SettingsError(f"fps is {fps}; a positive number is expected")
            options["fps"] = snap_to_ntsc(fps)
        if self.isolated:
            return open_isolated(self.reader, path, options)
        reader: SequenceReader = import_function(self.reader)(path, **options)
        return reader

    def write(
        self,
        path: Path,
        header: SequenceHeader,
        blocks: Iterable[FloatArray],
        velocities: Iterable[FloatArray] | None = None,
        **options: Any,
    ) -> None:
        """Write a file; see `mixseq_io.write_blocks`."""
        self._check_options("written", self.write_options, options)
        sources = options.get("sources")
        if sources is not None and np.shape(sources) != header.times.shape:
            raise SettingsError(
                f"sources are {np.size(sources)} times for {header.frame_count} frames; give one for every frame"
            )
        rounding = RoundingMonitor(path, self.name, header)
        if self.capabilities.points == SINGLE_PRECISION:
            blocks = rounding.watch(blocks, self.has_nodes)
        if self.has_nodes:
            options["rounding"] = rounding
        import_function(self.writer)(path, header, blocks, velocities, **options)
        rounding.warn()

    def _check_options(self, verb: str, known: Mapping[str, str], options: Mapping[str, Any]) -> None:
        for option in options:
            if option not in known:
                takes = "with " + ", ".join(known) if known else "without options"
                raise SettingsError(f"{self.name} has no option {option!r}; it is {verb} {takes}")


_FPS_OPTION = "frames per second, 24 by default"
_GAPS_OPTION = "accept missing numbers; the frames keep the times of their numbers"
_START_OPTION = "number of the first file, by default that of the first frame"
_MESH_OPTION = "file of the mesh; by default one of the same name beside it"
_PRIM_OPTION = "path of a mesh or of its parent; / reads all meshes, by default all that move are read"
_FLATTEN_OPTION = "write a stand-alone file instead of one that builds on the original"
_SOURCES_OPTION = "times in the original that the frames show, if they differ from the frames' own"
_ONTO_OPTION = "the file to build on, by default the original"

_BARE_MESH: dict[str, Any] = {"hard_edges": False, "face_sets": False, "objects": False, "materials": "no"}
_TRIANGLE_MESH = _BARE_MESH | {"polygons": "triangles", "uvs": False}


def _numbered_format(name: str, module: str, *signatures: bytes, **capabilities: Any) -> Format:
    """Return the format of numbered files that the object ``<name>_FORMAT`` in `mixseq_io.numbered` implements."""
    return Format(
        name=name,
        extensions=(f".{name.lower()}",),
        capabilities=Capabilities(animation="a file per frame", times="no", **capabilities),
        reader=f"mixseq_io.numbered.{module}:{name}_FORMAT.open",
        writer=f"mixseq_io.numbered.{module}:{name}_FORMAT.write",
        read_options={"fps": _FPS_OPTION, "allow_gaps": _GAPS_OPTION},
        write_options={"start": _START_OPTION},
        signatures=signatures,
        numbered=True,
    )


FORMATS: tuple[Format, ...] = (
    Format(
        name="USD",
        has_nodes=True,
        extensions=(".usd", ".usda", ".usdc", ".usdz"),
        capabilities=Capabilities(
            animation="point samples, transforms, skeletons, blend shapes, value clips",
            units=True,
            velocities=True,
            materials="carried along",
        ),
        reader="mixseq_io.usd.reader:open_usd",
        writer="mixseq_io.usd.writer:write_usd",
        read_options={"prim": _PRIM_OPTION},
        write_options={
            "flatten": _FLATTEN_OPTION,
            "onto": _ONTO_OPTION,
            "clips": "frames per file of value clips, for long shots; 0, the default, keeps all in one file",
            "pack_from": "folder from which textures may be packed into .usdz, besides that of the original",
            "sources": _SOURCES_OPTION,
            "whole_stage": "retime all other motion of the original by sources, too",
        },
        signatures=(b"PXR-USDC", b"#usda", b"#sdf", b"PK\x03\x04"),
        isolated=True,
    ),
    Format(
        name="HDF5 sequence",
        extensions=(".h5", ".hdf5"),
        capabilities=Capabilities(
            animation="point samples, models", points="float32, float64", units=True, velocities=True
        ),
        reader="mixseq_io.model_files:open_h5",
        writer="mixseq_io.hdf5.sequences:write_h5",
        signatures=(HDF5_SIGNATURE,),
    ),
    Format(
        name="Alembic",
        has_nodes=True,
        extensions=(".abc",),
        capabilities=Capabilities(animation="point samples, transforms", velocities=True, materials="carried along"),
        reader="mixseq_io.alembic.reader:open_alembic",
        writer="mixseq_io.alembic.writer:write_alembic",
        read_options={"prim": _PRIM_OPTION},
        write_options={"flatten": _FLATTEN_OPTION, "onto": _ONTO_OPTION, "sources": _SOURCES_OPTION},
        signatures=(b"Ogawa", HDF5_SIGNATURE),
        isolated=True,
    ),
    Format(
        name="glTF",
        has_nodes=True,
        extensions=(".glb", ".gltf"),
        capabilities=Capabilities(
            animation="skins, morph targets, transforms, compressed models",
            polygons="triangles",
            times="float32, from 0 on",
            materials="carried along",
        ),
        reader="mixseq_io.model_files:open_gltf",
        writer="mixseq_io.gltf.writer:write_gltf",
        read_options={
            "prim": _PRIM_OPTION,
            "animation": "name or number of the animation, the first by default",
            "fps": "frames per second; by default the frames are the animation's keys",
        },
        write_options={
            "flatten": _FLATTEN_OPTION,
            "onto": _ONTO_OPTION,
            "keep_start": "start the animation at the time of the first frame instead of 0",
            "sources": _SOURCES_OPTION,
        },
        signatures=(b"glTF",),
    ),
    Format(
        name="npz",
        extensions=(".npz",),
        capabilities=Capabilities(animation="point samples", points="float32, float64", units=True, velocities=True),
        reader="mixseq_io.npz:open_npz",
        writer="mixseq_io.npz:write_npz",
        read_options={"fps": "frames per second, where the file has neither fps nor times; 24 by default"},
        write_options={"compress": "deflate the arrays (False by default: slow, and points hardly shrink)"},
        signatures=(b"PK\x03\x04",),
    ),
    Format(
        name="PC2",
        extensions=(".pc2",),
        capabilities=Capabilities(animation="point samples", times="even, no frame rate", colours=OPAQUE_PER_VERTEX),
        reader="mixseq_io.point_caches:open_pc2",
        writer="mixseq_io.point_caches:write_pc2",
        read_options={"mesh": _MESH_OPTION, "fps": _FPS_OPTION},
        signatures=(b"POINTCACHE2\x00",),
    ),
    Format(
        name="MDD",
        extensions=(".mdd",),
        capabilities=Capabilities(animation="point samples", times="float32", colours=OPAQUE_PER_VERTEX),
        reader="mixseq_io.point_caches:open_mdd",
        writer="mixseq_io.point_caches:write_mdd",
        read_options={"mesh": _MESH_OPTION},
    ),
    _numbered_format("OBJ", "obj", points="all digits", colours=OPAQUE_PER_VERTEX),
    _numbered_format("PLY", "ply", b"ply", points="float32, float64", **_BARE_MESH),
    _numbered_format("STL", "stl_off", **_TRIANGLE_MESH, colours=False),
    _numbered_format("OFF", "stl_off", b"OFF", b"COFF", points="all digits", **_TRIANGLE_MESH, colours=PER_VERTEX),
)


def capability_table() -> list[tuple[str, ...]]:
    """Return the capabilities of all formats as a table: a row of titles, then a row per format."""
    columns = [column.name for column in fields(Capabilities) if column.name != "animation"]
    table = [("format", "reads", "writes", *(column.replace("_", " ") for column in columns))]
    for file_format in FORMATS:
        extensions = " ".join(file_format.extensions)
        values = (getattr(file_format.capabilities, column) for column in columns)
        cells = ({True: "yes", False: "no"}.get(value, value) for value in values)
        table.append((file_format.name, extensions, extensions, *cells))
    return table


def motion_table() -> list[tuple[str, ...]]:
    """Return a table like `capability_table` with the kinds of animation that formats read, and their options."""
    titles = ("format", "motion that is read", "options for reading", "options for writing")
    rows = [
        (each.name, each.capabilities.animation, ", ".join(each.read_options), ", ".join(each.write_options))
        for each in FORMATS
    ]
    return [titles, *rows]


_FOREIGN_SIGNATURES = {b"Kaydara FBX": "FBX", b"BLENDER": "Blender"}
"""First bytes of formats that mixseq cannot read, which messages mention by name."""

_SIGNATURE_BYTES = 16


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
        The file. Numbered files (OBJ, PLY, STL, OFF) are given by a folder or a pattern: ``walk_####.obj``,
        ``walk_%04d.obj``, ``walk_*.obj``.
    up_axis : {"X", "Y", "Z"}, optional
        Axis that points up, if the file has no up axis or a wrong up axis. Points are unchanged.
    metres_per_unit : float, optional
        Length of a unit in metres, if the file has no unit or a wrong unit. Points are unchanged.
    start_frame : float, optional
        Number of the first frame; all times are shifted accordingly, see `mixseq.sequence.frame_rates`.
    max_memory : float, optional
        Memory limit of one read in bytes; by default 8 GB or half of the machine's memory, whichever is less
        (`mixseq_io.files`).
    **options
        The format's ``read_options``, see `FORMATS`.

    Returns
    -------
    SequenceReader
        A context manager with ``.header`` and ``.blocks(size)``.

    Raises
    ------
    FormatError
        If the file is missing or damaged, has another type or a newer version, or needs more than `max_memory`.
    AmbiguousError
        If the file holds several sequences; the message explains how to choose one.
    InvalidSequenceError
        If the contents are not a mesh sequence.
    SettingsError
        If the format has no such option, or `start_frame` is not finite.

    Examples
    --------
    >>> import mixseq
    >>> with mixseq.open_sequence("arm.usdc") as reader:
    ...     [block.shape for block in reader.blocks(3)]
    [(3, 77, 3), (1, 77, 3)]
    """
    file = Path(path)
    check_regular_file(file, "a file")
    file_format = _format_to_read(file)
    with memory_limit(max_memory):
        reader = file_format.open(file, **options)
    overrides: dict[str, Any] = {"up_axis": up_axis, "metres_per_unit": metres_per_unit}
    overrides = {name: value for name, value in overrides.items() if value is not None}
    try:
        with prefix_errors(file):
            reader.header = replace(reader.header, **overrides)
            if start_frame is not None:
                reader.header = reader.header.numbered_from(start_frame)
    except (InvalidSequenceError, SettingsError):
        reader.close()
        raise
    return reader


@public
def read(path: PathLike, **options: Any) -> MeshSequence:
    """Read a file into memory; parameters and errors are those of `open_sequence`.

    Rigs are baked to points of the frames; only open files have other times (`SequenceReader.blocks_at`).

    Examples
    --------
    >>> import mixseq
    >>> mixseq.read("arm.usdc")
    MeshSequence('bar': 4 frames, 77 vertices, 150 faces, 10 fps)
    """
    with open_sequence(path, **options) as reader:
        reader.check_total_memory()
        velocities = reader.velocity_blocks()
        sequence = join_blocks(reader.header, reader.blocks())
        if velocities is None:
            return sequence
        return replace(sequence, velocities=np.concatenate(list(velocities)))


@public
def write(path: PathLike, sequence: FileOr[MeshSequence | Model], **options: Any) -> None:
    """Write a sequence or the frames of a model; errors and warnings are those of `write_blocks`.

    Parameters
    ----------
    path : path-like
        The file, or a pattern such as ``walk_####.obj`` for several frames of OBJ, PLY, STL or OFF.
    sequence : MeshSequence or Model
        The sequence, written with its velocities if it has any, or a model, sampled at its frames.
    **options
        The format's ``write_options``, see `FORMATS`.

    Examples
    --------
    >>> import mixseq
    >>> mixseq.write("arm.npz", mixseq.read("arm.usdc"))
    """
    sequence = cast("MeshSequence | Model", sequence)
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
    """Write a sequence block by block.

    The file gets its final name when it is complete. After an error, an existing file is unchanged.

    Parameters
    ----------
    path : path-like
        The file, or a pattern as in `write`.
    header : SequenceHeader
        Faces, times, units and surface of the sequence.
    blocks : iterable of (B, V, 3) float
        Points, in blocks of any number of frames and of one dtype.
    velocities : iterable of (B, V, 3) float, optional
        Velocities of the vertices in units per second, in blocks of the same sizes, stored in the points' precision.
        Each block of velocities is fetched after its block of points; `mixseq_io.unzip_blocks` splits pairs of blocks.
    **options
        The format's ``write_options``, see `FORMATS`.

    Raises
    ------
    OutputError
        If the file cannot be written: missing folder, no permission, disk full, unknown format.
    InvalidSequenceError
        If the blocks do not fit the header or the velocities, or the format cannot store their values.
    SettingsError
        If the format has no such option.

    Warns
    -----
    MixseqWarning
        If the format cannot store a part of the sequence, for example velocities.

    Examples
    --------
    >>> import mixseq
    >>> with mixseq.open_sequence("arm.usdc") as reader:
    ...     mixseq.write_blocks("copy.npz", reader.header, reader.blocks())
    """
    file = Path(path)
    file_format = _find_format(file)
    if file_format is None:
        raise OutputError(f"{file}: the extension {file.suffix.lower()!r} is not known; write one of {_extensions()}")
    file_format.write(file, header, blocks, velocities, **options)


def _format_to_read(path: Path) -> Format:
    """Return the format of a file's extension; raise an error if its first bytes belong to another one."""
    if path.is_dir():
        return _format_of_folder(path)
    file_format = _find_format(path)
    if file_format is None and not path.exists():
        raise MissingFileError(f"{path} does not exist")
    try:
        with path.open("rb") as file:
            signature = file.read(_SIGNATURE_BYTES)
    except OSError:
        signature = b""  # the reader reports the error
    name = _detect_format_name(signature)
    if file_format is None:
        contents = f"it holds {name} data" if name else "its contents are of no known format"
        raise FormatError(
            f"{path}: the extension {path.suffix.lower()!r} is not known, and {contents}; known are {_extensions()}"
        )
    if name and not signature.startswith(file_format.signatures):
        raise FormatError(f"{path} holds {name} data, not {file_format.name}; give it the extension of {name}")
    return file_format


def _format_of_folder(folder: Path) -> Format:
    """Return the format of the numbered files in a folder."""
    extensions = {file.suffix.lower() for file in folder.iterdir() if not file.name.startswith(".")}
    candidates = [each for each in FORMATS if each.numbered]
    present = [each for each in candidates if extensions & set(each.extensions)]
    if len(present) > 1:
        names = " and ".join(each.name for each in present)
        raise AmbiguousError(
            f"{folder} holds {names} files; give a pattern such as {folder}/*{present[0].extensions[0]}"
        )
    if not present:
        names = ", ".join(each.name for each in candidates)
        raise FormatError(f"{folder} is a folder without numbered files; {names} files are expected in it")
    return present[0]


def _find_format(path: Path) -> Format | None:
    return next((each for each in FORMATS if path.suffix.lower() in each.extensions), None)


def _extensions() -> str:
    return ", ".join(extension for each in FORMATS for extension in each.extensions)


def _detect_format_name(signature: bytes) -> str | None:
    """Return the name of the format to which the first bytes of a file belong."""
    for file_format in FORMATS:
        if signature.startswith(file_format.signatures):
            return "zip (npz or usdz)" if signature.startswith(b"PK") else file_format.name
    return next((name for start, name in _FOREIGN_SIGNATURES.items() if signature.startswith(start)), None)
