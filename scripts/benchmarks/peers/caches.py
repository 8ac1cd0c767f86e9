"""Animation caches as they are: float32 in USD and Alembic, connectivity and all."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import mixseq
from mixseq.types import Float
from scripts.benchmarks.peers.coder import as_file


class Cache:
    """A file that mixseq writes, of which everything counts."""

    def __init__(self, name: str, title: str, file: str, packages: tuple[str, ...] = ()) -> None:
        self.name: str = name
        self.title = title
        self.packages = packages
        self._file = file

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[str]:
        return ("float32",)

    def encode(self, sequence: mixseq.MeshSequence, setting: str) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, self._file)
            mixseq.write(path, sequence)
            return path.read_bytes()

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        return len(data)

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        with as_file(data, self._file) as path:
            return mixseq.read(path).points.astype(np.float64)
