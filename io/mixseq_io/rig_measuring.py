r"""Measure the errors of a file with a skin or a morph, at its frames and between them.

With points :math:`x_t(v)` of the sequence, points :math:`y_t(v)` of the file, the centroid :math:`\bar x_t` of every
frame and the diagonal :math:`D` of the first frame:

.. math::
    e_{max} = \max_{tv} \frac{|y_t(v) - x_t(v)|}{D}, \quad
    e_{rms} = \frac{1}{D} \sqrt{\frac{1}{TV} \sum_{tv} |y_t(v) - x_t(v)|^2}, \quad
    KG = 100 \frac{\lVert y - x \rVert_F}{\lVert x - \bar x \rVert_F}
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.metrics import error_ratio
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.decoding import largest_distance, played_blocks, quarter_times
from mixseq.types import Float, FloatArray, IntArray
from mixseq_io.gltf.codecs import compute_glb_size
from mixseq_io.gltf.new_document import MorphFrameWriter, create_scene, node_transform
from mixseq_io.registry import open_sequence
from mixseq_io.rig_files import GLTF_EXTENSIONS
from mixseq_io.scene_meshes import split_meshes


@dataclass(frozen=True)
class RigErrors:
    """Errors of a rig file, compared with its original sequence."""

    max_error: float  # largest distance, in diagonals
    rms_error: float  # root mean square distance, in diagonals
    kg_percent: float


def measure_rig_file(path: Path, sequence: MeshSequence) -> RigErrors:
    """Compare a written rig with its sequence, at the times of its frames."""
    vertex_ids, rotation, scale = _placement(path, sequence.header)
    largest = squares = spread = 0.0
    for points, written in _frame_pairs(path, sequence):
        expected = points[vertex_ids].astype(np.float64) @ rotation
        squared_distances = np.square(written / scale - expected).sum(axis=1)
        largest = max(largest, float(squared_distances.max()))
        squares += float(squared_distances.sum())
        spread += float(np.square(expected - expected.mean(axis=0)).sum())
    return RigErrors(
        max_error=error_ratio(np.sqrt(largest), sequence.diagonal),
        rms_error=error_ratio(np.sqrt(squares / (sequence.frame_count * len(vertex_ids))), sequence.diagonal),
        kg_percent=100 * error_ratio(np.sqrt(squares), np.sqrt(spread)),
    )


def measure_file_between(
    path: Path, header: SequenceHeader, points_at: Callable[[Float], Iterable[FloatArray]]
) -> float | None:
    """Return the largest distance of a written file from a motion, at the quarters between its frames, in its units.

    `points_at` returns the motion's points in blocks ``(B, V, 3)`` at times ``(N,)`` of the file. The result is None if
    the file has other meshes as well.
    """
    vertex_ids, rotation, scale = _placement(path, header)
    times = quarter_times(header.times)
    expected = (block[:, vertex_ids] @ rotation for block in points_at(times))
    with open_sequence(path, prim="/") as reader:
        if reader.header.vertex_count != len(vertex_ids):
            return None
        return largest_distance(expected, (block / scale for block in played_blocks(reader, times)))


def _placement(path: Path, header: SequenceHeader) -> tuple[IntArray, Float, float]:
    """Return the vertices ``(n,)`` that a file has, and how it rotates ``(3, 3)`` and scales them."""
    if path.suffix.lower() not in GLTF_EXTENSIONS:
        return np.arange(header.vertex_count), np.eye(3), 1.0
    matrix = node_transform(header).get("matrix", np.eye(4))
    scale = header.metres_per_unit
    # The file stores columns, so rows are transposed.
    return _vertices_with_polygons(header), np.reshape(matrix, (4, 4))[:3, :3] / scale, scale


def size_with_frame_targets(header: SequenceHeader) -> int:
    """Return the size in bytes of a .glb with a morph target per frame; the text of bounds may differ in length."""
    layout, meshes = create_scene(header)
    MorphFrameWriter(layout, meshes, header)
    return compute_glb_size(layout)


def _vertices_with_polygons(header: SequenceHeader) -> IntArray:
    """Return the vertices ``(n,)`` of objects with polygons; glTF omits objects without polygons."""
    vertices, meshes = np.arange(header.vertex_count), split_meshes(header)
    return np.concatenate([vertices[mesh.vertices] for mesh in meshes if mesh.polygons.counts.size])


def _frame_pairs(path: Path, sequence: MeshSequence) -> Iterator[tuple[NDArray[np.floating], NDArray[np.float64]]]:
    """Yield the points ``(V, 3)`` of every frame, and the file's points ``(V, 3)`` at the nearest time."""
    with open_sequence(path, prim="/") as reader:
        times = reader.header.times
        # Frames are matched by nearest times: glTF has float32 times, and static files have a single frame.
        nearest = np.searchsorted((times[1:] + times[:-1]) / 2, sequence.times)
        file_frames = (points for block in reader.blocks() for points in block)
        for file_frame, points in enumerate(file_frames):
            for frame in np.flatnonzero(nearest == file_frame):
                yield sequence.points[frame], points.astype(np.float64)
