"""The table of formats, and the functions that choose from it by file extension."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.sequence import FloatArray, MeshSequence, SequenceHeader, collect
from mixseq_io.reader import SequenceReader

PathLike = str | os.PathLike[str]


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    name : str
        Its name in messages.
    extensions : tuple of str
        Extensions that are read, in lower case with the dot.
    description : str
        One line: what it holds and how exactly.
    reader, writer : str
        ``"module:function"``, imported at first use. A reader is ``(path, **options) -> SequenceReader``, a
        writer ``(path, header, blocks, velocities, **options) -> None``, which warns if it has no place for velocities.
    read_options, write_options : mapping of str to str
        The keyword options and what they mean.
    unwritable : tuple of str
        Those of the extensions that are only read.
    signatures : tuple of bytes
        What the files begin with, as far as there is something.
    """

    name: str
    extensions: tuple[str, ...]
    description: str
    reader: str
    writer: str
    read_options: Mapping[str, str] = field(default_factory=dict)
    write_options: Mapping[str, str] = field(default_factory=dict)
    unwritable: tuple[str, ...] = ()
    signatures: tuple[bytes, ...] = ()

    def open(self, path: Path, **options: Any) -> SequenceReader:
        """Open a file for reading, see `open_sequence`."""
        self._check_options("read", self.read_options, options)
        reader: SequenceReader = _load(self.reader)(path, **options)
        return reader

    def write(
        self,
        path: Path,
        header: SequenceHeader,
        blocks: Iterable[FloatArray],
        velocities: Iterable[FloatArray] | None = None,
        **options: Any,
    ) -> None:
        """Write a file, see `write_blocks`."""
        self._check_options("written", self.write_options, options)
        _load(self.writer)(path, header, blocks, velocities, **options)

    def _check_options(self, verb: str, known: Mapping[str, str], given: Mapping[str, Any]) -> None:
        for option in given:
            if option not in known:
                takes = "with " + ", ".join(known) if known else "without options"
                raise SettingsError(f"{self.name} has no option {option!r}; it is {verb} {takes}")


def _load(reference: str) -> Callable[..., Any]:
    module, function = reference.split(":")
    loaded: Callable[..., Any] = getattr(import_module(module), function)
    return loaded


FORMATS: tuple[Format, ...] = (
    Format(
        name="USD",
        extensions=(".usd", ".usda", ".usdc", ".usdz"),
        description="one mesh with time-sampled points, float32; world space, polygons, velocities, times, units, up",
        reader="mixseq_io.usd_reader:open_usd",
        writer="mixseq_io.usd_writer:write_usd",
        read_options={"prim": "path of the mesh, or of a prim above it, where a stage has several"},
        unwritable=(".usdz",),
        signatures=(b"PXR-USDC", b"#usda", b"#sdf", b"PK\x03\x04"),
    ),
    Format(
        name="HDF5 sequence",
        extensions=(".h5", ".hdf5"),
        description="everything, float32 or float64, compressed, with checksums; models are sampled",
        reader="mixseq_io.sequence_h5:open_h5",
        writer="mixseq_io.sequence_h5:write_h5",
        signatures=(b"\x89HDF\r\n\x1a\n",),
    ),
    Format(
        name="npz",
        extensions=(".npz",),
        description="NumPy arrays, float32 or float64; points and faces, velocities and the rest optional",
        reader="mixseq_io.npz:open_npz",
        writer="mixseq_io.npz:write_npz",
        read_options={"fps": "frames per second, where the file has neither fps nor times; 24 by default"},
        write_options={"compress": "deflate the arrays (False by default: slow, and points hardly shrink)"},
        signatures=(b"PK\x03\x04",),
    ),
    Format(
        name="OBJ",
        extensions=(".obj",),
        description="numbered text files, one per frame (walk_####.obj); polygons, no times, velocities, units, up",
        reader="mixseq_io.obj:open_obj",
        writer="mixseq_io.obj:write_obj",
        read_options={
            "fps": "frames per second, 24 by default",
            "allow_gaps": "accept missing numbers; the frames keep the times of their numbers",
        },
        write_options={"start": "number of the first file, 1 by default"},
    ),
)

