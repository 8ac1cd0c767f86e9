"""Readers in a process of their own, for formats that are parsed by C++ libraries.

Damaged files can make these libraries crash, hang, or take all memory, which cannot be caught in the same process.
Readers run in a reused worker (`mixseq_io.worker`), a second Python with limits on memory (`mixseq_io.memory`) and on
time per answer; its death is reported as an error of the file. ``MIXSEQ_READER_SECONDS`` sets the limit of time: by
default 120 s of processor time, and four times that by the clock.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

from mixseq.arrays import FloatArray
from mixseq.sequence import SequenceHeader
from mixseq_io.labels.markings import Markings
from mixseq_io.memory import max_memory
from mixseq_io.reader import SequenceReader
from mixseq_io.worker_pool import OpenFile, dismiss, hire


def open_isolated(reader: str, path: Path, options: dict[str, Any]) -> SequenceReader:
    """Open a file in a worker, or in this process where none can be started."""
    if not can_isolate():
        reader_here: SequenceReader = loaded(reader)(path, **options)
        return reader_here
    with ExitStack() as resources:
        file = OpenFile(path, reader, options)
        resources.callback(file.close)
        header, moving = file.opened
        return _IsolatedReader(path, _frozen(header), file, resources.pop_all(), moving)


def call_isolated(
    function: str, path: Path, *arguments: Any, meanwhile: Callable[[], object] | None = None
) -> Any:
    """Call a function of a file in a worker and return its value; arguments and errors as in `open_isolated`."""
    if not can_isolate():
        return loaded(function)(path, *arguments)
    worker = hire()
    try:
        question = "call", function, str(path), arguments, str(Path.cwd()), max_memory()
        return worker.ask(path, *question, meanwhile=meanwhile)
    finally:
        dismiss(worker)


clocks: list[Callable[[float], None]] = []
"""Functions that limit time in this process, if it is a worker."""


def limit_time(share: float) -> None:
    """Restart the clock of an answer with a share of the time limit; does nothing outside of a worker."""
    for start in clocks:
        start(share)


def loaded(reference: str) -> Callable[..., Any]:
    """Return the function named ``"module:function"`` or ``"module:object.method"``."""
    module, function = reference.split(":")
    found: Callable[..., Any] = attrgetter(function)(import_module(module))
    return found


def can_isolate() -> bool:
    """Whether a second Python can be started; applications that embed Python have no executable for it."""
    return "python" in Path(sys.executable or "").name.lower()


class _IsolatedReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, file: OpenFile, resources: ExitStack, moving: bool
    ) -> None:
        super().__init__(path, header, resources, moving)
        self._file = file

    def markings(self) -> Markings:
        """Return the sets of polygons and the joints of the mesh."""
        self._check_open()
        found: Markings = self._file.ask("markings")
        return found

    def _check_process(self) -> None:
        """Do nothing: a forked process opens the file again, in a worker of its own."""

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        return self._file.iterate("points", size)

    def _read_velocities(self, size: int) -> Iterator[FloatArray]:
        return self._file.iterate("velocities", size)


def _frozen(header: SequenceHeader) -> SequenceHeader:
    """Return a header received from a worker with read-only arrays."""
    surface = header.surface
    return replace(
        header,
        polygons=replace(header.polygons),
        surface=replace(
            surface,
            uvs=surface.uvs and replace(surface.uvs),
            colours=surface.colours and replace(surface.colours),
            face_sets=tuple(replace(face_set) for face_set in surface.face_sets),
        ),
    )
