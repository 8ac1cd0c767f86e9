"""What a file format is: what it can hold, and the functions that read and write it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mixseq.arrays import FloatArray
from mixseq.errors import SettingsError
from mixseq.frame_rates import exact_rate
from mixseq.sequence import SequenceHeader
from mixseq_io.isolation import loaded, open_isolated
from mixseq_io.reader import SequenceReader
from mixseq_io.rounding import Rounding

SINGLE = "float32"
OF_VERTICES, OPAQUE = "of vertices", "of vertices, opaque"


@dataclass(frozen=True, kw_only=True)
class Holds:
    """What a format has a place for; what it has none for is warned about when it is written.

    Parameters
    ----------
    animation : str
        The kinds of motion that are read.
    polygons : str
        Which polygons.
    points : str
        How exactly.
    times : str
        Which times of the frames.
    uvs, hard_edges, face_sets, objects, units, velocities : bool
        Texture coordinates; hard edges; named sets of polygons; several meshes; up axis and length of a unit;
        velocities of the vertices.
    colours : bool or str
        Colours, and of what, if not of corners.
    materials : str
        What becomes of materials.
    """

    animation: str
    polygons: str = "any"
    points: str = SINGLE
    times: str = "any"
    uvs: bool = True
    colours: bool | str = True
    hard_edges: bool = True
    face_sets: bool = True
    objects: bool = True
    units: bool = False
    velocities: bool = False
    materials: str = "names"


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    name : str
        Its name in messages.
    extensions : tuple of str
        Its extensions, all read and written, in lower case with the dot.
    holds : Holds
        What it has a place for.
    reader, writer : str
        ``"module:function"``, imported at first use. A reader is ``(path, **options) -> SequenceReader``, a
        writer ``(path, header, blocks, velocities, **options) -> None``.
    read_options, write_options : mapping of str to str
        The keyword options and what they mean.
    signatures : tuple of bytes
        What the files begin with, as far as there is something.
    numbered : bool
        Whether a file holds one frame, so that a sequence is a folder or a pattern of files.
    isolated : bool
        Whether files are parsed by a C++ library, which is kept in a process of its own, see `mixseq_io.isolation`.
    """

    name: str
    extensions: tuple[str, ...]
    holds: Holds
    reader: str
    writer: str
    read_options: Mapping[str, str] = field(default_factory=dict)
    write_options: Mapping[str, str] = field(default_factory=dict)
    signatures: tuple[bytes, ...] = ()
    numbered: bool = False
    isolated: bool = False

    def open(self, path: Path, **options: Any) -> SequenceReader:
        """Open a file for reading, see `mixseq_io.open_sequence`."""
        self._check_options("read", self.read_options, options)
        if options.get("fps") is not None:
            options["fps"] = exact_rate(options["fps"])
        if self.isolated:
            return open_isolated(self.reader, path, options)
        reader: SequenceReader = loaded(self.reader)(path, **options)
        return reader

    def write(
        self,
        path: Path,
        header: SequenceHeader,
        blocks: Iterable[FloatArray],
        velocities: Iterable[FloatArray] | None = None,
        **options: Any,
    ) -> None:
        """Write a file, see `mixseq_io.write_blocks`."""
        self._check_options("written", self.write_options, options)
        rounding = Rounding()
        if self.holds.points == SINGLE:
            blocks = rounding.watched(blocks)
        loaded(self.writer)(path, header, blocks, velocities, **options)
        rounding.warn(path, self.name, header)

    def _check_options(self, verb: str, known: Mapping[str, str], given: Mapping[str, Any]) -> None:
        for option in given:
            if option not in known:
                takes = "with " + ", ".join(known) if known else "without options"
                raise SettingsError(f"{self.name} has no option {option!r}; it is {verb} {takes}")