# What else users may have under a wrong name; only for messages.
_FOREIGN_SIGNATURES = {
    b"Ogawa": "Alembic",
    b"glTF": "glTF",
    b"ply": "PLY",
    b"POINTCACHE2": "PC2",
    b"Kaydara FBX": "FBX",
    b"BLENDER": "Blender",
}


def open_sequence(path: PathLike, **options: Any) -> SequenceReader:
    """Open a file for reading frame by frame.

    Parameters
    ----------
    path : path-like
        The file; numbered OBJ files by folder or by pattern: ``walk_####.obj``, ``walk_%04d.obj``,
        ``walk_*.obj``.
    **options
        The format's ``read_options``, see `FORMATS`.

    Returns
    -------
    SequenceReader
        A context manager with ``.header`` and ``.blocks(size)``.

    Raises
    ------
    FormatError
        If the file is missing, damaged, of another type, or too new.
    AmbiguousError
        If it holds several meshes; the message tells how to choose.
    InvalidSequenceError
        If what it holds is not a mesh sequence.
    SettingsError
        If the format has no such option.
    """
    file = Path(path)
    chosen = _format_to_read(file)
    if file.is_file():
        _check_signature(file, chosen)
    return chosen.open(file, **options)


def read(path: PathLike, **options: Any) -> MeshSequence:
    """Read a file into memory; parameters and errors are those of `open_sequence`."""
    with open_sequence(path, **options) as reader:
        velocities = reader.velocity_blocks()
        sequence = collect(reader.header, reader.blocks())
        if velocities is None:
            return sequence
        return replace(sequence, velocities=np.concatenate(list(velocities)))


def write(path: PathLike, sequence: MeshSequence, **options: Any) -> None:
    """Write a sequence; see `write_blocks`.

    Parameters
    ----------
    path : path-like
        The file; for several frames of OBJ a pattern, ``walk_####.obj``.
    sequence : MeshSequence
        What to write, with its velocities if it has any.
    **options
        The format's ``write_options``, see `FORMATS`.
    """
    velocities = None if sequence.velocities is None else [sequence.velocities]
    write_blocks(path, sequence.header, [sequence.points], velocities, **options)


def write_blocks(
    path: PathLike,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    **options: Any,
) -> None:
    """Write a sequence as its frames arrive.

    The file appears under its name when it is complete; until then, and after any error, an existing file
    stays as it was.

    Parameters
    ----------
    path : path-like
        The file.
    header : SequenceHeader
        Everything but the points.
    blocks : iterable of (B, V, 3) float
        The points, any number of frames at a time, all of one dtype.
    velocities : iterable of (B, V, 3) float, optional
        Velocities of the vertices in units per second, in blocks of the same sizes. A block of them is fetched
        after its block of points (`mixseq_io.in_step` splits pairs of both), and stored as precisely as points.
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
    extension = path.suffix.lower()
    if path.is_dir():
        extension = ".obj"  # the only format that reads folders
    for candidate in FORMATS:
        if extension in candidate.extensions:
            return candidate
    if not path.exists():
        raise FormatError(f"{path} does not exist")
    found = _recognised(path)
    holds = f"it holds {found} data" if found else "its contents are of no known format"
    raise FormatError(
        f"{path}: the extension {extension!r} is not known, and {holds}; known are {_extensions()}"
    )


def _format_to_write(path: Path) -> Format:
    extension = path.suffix.lower()
    for candidate in FORMATS:
        if extension in candidate.unwritable:
            raise OutputError(f"{path}: {extension} files are only read; write one of {_extensions(True)}")
        if extension in candidate.extensions:
            return candidate
    raise OutputError(f"{path}: the extension {extension!r} is not known; write one of {_extensions(True)}")


def _extensions(writable: bool = False) -> str:
    return ", ".join(
        extension
        for candidate in FORMATS
        for extension in candidate.extensions
        if not (writable and extension in candidate.unwritable)
    )


def _check_signature(path: Path, chosen: Format) -> None:
    """Say so if a file's contents are clearly of another format than its extension."""
    start = _start(path)
    if start.startswith(chosen.signatures):
        return
    found = _recognised(path)
    if found:
        raise FormatError(f"{path} holds {found} data, not {chosen.name}; give it the extension of {found}")


def _recognised(path: Path) -> str | None:
    """Name the format that a file's first bytes belong to."""
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
        return b""  # the reader will say what is wrong
