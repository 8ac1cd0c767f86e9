"""Readers in a process of their own, for formats that are parsed by C++ libraries.

A damaged file can make such a library crash, hang, or ask for all memory; none of that can be caught where it
happens. So these readers run in a worker (`mixseq_io.worker`), a second Python with limits on its memory
(`mixseq_io.memory`) and on the time of each answer. When it dies, the file is to blame and the user gets an error as
from any other format. Workers are reused, because starting one takes half a second, and they are few
(`mixseq_io.worker_pool`).

The limit of time can be raised by the environment variable ``MIXSEQ_READER_SECONDS`` (120 of processor time; four
times as long by the clock, for files that never answer).
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
    """Open a file in a worker, or here where none can be started."""
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
    """Call a function of a file in a worker and return its value; arguments and errors as of `open_isolated`."""
    if not can_isolate():
        return loaded(function)(path, *arguments)
    worker = hire()
    try:
        question = "call", function, str(path), arguments, str(Path.cwd()), max_memory()
        return worker.ask(path, *question, meanwhile=meanwhile)
    finally:
        dismiss(worker)


clocks: list[Callable[[float], None]] = []
"""What limits time in this process, if it is a worker."""


def limit_time(share: float) -> None:
    """Start the clock of an answer anew, with a share of the limit of time; does nothing outside of a worker."""
    for start in clocks:
        start(share)


def loaded(reference: str) -> Callable[..., Any]:
    """Return the function that ``"module:function"`` names, or ``"module:object.method"``."""
    module, function = reference.split(":")
    found: Callable[..., Any] = attrgetter(function)(import_module(module))
    return found


def can_isolate() -> bool:
    """Whether a second Python can be started: applications that embed Python have no executable for it."""
    return "python" in Path(sys.executable or "").name.lower()


class _IsolatedReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, file: OpenFile, resources: ExitStack, moving: bool
    ) -> None:
        super().__init__(path, header, resources, moving)
        self._file = file

    def markings(self) -> Markings:
        """Return what tells parts of the mesh apart."""
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
    """Make the arrays of a header that came through a pipe read-only again."""
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
