"""Find bones: free ones from near-rigid parts, and skins of them in a tree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float, Index
from mixseq.errors import SegmentationError, SettingsError
from mixseq.progress import Progress
from mixseq.rigging.bones import vertex_labels
from mixseq.rigging.centred import Centred
from mixseq.rigging.decomposition import free_bones, hung_bones
from mixseq.rigging.rigs import Skin
from mixseq.rigging.skeletons import Skeleton
from mixseq.rigging.weights import Binding
from mixseq.segmentation import segment
from mixseq.topology import Topology

ROUGH = 4
"""Rounds of a rough fit, a twentieth of the time of a skin; chosen empirically."""


@dataclass(frozen=True, eq=False)
class FreeBones:
    """Bones without joints."""

    binding: Binding  # weights and rest positions of vertices, in diagonals
    motions: Float  # (B, 4, 3T) their transposed motions
    # (float, float) largest distance from the sequence in diagonals, and KG error in percent.
    errors: tuple[float, float]


@dataclass(frozen=True, eq=False)
class FoundBones:
    """Fits of bones to one sequence."""

    sequence: Centred  # the animation
    tracks: Float  # (V, 3T) its positions of every vertex, centred, in diagonals
    faces: Index  # (F, 3) triangles
    rounds: int  # largest number of rounds of weights and motions
    progress: Progress  # progress of fits

    @classmethod
    def of(cls, sequence: Centred, rounds: int, progress: Progress) -> FoundBones:
        """Prepare a sequence."""
        return cls(sequence, sequence.tracks, sequence.header.faces.astype(np.int64), rounds, progress)

    def free(self, bones: int | ArrayLike | None, rounds: int | None = None) -> FreeBones:
        """Fit free bones: at most a number, or from the labels ``(F,)`` of triangles, or from parts by motion."""
        labels, most = self._starting(bones)
        rounds = self.rounds if rounds is None else rounds
        binding, motions = free_bones(self.tracks, labels, most, rounds, self._told)
        off = self.tracks - binding.matrix(len(motions)) @ motions.reshape(-1, motions.shape[2])
        squares = np.square(off).reshape(len(off), -1, 3).sum(axis=2)
        spread = float(np.square(self.tracks).sum()) or 1.0
        errors = float(np.sqrt(squares.max())), 100 * float(np.sqrt(squares.sum() / spread))
        return FreeBones(binding, motions, errors)

    def hung(self, free: FreeBones) -> Skin:
        """Build a tree of bones, without those that move nothing."""
        binding, motions, joints = hung_bones(
            self.tracks,
            self.faces,
            free.binding,
            free.motions,
            self.rounds,
            lambda done: self._told(self.rounds + done),
        )
        used = np.isin(np.arange(len(motions)), binding.influences[binding.weights > 0])
        kept = (joints.below() & used).any(axis=1)
        place = np.cumsum(kept) - 1
        parents = joints.parents[kept]
        origin, diagonal = self.sequence.centres[0], self.sequence.diagonal
        skeleton = replace(
            Skeleton.flat(diagonal * joints.pivots[kept] + origin),
            parents=np.where(parents < 0, -1, place[parents]),
        )
        binding = replace(binding, influences=place[binding.influences])
        return self.sequence.skin(binding, motions[kept], skeleton, origin)

    def _told(self, done: int) -> None:
        self.progress(done, 2 * self.rounds + 1, "fitting weights and bones")

    def _starting(self, bones: int | ArrayLike | None) -> tuple[Index, int]:
        """Return the initial bone ``(V,)`` of every vertex, and the largest number of bones."""
        faces, vertices = self.faces, self.sequence.header.vertex_count
        if bones is None or isinstance(bones, int | np.integer):
            if bones is not None and not 1 <= bones <= len(faces):
                raise SettingsError(
                    f"{bones} bones are asked for; a number from 1 to {len(faces)}, that of the triangles, is expected"
                )
            count = None if bones is None else int(bones)
            labels = segment(self.sequence.frames, Topology(faces, vertices), parts=count)
        else:
            labels, count = np.asarray(bones), None
            if labels.shape != (len(faces),) or not np.issubdtype(labels.dtype, np.integer):
                raise SegmentationError(
                    f"labels of bones have shape {labels.shape} and type {labels.dtype}; "
                    f"one whole number for each of the {len(faces)} triangles is expected"
                )
            labels = np.unique(labels, return_inverse=True)[1]
        return vertex_labels(faces, labels, vertices), count or int(labels.max()) + 1
