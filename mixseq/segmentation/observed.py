"""Observations of frames for the width of joints, gathered block by block.

A decomposition needs the relative rotations of neighbouring parts, and the faces without area in some frame. Both are
small and additive over blocks of frames, so that a sequence need not be in memory as a whole.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, Index, Mask, evenly
from mixseq.geometry.rigid import aligning_rotations, mean_shape
from mixseq.polygons import frozen
from mixseq.topology import Topology, vertices_of

FLAT = 1e-5
"""Ratio of height to longest side below which a face has no area."""


def frames_to_look_at(frame_count: int, at_most: int = 24) -> Index:
    """Choose evenly spread frames that represent a sequence, for finding its parts and their shapes."""
    return evenly(frame_count, at_most)


@dataclass(frozen=True, eq=False)
class Watched:
    """Quantities observed in every frame."""

    faces: NDArray[np.integer]  # (F, 3) triangles of the mesh
    parts: tuple[Index, ...]  # vertices of every part, ascending
    shapes: tuple[Float, ...]  # their shapes, centred, against which turns are measured

    @classmethod
    def of(cls, topology: Topology, part_of_face: Index, frames: FloatArray) -> Watched:
        """Make it for the parts ``(F,)`` of a mesh; their shapes are means of frames ``(S, V, 3)``, S >= 1."""
        count = int(part_of_face.max(initial=-1)) + 1
        parts = tuple(np.flatnonzero(vertices_of(topology, part_of_face == part)) for part in range(count))
        shapes = tuple(mean_shape(frames[:, part].astype(np.float64), sweeps=3) for part in parts)
        return cls(topology.faces, parts, shapes)


@dataclass(frozen=True, eq=False)
class Observed:
    """Observations of frames."""

    rotations: Float  # (T, p, 3, 3) rotation of every part in every frame, relative to its shape
    flat: Mask  # (F,) faces without area in some frame


def observe(watched: Watched, points: FloatArray) -> Observed:
    """Observe a block of frames ``(B, V, 3)``; each frame is independent of its block."""
    from mixseq.segmentation.segmentation_kernels import mark_flat

    flat = np.zeros(len(watched.faces), dtype=bool)
    covariances = np.empty((len(points), len(watched.parts), 3, 3))
    for frame, into in zip(points, covariances, strict=True):
        x = frozen(np.ascontiguousarray(frame, dtype=np.float64))  # as frames are: one type to numba
        mark_flat(x, watched.faces, FLAT, flat)
        for number, (part, shape) in enumerate(zip(watched.parts, watched.shapes, strict=True)):
            moved = x[part]
            into[number] = (moved - moved.mean(axis=0)).T @ shape
    return Observed(aligning_rotations(covariances), flat)


def gather(blocks: Iterable[Observed]) -> Observed:
    """Concatenate the observations of one or more blocks, in order."""
    rotations, flat = [], None
    for block in blocks:
        rotations.append(block.rotations)
        flat = block.flat if flat is None else flat | block.flat
    return Observed(np.concatenate(rotations), np.zeros(0, dtype=bool) if flat is None else flat)
