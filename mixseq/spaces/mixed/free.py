"""The mixed shape space S_m as the paper has it: a mesh knows its parts and joints, and one pose for every component.

A vector is ``[joint edge lengths | joint hinge angles | aligned part vertices | quaternions | centres]`` (paper,
Section 2.2), in diagonals and radians. The poses are those of the first part of every connected component, the
largest where parts were found by motion. Where all other parts go is for P_m to find.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.geometry.lengths_angles import unwrap_angles, wrap
from mixseq.geometry.rigid import kabsch
from mixseq.geometry.rotations import continued, quaternions
from mixseq.progress import Progress, silent
from mixseq.shells.shell import Relaxation
from mixseq.spaces.mixed.assembly import Assembly, FreeFrame
from mixseq.spaces.mixed.mixed_space import MixedSpace, joined_rows, split_rows
from mixseq.threads import one_blas_thread


class FreeBlocks(NamedTuple):
    """The blocks of T vectors of the free space: p parts with N vertices in all, g components.

    Attributes
    ----------
    lengths : (T, E')
        Edge lengths, joint by joint.
    angles : (T, H')
        Hinge angles in radians, joint by joint, unwrapped.
    parts : (T, N, 3)
        Vertices of the parts, aligned to their mean shapes, part by part.
    rotations : (T, g, 4)
        Quaternions from the mean shape of a component's first part to the frame; signs do not jump.
    centres : (T, g, 3)
        Where the centre of that mean shape goes.
    """

    lengths: Float
    angles: Float
    parts: Float
    rotations: Float
    centres: Float


@dataclass(frozen=True, eq=False)
class FreeSpace(MixedSpace):
    """The mixed shape space with one pose for every component; make it with `mixed_space`.

    Attributes
    ----------
    reference_lengths : (E',) float64
        Mean edge lengths; their inverses weigh lengths in fits.
    relaxation : Relaxation
        How lengths and angles are made to agree.
    """

    reference_lengths: Float
    relaxation: Relaxation
    placement = "free"

    @cached_property
    def projection(self) -> Assembly:
        """What puts decoded parts and joints together."""
        return Assembly(
            self.topology,
            self.decomposition,
            self.shapes,
            self.reference,
            self.reference_lengths,
            self.relaxation,
        )

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return (self.projection,)

    @property
    def edge_ids(self) -> Index:
        """Edges of joints that no part has both ends of."""
        return self.projection.edge_ids

    @property
    def hinge_ids(self) -> Index:
        """Hinges of joints that no part has all vertices of."""
        return self.projection.hinge_ids

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the blocks of a vector, in order."""
        groups = len(self.projection.posed)
        return len(self.edge_ids), len(self.hinge_ids), 3 * len(self.shapes), 4 * groups, 3 * groups

    @property
    def dim(self) -> int:
        """Length D of a vector."""
        return sum(self.sizes)

    @property
    def rotation_count(self) -> int:
        """One for every component."""
        return len(self.projection.posed)

    @property
    def centre_count(self) -> int:
        """One for every component."""
        return len(self.projection.posed)

    @property
    def weights(self) -> Float:
        """The metric ``(D,)``: by how many diagonals vertices move when a number of a vector changes by one.

        1 for lengths, vertices and centres; for an angle `ANGLE` times the length of its edge in the reference; for a
        quaternion twice the radius of gyration of the part.
        """
        lengths, _, parts, _, centres = (np.ones(size) for size in self.sizes)
        turns = np.repeat(2.0 * self.radii[self.projection.posed], 4)
        return np.concatenate([lengths, self.angle_weights, parts, turns, centres])

    def split(self, vectors: Float) -> FreeBlocks:
        """Return the blocks of vectors ``(T, D)``, as views where possible; it raises what `checked` does."""
        lengths, angles, parts, turns, centres = split_rows(self.checked(vectors), self.sizes)
        count, groups = len(vectors), len(self.projection.posed)
        return FreeBlocks(
            lengths,
            angles,
            parts.reshape(count, len(self.shapes), 3),
            turns.reshape(count, groups, 4),
            centres.reshape(count, groups, 3),
        )

    def join(self, blocks: FreeBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return joined_rows(*blocks)

    def encode_apart(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_apart`: angles are the smallest, quaternions have w >= 0.

        A rigid motion of a frame changes nothing but its pose.
        """
        vectors = np.empty((len(points), self.dim))
        posed = self.projection.posed
        for vector, frame in zip(vectors, points, strict=True):
            x = frame.astype(np.float64) / self.scale
            aligned, rotations, centres = self.registered(x)
            blocks = *self.lengths_and_angles(x), aligned, quaternions(rotations[posed]), centres[posed]
            np.concatenate([block.reshape(-1) for block in blocks], out=vector)
        return vectors

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`."""
        blocks = self.split(vectors)
        before = None if previous is None else self.split(previous[None])
        start = self.reference_angles if before is None else before.angles[0]
        return self.join(
            blocks._replace(
                angles=unwrap_angles(blocks.angles, start),
                rotations=continued(blocks.rotations, None if before is None else before.rotations[0]),
            )
        )

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference`.

        What vertices of a part moved by is turned back by its rotation, not registered anew.
        """
        x = np.stack([before, after]) / self.scale
        (lengths, angles), parts = self.lengths_and_angles(x), self.decomposition.parts
        shapes = np.split(self.split(vector[None]).parts[0], np.cumsum([len(part) for part in parts])[:-1])
        moved = [
            (x[1, part] - x[0, part]) @ kabsch(shape, x[0, part])[0]
            for shape, part in zip(shapes, parts, strict=True)
        ]
        change = lengths[1] - lengths[0], wrap(angles[1] - angles[0]), np.concatenate(moved).reshape(-1)
        return np.concatenate(change)

    def decode(self, vectors: Float, progress: Progress = silent) -> Float:
        """Implement `ShapeSpace.decode`: the projection P_m, frame by frame."""
        vectors = np.asarray(vectors, dtype=np.float64)
        points = np.empty((len(vectors), self.topology.vertex_count, 3))
        with one_blas_thread():
            for number, frame in enumerate(self.frames(vectors)):
                points[number] = self.projection.assemble(frame).points
                progress(number + 1, len(vectors), "decoding frames")
        points *= self.scale
        return points

    def frames(self, vectors: Float) -> Iterator[FreeFrame]:
        """Yield what P_m makes frames of, from vectors ``(T, D)``."""
        for each in zip(*self.split(vectors), strict=True):
            yield FreeFrame(*each)
