r"""Errors of a file with a skin or a morph, compared with its original sequence.

With the points :math:`x_t(v)` of the sequence, those of the file :math:`y_t(v)`, the centroid :math:`\bar x_t` of a
frame and the diagonal :math:`D` of the first one:

.. math::
    e_{max} = \max_{tv} \frac{|y_t(v) - x_t(v)|}{D}, \quad
    e_{rms} = \frac{1}{D} \sqrt{\frac{1}{TV} \sum_{tv} |y_t(v) - x_t(v)|^2}, \quad
    KG = 100 \frac{\lVert y - x \rVert_F}{\lVert x - \bar x \rVert_F}
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq.types import IntArray
from mixseq_io.gltf.codecs import compute_glb_size
from mixseq_io.gltf.new_document import MorphFrameWriter, axis_conversion, create_scene
from mixseq_io.registry import open_sequence
from mixseq_io.rig_files import GLTF
from mixseq_io.scene_meshes import split_meshes


@dataclass(frozen=True)
class RigErrors:
    """Errors of a file: largest and root mean square distance in diagonals, and KG in percent."""

    max_error: float
    rms_error: float
    kg_percent: float


def measure_rig_file(path: Path, sequence: MeshSequence) -> RigErrors:
    """Compare a written file with its sequence, at the times of its frames."""
    gltf = path.suffix.lower() in GLTF
    kept = _with_polygons(sequence.header) if gltf else np.arange(sequence.vertex_count)
    turn = np.reshape(
        axis_conversion(sequence.header).get("matrix", np.eye(4)) if gltf else np.eye(4), (4, 4)
    )[:3, :3]
    largest = squares = spread = 0.0
    for points, shown in _pairs(path, sequence):
        here = points[kept].astype(np.float64) @ turn  # columns of the file are rows here
        square = np.square(shown - here).sum(axis=1)
        largest = max(largest, float(square.max()))
        squares += float(square.sum())
        spread += float(np.square(here - here.mean(axis=0)).sum())
    diagonal = bounding_diagonal(sequence.points[0][kept].astype(np.float64) @ turn)
    return RigErrors(
        max_error=_ratio(np.sqrt(largest), diagonal),
        rms_error=_ratio(np.sqrt(squares / (sequence.frame_count * len(kept))), diagonal),
        kg_percent=100 * _ratio(np.sqrt(squares), np.sqrt(spread)),
    )


def size_with_frame_targets(header: SequenceHeader) -> int:
    """Return the size in bytes of a .glb with a morph target per frame, up to the text of bounds."""
    layout, meshes = create_scene(header)
    MorphFrameWriter(layout, meshes, header)
    return compute_glb_size(layout)


def _with_polygons(header: SequenceHeader) -> IntArray:
    """Return the vertices ``(n,)`` of objects with polygons, since glTF has no others."""
    vertices = np.arange(header.vertex_count)
    return np.concatenate(
        [vertices[mesh.vertices] for mesh in split_meshes(header) if mesh.polygons.counts.size]
    )


def _pairs(path: Path, sequence: MeshSequence) -> Iterator[tuple[NDArray[np.floating], NDArray[np.float64]]]:
    """Yield the points ``(V, 3)`` of every frame, and those of the file at its time."""
    with open_sequence(path, prim="/") as reader:
        there = reader.header.times
        # The nearest: times are float32 in glTF, and a file that stands still has a single frame.
        nearest = np.searchsorted((there[1:] + there[:-1]) / 2, sequence.times)
        number = 0
        for block in reader.blocks():
            for shown in block:
                for frame in np.flatnonzero(nearest == number):
                    yield sequence.points[frame], shown.astype(np.float64)
                number += 1


def _ratio(value: float, unit: float) -> float:
    if value == 0:
        return 0.0
    return float(value / unit) if unit > 0 else float("inf")
