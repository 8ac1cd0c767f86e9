"""Read the source of a transfer: its motion, its shape at rest, and its parts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float, FloatArray, Index
from mixseq.disk_array import LargeArray
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.frame_store import frame_store
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.polygon_matching import match_triangles
from mixseq.progress import Progress, silent
from mixseq.segmentation import segment
from mixseq.segmentation.methods import segment_by_labels
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.sequence import Frames, MeshSequence, SequenceHeader, check_frames
from mixseq.signals.model import Model
from mixseq.topology import Topology

SAME_SIZE = 0.05
"""Largest relative difference of median edge lengths between a rest mesh and the motion of the same size."""


@dataclass(frozen=True, eq=False)
class SourceMotion:
    """A motion with a rest shape."""

    header: SequenceHeader  # mesh and times
    topology: Topology  # connectivity
    points: LargeArray  # (T, V, 3) the frames
    rest: Float  # (V, 3) the shape at rest, as large as in the frames
    parts: int | ArrayLike | None  # given parts, or their number

    def part_of_face(self) -> Index:
        """Return the part ``(F,)`` of every triangle: given, or found from the motion."""
        if not (self.parts is None or isinstance(self.parts, int | np.integer)):
            return segment_by_labels(self.parts, self.topology)
        some = self.points[frames_to_look_at(len(self.points))]
        poses = np.concatenate([self.rest[None], some])
        return segment(poses, self.topology, "motion", None if self.parts is None else int(self.parts))


@dataclass(frozen=True, eq=False)
class _Sampled:
    """The frames of a model, as a streamed sequence."""

    model: Model

    @property
    def header(self) -> SequenceHeader:
        return self.model.header_at()

    def blocks(self, size: int = 4) -> Iterator[FloatArray]:
        yield from self.model.blocks(self.model.times, size)


def source_motion(
    source: Frames | Model,
    rest: int | MeshSequence = 0,
    parts: int | ArrayLike | None = None,
    progress: Progress = silent,
) -> SourceMotion:
    """Prepare a motion as the source of transfers."""
    if isinstance(source, Model):
        if parts is None and source.space.decomposed:
            parts = source.space.decomposed.part_of_face
        frames = frame_store(_Sampled(source), progress)
    else:
        check_frames(source)
        frames = frame_store(source, progress)
    header = frames.header
    topology = Topology(header.faces, header.vertex_count)
    if isinstance(rest, MeshSequence):
        shape = _shape_at_rest(rest, header, topology, frames.points)
    else:
        count = len(frames.points)
        if isinstance(rest, bool) or not isinstance(rest, int | np.integer) or not -count <= rest < count:
            raise SettingsError(
                f"rest is {rest!r}; a frame from 0 to {count - 1} is expected, or a mesh at rest"
            )
        number = int(rest) % count
        shape = np.asarray(frames.points[number : number + 1][0], dtype=np.float64)
    return SourceMotion(header, topology, frames.points, shape, parts)


def _shape_at_rest(
    rest: MeshSequence, header: SequenceHeader, topology: Topology, points: LargeArray
) -> Float:
    """Return the first frame of a rest mesh, scaled to the size of the motion."""
    if rest.vertex_count != header.vertex_count:
        raise InvalidSequenceError(
            f"the mesh at rest has {rest.vertex_count} vertices, the motion {header.vertex_count}; give the same mesh"
        )
    try:
        match_triangles(header.polygons, rest.polygons, ("the motion", "the mesh at rest"))
    except InvalidSequenceError as error:
        raise InvalidSequenceError(
            f"{error}; give the same mesh, with its vertices in the same order"
        ) from None
    shape = rest.points[0].astype(np.float64)
    some = points[frames_to_look_at(len(points))].astype(np.float64)
    still, moving = edge_lengths(shape, topology.edges), edge_lengths(some, topology.edges)
    known = still > 0
    ratio = float(np.median(moving[:, known] / still[known])) if known.any() else 1.0
    return np.asarray(shape if abs(ratio - 1.0) <= SAME_SIZE else shape * ratio)
