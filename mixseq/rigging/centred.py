"""Sequences for fitting bones: every frame centred, in diagonals, and the conversion back to the file's units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mixseq.arrays import Float
from mixseq.frame_store import frame_store
from mixseq.rigging.rigs import Skin, without_sign_jumps
from mixseq.rigging.skeletons import Skeleton
from mixseq.rigging.weights import Binding
from mixseq.sequence import Frames, SequenceHeader, bounding_diagonal


@dataclass(frozen=True, eq=False)
class Centred:
    """A centred sequence, and the positions of its frames."""

    header: SequenceHeader  # mesh and times
    points: Float  # (T, V, 3) in the file's units
    centres: Float  # (T, 3) mean of the points of every frame
    diagonal: float  # that of the first frame, or one

    @classmethod
    def of(cls, sequence: Frames) -> Centred:
        """Read a sequence into memory."""
        held = frame_store(sequence)
        points = np.asarray(held.points[: held.header.frame_count], dtype=np.float64)
        return cls(held.header, points, points.mean(axis=1), bounding_diagonal(points[0]) or 1.0)

    @property
    def frames(self) -> Float:
        """The points ``(T, V, 3)``, centred, in diagonals."""
        return (self.points - self.centres[:, None]) / self.diagonal

    @property
    def tracks(self) -> Float:
        """The same as positions of every vertex ``(V, 3T)``, frame by frame."""
        return np.ascontiguousarray(self.frames.swapaxes(0, 1).reshape(self.header.vertex_count, -1))

    def skin(self, binding: Binding, motions: Float, skeleton: Skeleton, origin: Float) -> Skin:
        """Return a skin in the file's units: motions ``(B, 4, 3T)``; origin ``(3,)``."""
        order = np.argsort(-binding.weights, axis=1, kind="stable")
        weights = np.take_along_axis(binding.weights, order, axis=1)
        influences = np.take_along_axis(binding.influences, order, axis=1)
        m = motions.reshape(len(motions), 4, -1, 3).transpose(2, 0, 3, 1)  # (T, B, 3, 4)
        pivots = (skeleton.pivots - origin) / self.diagonal
        places = np.einsum("tbij,bj->tbi", m[..., :3], pivots) + m[..., 3]
        quaternions = Rotation.from_matrix(m[..., :3].reshape(-1, 3, 3)).as_quat().reshape(*m.shape[:2], 4)
        return Skin(
            header=self.header,
            rest=self.diagonal * binding.rest + origin,
            skeleton=skeleton,
            rotations=without_sign_jumps(quaternions),
            translations=self.diagonal * places + self.centres[:, None],
            influences=np.where(weights > 0, influences, 0),
            weights=weights,
            targets=np.zeros((0, len(weights), 3)),
            target_weights=np.zeros((len(m), 0)),
        )
