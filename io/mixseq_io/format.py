"""Describe file formats by their capabilities and by the functions that read and write them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mixseq.errors import SettingsError
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.isolation import import_function, open_isolated
from mixseq_io.reader import SequenceReader
from mixseq_io.surfaces import RoundingMonitor

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of every HDF5 file."""

SINGLE_PRECISION = "float32"
PER_VERTEX, OPAQUE_PER_VERTEX = "of vertices", "of vertices, opaque"


@dataclass(frozen=True, kw_only=True)
class Capabilities:
    """Parts of a sequence that a format can store, which are shown as cells of the table of formats.

    `colours` is a text if colours are stored per vertex instead of per corner. `materials` is "names" if only the names
    of materials are stored. Writers warn of parts that their format cannot store.
    """

    animation: str
    polygons: str = "any"
    points: str = SINGLE_PRECISION
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
        if options.get("fps") is not None:
            options["fps"] = snap_to_ntsc(options["fps"])
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
