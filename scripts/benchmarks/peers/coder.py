"""What a coder of `scripts/bench compress` is, ours or a peer's: settings, bytes for each, and points back from them.

Connectivity is not part of the measured size: a decoder is given the mesh.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.types import Float

KG_TARGETS = (1.0, 0.5, 0.1, 0.05, 0.02)
"""KG errors in percent that rates are told at."""

KG_SWEEP = (2.2, 1.4, 1.0, 0.7, 0.5, 0.3, 0.2, 0.14, 0.1, 0.07, 0.05, 0.03, 0.02, 0.014, 0.005, 0.002)
"""KG errors in percent that coders with a quantisation step aim at."""

ERROR_TARGETS = (1e-2, 1e-3, 1e-4)
"""Largest errors in diagonals that rates are told at."""


class Coder(Protocol):
    """A way to make a sequence small."""

    @property
    def name(self) -> str:
        """In one word, for the command line."""

    @property
    def title(self) -> str:
        """For tables and plots."""

    @property
    def packages(self) -> tuple[str, ...]:
        """What has to be installed, by the names that pip knows."""

    def settings(self, sequence: mixseq.MeshSequence) -> Iterable[Any]:
        """Return the settings to measure, one operating point each; this is not timed."""

    def encode(self, sequence: mixseq.MeshSequence, setting: Any) -> bytes:
        """Encode; timed."""

    def signals(self, mesh: mixseq.Topology, data: bytes) -> int:
        """Return how many of the bytes count: those of connectivity do not."""

    def decode(self, mesh: mixseq.Topology, data: bytes) -> Float:
        """Return points ``(T, V, 3)``; timed."""


def step_of(sequence: mixseq.MeshSequence, kg_percent: float) -> float:
    """Return the step of a uniform quantisation of all coordinates with this KG error: step²/12 a number."""
    return float(np.sqrt(12.0 / sequence.points.size) * spread(sequence.points) * kg_percent / 100)


def spread(points: NDArray[Any]) -> float:
    """Return the denominator of the KG error: the norm of all points, each frame about its centroid."""
    x = points.astype(np.float64)
    return float(np.linalg.norm(x - x.mean(axis=1, keepdims=True)))


@contextmanager
def as_file(data: bytes, name: str) -> Iterator[Path]:
    """Put bytes into a temporary file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        yield path
