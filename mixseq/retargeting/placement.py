"""Frames that joints are solved in between placed parts, and the rows of a vector that belong to the joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index, Mask
from mixseq.segmentation.joints import Joint
from mixseq.shells.patch import Patch


class MixedFrame(NamedTuple):
    """One frame of S_m, with its poses as matrices.

    Attributes
    ----------
    lengths, angles, weights : (E',), (H',), (E',) float64
        Edge lengths, hinge angles, weights of the lengths.
    parts : (N, 3) float64
        Aligned vertices of all parts.
    rotations, translations : (g, 3, 3), (g, 3) float64
        Poses.
    offsets : (F, 3) float64
        Offsets of the free vertices from where the parts carry them; none if empty.
    holds : (F,) float64
        Weights of the offsets.
    """

    lengths: Float
    angles: Float
    weights: Float
    parts: Float
    rotations: Float
    translations: Float
    offsets: Float
    holds: Float


@dataclass(frozen=True, eq=False)
class JointRows:
    """The joints that are solved, which of their edges and hinges are stored, and where in the vector."""

    joints: tuple[Joint, ...]
    patches: tuple[Patch, ...]
    stored_edges: tuple[Mask, ...]
    stored_hinges: tuple[Mask, ...]

    @cached_property
    def edge_ids(self) -> Index:
        """Global numbers ``(E',)`` of the stored edges, joint by joint."""
        ids = [joint.edge_ids[stored] for joint, stored in zip(self.joints, self.stored_edges, strict=True)]
        return concatenate(ids)

    @cached_property
    def hinge_ids(self) -> Index:
        """Global numbers ``(H',)`` of the stored hinges, joint by joint."""
        ids = [joint.hinge_ids[stored] for joint, stored in zip(self.joints, self.stored_hinges, strict=True)]
        return concatenate(ids)

    @cached_property
    def free(self) -> Index:
        """Global free vertices ``(F,)``, joint by joint."""
        return concatenate([j.vertices[p.free] for j, p in zip(self.joints, self.patches, strict=True)])

    def spacing(self, lengths: Float) -> Float:
        """Mean length ``(F,)`` of the edges at every free vertex, from those of the stored edges ``(E',)``."""
        sums, counts = np.zeros((2, len(self.free)))
        for patch, edges, free in zip(self.patches, self.edge_slices, self.free_slices, strict=True):
            ends = patch.free_number[patch.edges[patch.free_edges]]
            for end in ends.T:
                inside = end >= 0
                np.add.at(sums[free], end[inside], lengths[edges][inside])
                np.add.at(counts[free], end[inside], 1.0)
        return np.asarray(sums / counts)

    @cached_property
    def free_slices(self) -> list[slice]:
        """Where the free vertices of every joint are."""
        return _slices([len(patch.free) for patch in self.patches])

    @cached_property
    def edge_slices(self) -> list[slice]:
        """Where the lengths of every joint are."""
        return _slices([int(np.count_nonzero(stored)) for stored in self.stored_edges])

    @cached_property
    def hinge_slices(self) -> list[slice]:
        """Where the angles of every joint are."""
        return _slices([int(np.count_nonzero(stored)) for stored in self.stored_hinges])


def concatenate(arrays: list[Index]) -> Index:
    """Concatenate index arrays; none at all are an empty one."""
    return np.concatenate(arrays) if arrays else np.zeros(0, dtype=np.int64)


def _slices(sizes: list[int]) -> list[slice]:
    ends = np.cumsum(sizes)
    return [slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True)]
