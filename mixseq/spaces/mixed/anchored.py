r"""The mixed shape space S_m with the poses of all parts: where vertices are, and how their neighbourhood lies.

A vector is ``[joint edge lengths | joint hinge angles | unposed vertices | sides | quaternions | centres]``, in
diagonals and radians.

- Every part has a pose, a unit quaternion and a centre: that of the best rigid motion from its mean shape (paper,
  Section 3.4). From them every vertex has a rigid frame (`vertex_frames`).
- Vertices are stored as seen from their frames: *unposed*. For a vertex inside a part that is the paper's aligned part
  vertex.
- Where frames differ from corner to corner, in some frame of the sequence, faces bend: these are the joints, and their
  vertices are *free*. There sides of faces are stored, too (`sides`), and the lengths and angles of the paper.

Decoding is posing, and one back-substitution with a constant matrix. It is linear in all but the poses, smooth in
these, exact at the frames; so velocities are its closed derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from mixseq.arrays import Float, FloatArray, Index, Mask
from mixseq.geometry.lengths_angles import unwrap_angles, wrap
from mixseq.geometry.rotations import quaternions
from mixseq.prediction.operator import Operator
from mixseq.prediction.poses import Neighbours, blended, predicted
from mixseq.progress import Progress, silent
from mixseq.shells.shell import Relaxation
from mixseq.spaces.mixed import vertex_frame_kernels as kernels
from mixseq.spaces.mixed.mixed_space import MixedSpace, joined_rows, split_rows
from mixseq.spaces.mixed.settling import Settling, Sides
from mixseq.spaces.mixed.vertex_frames import VertexFrames, rest_poses
from mixseq.threads import one_blas_thread

JOINT = 0.001
"""What lengths and angles weigh in the metric, where unposed vertices, which weigh 1, tell of the same shape."""

EMBEDDING = 2.0
"""What lengths and angles weigh in embeddings; ours."""

SIDE = 0.1
"""What sides weigh in the metric."""


class AnchoredBlocks(NamedTuple):
    """The blocks of T vectors of the anchored space, for p parts.

    Attributes
    ----------
    lengths : (T, E')
        Edge lengths of joints.
    angles : (T, H')
        Hinge angles of joints in radians, unwrapped.
    unposed : (T, V, 3)
        Vertices as seen from their frames.
    sides : (T, f, 2, 3)
        Sides 01 and 02 of faces as seen from the faces' frames.
    rotations : (T, p, 4)
        Quaternions of the rotations from the mean shapes of the parts to the frame; signs do not jump.
    centres : (T, p, 3)
        Where the centres of the mean shapes go.
    """

    lengths: Float
    angles: Float
    unposed: Float
    sides: Float
    rotations: Float
    centres: Float


@dataclass(frozen=True, eq=False)
class AnchoredSpace(MixedSpace):
    """The mixed shape space with poses of all parts; make it with `mixed_space`.

    Attributes
    ----------
    shares : (V, p) sparse matrix
        How much vertices follow parts; rows add up to one.
    free : (V,) bool
        Vertices of joints: those of faces that bend, as `VertexFrames.bent` tells.
    known : (F,) bool
        Further faces whose lengths and angles are known: where meshes settle, those whose vertices would be wrong
        half-way between frames.
    relaxation : Relaxation
        How lengths and angles are made to agree; where frames are near each other no steps are taken.
    """

    shares: sparse.csr_array
    free: Mask
    known: Mask
    relaxation: Relaxation
    placement = "anchored"
    posed_parts = True

    @cached_property
    def edge_ids(self) -> Index:
        """Edges with a free vertex, or of a face that is known; ascending."""
        first, second = self.topology.edges.T
        stored = np.asarray(self.free[first] | self.free[second])
        stored[self.topology.face_edges[self.known]] = True
        return np.flatnonzero(stored)

    @cached_property
    def hinge_ids(self) -> Index:
        """Hinges with a free vertex, or of a face that is known; ascending."""
        stored = self.known | self.free[self.topology.faces].any(axis=1)
        first, second = self.topology.hinge_faces.T
        return np.flatnonzero(stored[first] | stored[second])

    @cached_property
    def frames(self) -> VertexFrames:
        """The frames of the vertices."""
        _, rotations, centres = self.registered(self.reference)
        rest = rest_poses(rotations, centres)
        return VertexFrames(self.topology, self.decomposition, rest, self.shares)

    @cached_property
    def seams(self) -> Sides:
        """The faces whose sides are known."""
        return Sides.of(self.topology.faces.astype(np.int64), self.free, self.reference)

    @cached_property
    def settling(self) -> Settling:
        """What makes lengths and angles agree."""
        return Settling.of(self.topology, self.reference, self.edge_ids, self.hinge_ids, self.relaxation)

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return (self.seams, self.settling) if self.relaxation.steps else (self.seams,)

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the blocks of a vector, in order."""
        parts, vertices = len(self.decomposition.parts), self.topology.vertex_count
        joints = len(self.edge_ids), len(self.hinge_ids)
        return (*joints, 3 * vertices, 6 * len(self.seams.faces), 4 * parts, 3 * parts)

    @property
    def dim(self) -> int:
        """Length D of a vector."""
        return sum(self.sizes)

    @property
    def rotation_count(self) -> int:
        """One for every part."""
        return len(self.decomposition.parts)

    @property
    def centre_count(self) -> int:
        """One for every part."""
        return len(self.decomposition.parts)

    @cached_property
    def weights(self) -> Float:
        """The metric ``(D,)``: by how many diagonals vertices move when a number of a vector changes by one.

        1 for unposed vertices and centres; `SIDE` for sides; `JOINT` for lengths, and for angles times the length of
        their edges; for a quaternion twice the radius of gyration of its part.
        """
        edges, _, vertices, sides, _, centres = self.sizes
        return np.concatenate(
            [
                np.full(edges, JOINT),
                JOINT * self.angle_weights,
                np.ones(vertices),
                np.full(sides, SIDE),
                np.repeat(2.0 * self.radii, 4),
                np.ones(centres),
            ]
        )

    @property
    def embedding_weights(self) -> Float:
        """Implement `ShapeSpace.embedding_weights`: unposed vertices hardly tell a pose, joints do."""
        edges, hinges, *_ = self.sizes
        joints = np.concatenate([np.full(edges, EMBEDDING), EMBEDDING * self.angle_weights])
        return np.concatenate([joints, self.shape_weights[edges + hinges :]])

    def split(self, vectors: Float) -> AnchoredBlocks:
        """Return the blocks of vectors ``(T, D)``, as views where possible; it raises what `checked` does."""
        lengths, angles, unposed, sides, turns, centres = split_rows(self.checked(vectors), self.sizes)
        count, parts = len(vectors), len(self.decomposition.parts)
        return AnchoredBlocks(
            lengths,
            angles,
            unposed.reshape(count, self.topology.vertex_count, 3),
            sides.reshape(count, len(self.seams.faces), 2, 3),
            turns.reshape(count, parts, 4),
            centres.reshape(count, parts, 3),
        )

    def join(self, blocks: AnchoredBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return joined_rows(*blocks)

    def encode_apart(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_apart`: angles are the smallest, quaternions agree within every body.

        A rigid motion of a frame changes nothing but its poses.
        """
        vectors = np.empty((len(points), self.dim))
        for vector, frame in zip(vectors, points, strict=True):
            x = frame.astype(np.float64) / self.scale
            _, rotations, centres = self.registered(x)
            turns = self.frames.signed(quaternions(rotations))
            motions = self.frames.motions(turns, centres)
            blocks = (*self._shape(motions, x), turns, centres)
            np.concatenate([block.reshape(-1) for block in blocks], out=vector)
        return vectors

    def _shape(self, motions: Float, x: Float) -> tuple[Float, Float, Float, Float]:
        """The shape of a frame ``(V, 3)`` whose vertices have these motions."""
        return *self.lengths_and_angles(x), kernels.unpose(motions, x), self.seams.local(motions, x)

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`."""
        blocks = self.split(vectors)
        before = None if previous is None else self.split(previous[None])
        start = self.reference_angles if before is None else before.angles[0]
        return self.join(
            blocks._replace(
                angles=unwrap_angles(blocks.angles, start),
                rotations=self.frames.continued(
                    blocks.rotations, None if before is None else before.rotations[:1]
                ),
            )
        )

    def anchored(self) -> AnchoredSpace:
        """Implement `ShapeSpace.anchored`."""
        return self

    @property
    def bodies(self) -> Index:
        """Implement `ShapeSpace.bodies`: parts that are connected."""
        return self.frames.bodies

    @cached_property
    def parents(self) -> Index:
        """Implement `ShapeSpace.parents`: neighbours one boundary nearer to the root, the part with most area."""
        return self.frames.parents(self.reference)

    @cached_property
    def neighbours(self) -> Neighbours:
        """Implement `ShapeSpace.neighbours`: across boundaries of parts."""
        return self.frames.neighbours(self.reference, self.radii)

    def predicted_placements(self, operator: Operator, placements: Float, times: Float) -> Float:
        """Implement `ShapeSpace.predicted_placements`: poses that agree with what neighbours see of each other."""
        return self.placements(predicted(operator, self.poses(placements), self.neighbours, times))

    def blended_placements(self, weights: Float, placements: Float) -> Float:
        """Implement `ShapeSpace.blended_placements`: poses that agree with what neighbours see of each other."""
        return np.asarray(self.placements(blended(weights, self.poses(placements), self.neighbours))[0])

    def decode(self, vectors: Float, progress: Progress = silent) -> Float:
        """Implement `ShapeSpace.decode`."""
        blocks = self.split(np.asarray(vectors, dtype=np.float64))
        points = np.empty((len(vectors), self.topology.vertex_count, 3))
        with one_blas_thread():
            for number, frame in enumerate(zip(*blocks, strict=True)):
                lengths, angles, unposed, sides, turns, centres = (
                    np.ascontiguousarray(each) for each in frame
                )
                motions = self.frames.motions(turns, centres)
                x = self.seams.settle(motions, sides, kernels.pose(motions, unposed))
                points[number] = self.settling.settled(x, lengths, angles) if self.relaxation.steps else x
                progress(number + 1, len(vectors), "decoding frames")
        points *= self.scale
        return points

    def decode_moving(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_moving` by the closed derivative, if no steps are taken."""
        if self.relaxation.steps:
            return super().decode_moving(vectors, rates)
        blocks, changes = self.split(np.asarray(vectors, dtype=np.float64)), self.split(rates)
        points, velocities = np.empty((2, len(vectors), self.topology.vertex_count, 3))
        with one_blas_thread():
            for number in range(len(vectors)):
                unposed, sides, turns, centres = (np.ascontiguousarray(block[number]) for block in blocks[2:])
                rows = [np.ascontiguousarray(block[number]) for block in changes[2:]]
                motions, moving = self.frames.moving(turns, centres, rows[2], rows[3])
                x = kernels.pose(motions, unposed)
                speeds = kernels.pose_moving(motions, moving, x, rows[0])
                points[number], velocities[number] = self.seams.settle_moving(
                    motions, moving, sides, rows[1], x, speeds
                )
        return points * self.scale, velocities * self.scale

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference`: vertices that did not move stay where they are."""
        blocks = self.split(vector[None])
        motions = self.frames.motions(blocks.rotations[0], blocks.centres[0])
        first, second = (self._shape(motions, x / self.scale) for x in (before, after))
        lengths, angles, unposed, sides = (b - a for a, b in zip(first, second, strict=True))
        return np.concatenate([block.reshape(-1) for block in (lengths, wrap(angles), unposed, sides)])
