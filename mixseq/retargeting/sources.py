"""The source of a transfer: its motion, its shape at rest, its parts, and its alignment with the target.

Source and target are aligned as a whole by a rotation G and a scale s: a map F of the source becomes :math:`G F G^T` of
the target, and a shift d becomes s G d. The scale is the ratio of radii, instead of that of least squares: with source
and target exchanged it is the inverse.

With other proportions the best rotation is a little askew: a camel's neck and hump turn it eight degrees against a
horse beside it. So the nearest quarter turn (or none) is taken, unless it fits clearly worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.measures import edge_lengths
from mixseq.mesh.polygons import match_triangles
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import LargeArray
from mixseq.runtime.progress import Progress, no_progress
from mixseq.segmentation.joints import sample_frame_ids
from mixseq.segmentation.methods import segment, segment_by_labels
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, LazyFrames, MeshSequence, check_frames, load_frames
from mixseq.signals.model import Model
from mixseq.types import Float, Index

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
        some = self.points[sample_frame_ids(len(self.points))]
        poses = np.concatenate([self.rest[None], some])
        return segment(poses, self.topology, "motion", None if self.parts is None else int(self.parts))


def prepare_source(
    source: Frames | Model,
    rest: int | MeshSequence = 0,
    parts: int | ArrayLike | None = None,
    progress: Progress = no_progress,
) -> SourceMotion:
    """Prepare a motion as the source of transfers."""
    if isinstance(source, Model):
        if parts is None and source.space.decomposed:
            parts = source.space.decomposed.part_of_face
        model = source
        source = LazyFrames(model.header_at(), lambda size: model.blocks(model.times, size))
    else:
        check_frames(source)
    frames = load_frames(source, progress)
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
    some = points[sample_frame_ids(len(points))].astype(np.float64)
    still, moving = edge_lengths(shape, topology.edges), edge_lengths(some, topology.edges)
    known = still > 0
    ratio = float(np.median(moving[:, known] / still[known])) if known.any() else 1.0
    return np.asarray(shape if abs(ratio - 1.0) <= SAME_SIZE else shape * ratio)


ASKEW = 1.5
"""Largest ratio of distances of a quarter turn to those of the best rotation at which it is taken."""


ONE_PLACE = 1e-12
"""Extent of points, relative to their distance from the origin, below which they are one place."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """A rotation G ``(3, 3)``, proper, and a scale s > 0."""

    rotation: Float
    scale: float

    def shifted(self, shifts: Float) -> Float:
        """Return shifts ``(..., 3)`` of the source in the frame and scale of the target."""
        return np.asarray(self.scale * shifts @ self.rotation.T)

    def turned_points(self, points: Float) -> Float:
        """Return points ``(..., 3)`` of the source rotated to the target."""
        return np.asarray(points @ self.rotation.T)

    def turned(self, matrices: Float) -> Float:
        """Return matrices ``(..., 3, 3)`` of the source as matrices of the target."""
        return np.asarray(self.rotation @ matrices @ self.rotation.T)


def align(source: Float, target: Float, weights: Float) -> Alignment:
    """Find the rotation and scale from source to target points ``(n, 3)`` with weights ``(n,)``."""
    if not weights.sum() > 0:
        raise InvalidSequenceError(
            "where the target corresponds to the source it has no area at rest, so that nothing tells how it moves; "
            "give a target with triangles that are not flat"
        )
    weights = weights / weights.sum()
    from_centre, to_centre = source - weights @ source, target - weights @ target
    radii = [np.sqrt(weights @ np.square(x).sum(axis=1)) for x in (from_centre, to_centre)]
    for name, radius, points in zip(("source", "target"), radii, (source, target), strict=True):
        if not radius > ONE_PLACE * np.abs(points).max():
            raise InvalidSequenceError(
                f"all that corresponds of the {name} is in one place at rest, so that it has no size; give another "
                "rest or another mesh"
            )
    scale = float(radii[1] / radii[0])
    best, _ = kabsch(from_centre, to_centre, weights)
    simple = max(_quarter_turns(), key=lambda turn: float(np.sum(turn * best)))
    away = [
        np.sqrt(weights @ np.square(to_centre - scale * from_centre @ turn.T).sum(axis=1))
        for turn in (best, simple)
    ]
    return Alignment(simple if away[1] <= ASKEW * away[0] else best, scale)


def _quarter_turns() -> list[Float]:
    """Return the 24 rotations that permute axes."""
    matrices = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [matrix for matrix in matrices if np.linalg.det(matrix) > 0]
