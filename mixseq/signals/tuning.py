"""Choose the prediction of poses, and the share of lengths and angles, by leaving frames out.

Inner frames are predicted from the others, in each way, and compared: positions, edge lengths and hinge angles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index, evenly
from mixseq.disk_array import LargeArray
from mixseq.geometry.lengths_angles import wrap
from mixseq.geometry.rotations import continued
from mixseq.prediction.operator import Rows
from mixseq.prediction.poses import Poses
from mixseq.shells.shell_kernels import lengths_and_angles
from mixseq.signals.detail import Encoded
from mixseq.spaces.mixed.mixed_space import MixedBlocks, MixedSpace
from mixseq.spaces.mixed.pose_prediction import PosePrediction

MAX_TRIAL_FRAMES = 16
"""Largest number of frames that are left out, one by one."""

MAX_TRIAL_VERTICES = 2_000_000
"""Largest number of vertices of all frames that are left out."""

MIN_TRIAL_FRAMES = 3
"""Least number of frames that are left out, for meshes of any size."""

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of lengths and angles to choose from."""

SUFFICIENT_GAIN = 0.8
"""Fraction of the largest gain that suffices: the smallest share with it is taken."""

ERROR_FLOOR = 1e-12
"""Errors below this, in diagonals or radians, are rounding."""


def tuned(encoded: Encoded, frames: LargeArray) -> Encoded:
    """Choose how parts are predicted between frames ``(T, V, 3)``, and the share of lengths and angles."""
    space = encoded.space
    if not isinstance(space, MixedSpace) or space.placement == "free" or len(frames) < 4:
        return encoded
    trial = Trial.of(encoded, space, frames)
    in_body = len(space.decomposition.parts) > 1 and trial.better_in_body()
    if not space.joint_faces.any() or space.projection.steps:
        return replace(encoded, in_body=in_body)
    share = trial.best_share(in_body)
    return replace(
        encoded, in_body=in_body, space=replace(space, projection=replace(space.projection, share=share))
    )


@dataclass(frozen=True, eq=False)
class Trial:
    """Frames that are left out, and their predictions."""

    encoded: Encoded  # the encoded sequence
    space: MixedSpace  # its mixed shape space
    frames: Index  # (n,) left-out frames
    rows: Rows  # weights of the others
    points: Float  # (n, V, 3) their points, in diagonals

    @classmethod
    def of(cls, encoded: Encoded, space: MixedSpace, frames: LargeArray) -> Trial:
        """Leave some inner frames ``(T, V, 3)`` out."""
        left, rows = encoded.operator.left_out()
        most = int(np.clip(MAX_TRIAL_VERTICES // space.vertex_count, MIN_TRIAL_FRAMES, MAX_TRIAL_FRAMES))
        some = evenly(len(left), most)
        points = (
            np.stack([frames[frame : frame + 1][0].astype(np.float64) for frame in left[some]]) / space.scale
        )
        return cls(
            encoded, space, left[some], Rows(rows.frames[some], rows.weights[some], rows.count), points
        )

    def better_in_body(self) -> bool:
        """Whether predictions in bodies improve positions, lengths and angles on the whole."""
        world, body = (self._errors(self.space.posed(self._vectors(way))) for way in (False, True))
        return bool(np.log(np.maximum(body, ERROR_FLOOR) / np.maximum(world, ERROR_FLOOR)).sum() < 0.0)

    def best_share(self, in_body: bool) -> float:
        """Return the share of lengths and angles that nearly minimises the larger of their two errors."""
        blocks = self.space.split(self._vectors(in_body))
        posed = self.space.posed(self.space.join(blocks))
        plain = np.maximum(self._errors(posed)[1:], ERROR_FLOOR)
        scores = []
        for share in SHARES:
            rows = zip(posed, blocks.lengths, blocks.angles, strict=True)
            moved = np.stack([self.space.joints.project(x, le, an, share) for x, le, an in rows])
            scores.append(float((self._errors(moved)[1:] / plain).max()))
        gain = 1.0 - min(scores)
        return next(
            s
            for s, score in zip(SHARES, scores, strict=True)
            if 1.0 - score >= SUFFICIENT_GAIN * gain - 1e-12
        )

    @cached_property
    def _shapes(self) -> Float:
        """Shapes ``(n, S)`` of the frames, from the others, frame by frame to save memory."""
        shapes = np.zeros((len(self.frames), self.space.shape_dim))
        for number, (frames, weights) in enumerate(zip(self.rows.frames, self.rows.weights, strict=True)):
            for frame, weight in zip(frames, weights, strict=True):
                shapes[number] += weight * self.encoded.shapes[frame : frame + 1][0]
        return shapes

    def _vectors(self, in_body: bool) -> Float:
        """Vectors ``(n, D)`` of the frames, from the others."""
        space, articulation = self.space, self.space.articulation
        parts, bodies = space.part_poses(self.encoded.poses), space.poses(self.encoded.placement)
        world = articulation.placed(Poses(parts.turns, parts.centres), bodies)
        world = world._replace(rotations=continued(world.rotations))
        placed, found = PosePrediction(articulation, self.encoded.operator, world, in_body).of(self.rows)
        seen = articulation.with_relations(found)
        shapes = space.split(np.pad(self._shapes, ((0, 0), (0, space.placement_dim + space.correction_dim))))
        none = np.zeros((len(self.frames), space.correction_dim))
        return space.join(MixedBlocks(*shapes[:3], *seen, *placed, none))

    def _errors(self, points: Float) -> Float:
        """Root mean square errors of positions, relative lengths and angles in frames ``(n, V, 3)``."""
        squares = np.zeros(3)
        topology = self.space.topology
        for made, real in zip(points, self.points, strict=True):
            (lengths, angles), (wanted, expected) = (
                lengths_and_angles(np.ascontiguousarray(x, dtype=np.float64), topology.edges, topology.hinges)
                for x in (made, real)
            )
            strain = lengths / np.maximum(wanted, 1e-12) - 1.0
            squares += [
                float(np.square(made - real).sum(axis=1).mean()),
                float(np.square(strain).mean()) if len(strain) else 0.0,
                float(np.square(wrap(angles - expected)).mean()) if len(angles) else 0.0,
            ]
        return np.sqrt(squares / len(points))
