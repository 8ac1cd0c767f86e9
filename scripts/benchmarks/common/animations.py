"""The animations that benchmarks run on: the folder $MIXSEQ_DATA."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

import mixseq
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray
from scripts.benchmarks.common.varied import varied


def animation(name: str) -> mixseq.MeshSequence:
    """Read one of them; `NAME xN` repeats it so often, with variation."""
    base, _, loops = name.partition(" x")
    sequence = mixseq.read(Path(os.environ.get("MIXSEQ_DATA", ""), "npz", f"{base}.npz"))
    return varied(sequence, int(loops)) if loops else sequence


def subdivided(sequence: mixseq.MeshSequence) -> tuple[FloatArray, IntArray]:
    """Split every triangle into four at the midpoints of its sides: points ``(T, V + E, 3)``, faces ``(4 F, 3)``."""
    topology = mixseq.Topology(sequence.faces, sequence.vertex_count)
    points = sequence.points
    middles = points[:, topology.edges].mean(axis=2, dtype=np.float64).astype(points.dtype)
    a, b, c = sequence.faces.astype(np.int64).T
    ab, bc, ca = (topology.face_edges + sequence.vertex_count).T
    faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return np.concatenate([points, middles], axis=1), faces


def header_of(faces: IntArray, vertices: int, frames: int) -> SequenceHeader:
    """Return the header of a triangle mesh with so many frames, at 24 per second."""
    polygons = Polygons(np.full(len(faces), 3), faces.reshape(-1))
    return SequenceHeader(polygons=polygons, vertex_count=vertices, times=np.arange(frames) / 24)
