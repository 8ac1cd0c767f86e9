"""The source of a transfer: its motion, rest shape and parts, and its alignment with the target.

Source and target are aligned by a rotation G and a scale s. A deformation F of the source becomes :math:`G F G^T` on
the target, and a displacement d becomes s G d. The scale is the ratio of the root mean square radii. Exchanging source
and target inverts this ratio, but not a least-squares scale.

If proportions differ, the best rotation is slightly wrong: the camel's neck and hump rotate it by eight degrees from
a horse in the same orientation. So G is the nearest rotation by quarter turns, unless its fit is clearly worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike

from mixseq.compression.numbering import match_vertices
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.measures import edge_lengths
from mixseq.mesh.polygons import describe_difference
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import LargeArray
from mixseq.runtime.progress import Progress, log_progress
from mixseq.segmentation.joints import sample_frame_ids
from mixseq.segmentation.methods import segment, segment_by_labels
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, MeshSequence, check_motion, load_frames
from mixseq.signals.model import Model
from mixseq.types import Float, Index

MAX_EDGE_LENGTH_DEVIATION = 0.05  # largest relative deviation of edge lengths (median) at which a rest is not scaled


@dataclass(frozen=True, eq=False)
class SourceMotion:
    """A motion with a rest shape."""

    header: SequenceHeader  # mesh and times
    topology: Topology  # connectivity of the mesh
    points: LargeArray  # (T, V, 3) points of all frames
    rest: Float  # (V, 3) rest shape, scaled to the size of the frames
    parts: int | ArrayLike | None  # number of parts, or the part of every triangle

    def part_of_face(self) -> Index:
        """Return the part ``(F,)`` of every triangle, given or found from the motion."""
        if not (self.parts is None or isinstance(self.parts, int | np.integer)):
            return segment_by_labels(self.parts, self.topology)
        samples = self.points[sample_frame_ids(len(self.points))]
        is_sampled = (samples == self.rest).all(axis=(1, 2)).any()  # then parts are those of a model of the frames
        poses = samples if is_sampled else np.concatenate([self.rest[None], samples])
        return segment(poses, self.topology, "motion", None if self.parts is None else int(self.parts))


def prepare_source(
    source: Frames | Model,
    rest: int | MeshSequence = 0,
    parts: int | ArrayLike | None = None,
    progress: Progress = log_progress,
) -> SourceMotion:
    """Prepare a sequence or a model as the source of transfers."""
    if isinstance(source, Model):
        parts = source.parts if parts is None else parts
        source = source.frames
    else:
        check_motion(source)
    frames = load_frames(source, progress)
    header = frames.header
    topology = Topology(header.faces, header.vertex_count)
    if isinstance(rest, MeshSequence):
        rest_shape = _scaled_rest_shape(rest, header, topology, frames.points)
    else:
        frame_count = len(frames.points)
        if isinstance(rest, bool) or not isinstance(rest, int | np.integer) or not -frame_count <= rest < frame_count:
            raise SettingsError(f"rest is {rest!r}; a frame from 0 to {frame_count - 1} is expected, or a mesh at rest")
        frame = int(rest) % frame_count
        rest_shape = np.asarray(frames.points[frame : frame + 1][0], dtype=np.float64)
    return SourceMotion(header, topology, frames.points, rest_shape, parts)


def _scaled_rest_shape(rest: MeshSequence, header: SequenceHeader, topology: Topology, points: LargeArray) -> Float:
    """Return the first frame of a rest mesh, scaled to the size of the motion."""
    if rest.vertex_count != header.vertex_count:
        raise InvalidSequenceError(
            f"the mesh at rest has {rest.vertex_count} vertices, the motion {header.vertex_count}; give the same mesh"
        )
    vertex_ids: Index | None = match_vertices(rest, header)
    if vertex_ids is None:
        difference = describe_difference(header.polygons, rest.polygons, ("the motion", "the mesh at rest"))
        raise InvalidSequenceError(f"{difference}; give the same mesh, with its vertices in the same order")
    shape = rest.points[0, vertex_ids].astype(np.float64)
    samples = points[sample_frame_ids(len(points))].astype(np.float64)
    rest_lengths, lengths = edge_lengths(shape, topology.edges), edge_lengths(samples, topology.edges)
    has_length = rest_lengths > 0
    ratio = float(np.median(lengths[:, has_length] / rest_lengths[has_length])) if has_length.any() else 1.0
    return np.asarray(shape if abs(ratio - 1.0) <= MAX_EDGE_LENGTH_DEVIATION else shape * ratio)


MAX_QUARTER_TURN_RATIO = 1.5  # largest ratio of distances (root mean square), quarter turn to best rotation
MIN_EXTENT_RATIO = 1e-12  # smallest radius relative to the largest coordinate; smaller radii are rounding errors


@dataclass(frozen=True, eq=False)
class Alignment:
    """A proper rotation G ``(3, 3)`` and a scale s > 0 from source to target."""

    rotation: Float
    scale: float

    def map_vectors(self, vectors: Float) -> Float:
        """Rotate and scale displacements ``(..., 3)`` of the source."""
        return np.asarray(self.scale * vectors @ self.rotation.T)

    def rotate_matrices(self, matrices: Float) -> Float:
        """Conjugate deformations ``(..., 3, 3)`` of the source by the rotation."""
        return np.asarray(self.rotation @ matrices @ self.rotation.T)


def fit_alignment(source: Float, target: Float, weights: Float) -> Alignment:
    """Fit the alignment from source points ``(n, 3)`` to target points ``(n, 3)``, with weights ``(n,)``."""
    if not weights.sum() > 0:
        raise InvalidSequenceError(
            "where the target corresponds to the source it has no area at rest; give a target with triangles that "
            "are not flat"
        )
    weights = weights / weights.sum()
    centred_source, centred_target = source - weights @ source, target - weights @ target
    radii = [np.sqrt(weights @ np.square(x).sum(axis=1)) for x in (centred_source, centred_target)]
    for name, radius, points in zip(("source", "target"), radii, (source, target), strict=True):
        if not radius > MIN_EXTENT_RATIO * np.abs(points).max():
            raise InvalidSequenceError(
                f"all corresponding points of the {name} are in one place at rest; give another rest or another mesh"
            )
    scale = float(radii[1] / radii[0])
    best, _ = kabsch(centred_source, centred_target, weights)
    quarter_turn = max(_quarter_turns(), key=lambda turn: float(np.sum(turn * best)))
    distances = [
        np.sqrt(weights @ np.square(centred_target - scale * centred_source @ turn.T).sum(axis=1))
        for turn in (best, quarter_turn)
    ]
    is_quarter_turn = distances[1] <= MAX_QUARTER_TURN_RATIO * distances[0]
    return Alignment(quarter_turn if is_quarter_turn else best, scale)


def _quarter_turns() -> list[Float]:
    """Return the 24 rotations that map the coordinate axes onto each other."""
    matrices = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [matrix for matrix in matrices if np.linalg.det(matrix) > 0]
