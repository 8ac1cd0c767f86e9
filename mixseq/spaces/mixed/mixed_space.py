"""The mixed shape space S_m: near-rigid parts by their vertices and poses, joints by lengths and angles.

A vector, in diagonals and radians, is

``[joint lengths | joint angles | unposed vertices | part poses | relations | body poses | corrections]``

- Parts are registered to their mean shapes (paper, Section 3.4). Their relative poses, and the poses of the *bodies*
  they form, are those of `mixseq.spaces.mixed.articulation`: a rigid motion of a body changes only its six numbers.
- Vertices are skinned to the parts around them: the frame of a vertex is the blend of their motions from the reference
  frame, as dual quaternions (Kavan and others 2008). *Unposed* (rest-space) vertices are in these frames, where they
  would be in the reference frame. Inside a part that is the paper's aligned part vertex.
- Lengths and angles are those of *joint faces*, which would be wrong half-way between frames.
- Corrections are zero in encoded frames. Between frames they take blended part poses to the predicted ones
  (`mixseq.signals`).

P_m poses the vertices by the part poses that agree best with poses and relations, then moves those of joints
(`mixseq.spaces.mixed.joints`). Between far poses relaxation steps over the whole mesh follow (`mixseq.shells.shell`).
With the free placement P_m finds the poses of parts from lengths and angles (`mixseq.spaces.mixed.assembly`). All is
exact at the frames, and, except for these steps, analytic, with a derivative by a complex step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from mixseq.choices import PlacementName
from mixseq.errors import SettingsError
from mixseq.mesh.measures import dihedral_angles, edge_lengths, unwrap_angles, wrap_angles
from mixseq.mesh.rotations import (
    align_quat_signs,
    matrix_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    rotate_vectors,
    rotvec_to_quat,
)
from mixseq.mesh.topology import Topology
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, no_progress
from mixseq.segmentation.joints import Decomposition
from mixseq.shells.shell import Relaxation
from mixseq.spaces.base import ANGLE, ShapeSpace, radii_of_gyration
from mixseq.spaces.mixed import posing_kernels as kernels
from mixseq.spaces.mixed.articulation import Articulation, PartPoses, Steadiness, articulation_of
from mixseq.spaces.mixed.assembly import Assembly, FreeFrame
from mixseq.spaces.mixed.joints import BENDING_WEIGHT, JointProjection, Numbers, values_and_rates, with_rates
from mixseq.spaces.mixed.pose_prediction import PosePrediction
from mixseq.spaces.pieces import registered
from mixseq.spaces.temporal import Operator, Poses
from mixseq.types import Float, FloatArray, Index, Mask

JOINT_WEIGHT = 1e-3
"""Weight of lengths and angles in the metric. Unposed vertices weigh 1 and describe the same shape."""

JOINT_EMBEDDING_WEIGHT = 2.0
"""Weight of lengths and angles in embeddings."""

MAX_EDIT_ROUNDS, EDIT_TOLERANCE = 12, 1e-11
"""Limit of rounds to reach an edited frame, and the error to stop at, in diagonals."""

ARTICULATION_WEIGHT = 0.2
"""Weight of part poses in the metric, relative to the vertices they move."""

PROJECTION_WEIGHT_RANGE = (1e-6, 1e6)
"""Range of `hold` and `relations`; beyond it systems of equations are singular."""

LENGTH_STEP_RATIO = 1 / 4
"""Rounding step of lengths over that of positions, where P_m takes relaxation steps."""

MAX_ANGLE_STEP_RATIO = 64
"""Largest rounding step of angles in radians over that of positions in diagonals."""


@dataclass(frozen=True)
class Projection:
    """Settings of the projection P_m; raises `SettingsError` if a number is out of range."""

    placement: PlacementName = "anchored"  # parts at their poses, or where lengths and angles put them
    share: float = 0.0  # share of lengths and angles of joints, from 0 (posed vertices) to 1 (the vector)
    hold: float = 0.1  # weight of posed vertices at joints
    steps: int = 0  # relaxation steps over the lengths and angles of the whole mesh
    relations: float = 0.1  # weight of relations between neighbours against poses of parts that move equally

    def __post_init__(self) -> None:
        weight = ("positive weight", *PROJECTION_WEIGHT_RANGE)
        ranges = {"share": ("number", 0.0, 1.0), "hold": weight, "relations": weight}
        for name, (kind, low, high) in ranges.items():
            number = getattr(self, name)
            if not (isinstance(number, int | float | np.number) and low <= number <= high):
                raise SettingsError(f"{name} is {number!r}; a {kind} from {low:g} to {high:g} is expected")
        if not isinstance(self.steps, int | np.integer) or self.steps < 0:
            raise SettingsError(f"steps is {self.steps!r}; a whole number of 0 or more is expected")


class MixedBlocks(NamedTuple):
    """The blocks of T vectors: p parts with n relations, and B bodies."""

    lengths: Numbers  # (T, E') edge lengths of joint faces, in diagonals
    angles: Numbers  # (T, H') hinge angles of joint faces, in radians, unwrapped
    unposed: Numbers  # (T, V, 3) vertices as seen from their frames
    turns: Numbers  # (T, p, 4) quaternions of parts since the reference frame, seen from their bodies
    centres: Numbers  # (T, p, 3) centres of parts, seen from their bodies
    relation_turns: Numbers  # (T, n, 4) quaternions of parts since the reference frame, seen from neighbours
    relation_points: Numbers  # (T, n, 3) pivots of parts, seen from neighbours
    body_turns: Numbers  # (T, B, 4) quaternions of the bodies since the reference frame
    body_centres: Numbers  # (T, B, 3) centres of the bodies
    # (T, 6 p) rotation vectors of parts in their own axes, and shifts as seen from the body.
    corrections: Numbers

    @property
    def parts(self) -> PartPoses:
        """Poses and relations of parts."""
        return PartPoses(*self[3:7])


QUATERNION_BLOCKS = ("turns", "relation_turns", "body_turns")
"""Names of the blocks of quaternions."""


@dataclass(frozen=True, eq=False)
class MixedSpace(ShapeSpace):
    """The mixed shape space of one mesh sequence; made by `mixed_space`."""

    topology: Topology
    decomposition: Decomposition  # parts, and the strips between them
    scale: float  # unit of length, in the units of the sequence: the diagonal of the first frame
    shapes: Float  # (N, 3) mean shapes of all parts, each centred, part by part, in diagonals
    reference: Float  # (V, 3) the first frame, in diagonals
    skinning_weights: sparse.csr_array  # (V, p) of vertices and parts; rows add up to one
    steadiness: Steadiness | None  # inverse variances of part poses and relations, their weights in P_m
    joint_faces: Mask  # (F,) faces with lengths and angles in the vector
    projection: Projection  # settings of P_m
    name = "mixed"

    @property
    def decomposed(self) -> Decomposition:
        """Implement `ShapeSpace.decomposed`."""
        return self.decomposition

    @property
    def vertex_count(self) -> int:  # type: ignore[override]
        """Implement `ShapeSpace.vertex_count`."""
        return self.topology.vertex_count

    @property
    def placement(self) -> PlacementName:
        """The placement of the projection."""
        return self.projection.placement

    @property
    def edge_ids(self) -> Index:
        """Edges ``(E',)`` whose lengths are in a vector, ascending."""
        return self.joints.edge_ids

    @property
    def hinge_ids(self) -> Index:
        """Hinges ``(H',)`` whose angles are in a vector, ascending."""
        return self.joints.hinge_ids

    @cached_property
    def joints(self) -> JointProjection:
        """The projection at the joints."""
        return JointProjection(self.topology, self.reference, self.joint_faces, self.projection.hold)

    @cached_property
    def assembly(self) -> Assembly:
        """The projection of the free placement."""
        return Assembly(
            self.topology,
            self.only_part,
            self.joint_faces,
            self.edge_ids,
            self.hinge_ids,
            self.reference,
            Relaxation(BENDING_WEIGHT, self.projection.steps),
        )

    @cached_property
    def only_part(self) -> Index:
        """Part ``(V,)`` of vertices skinned to one part alone, -1 for others."""
        weights = self.skinning_weights
        first = weights.indices[weights.indptr[:-1]]
        return np.where(np.diff(weights.indptr) == 1, first, -1).astype(np.int64)

    @cached_property
    def _skinning(self) -> tuple[Index, Index, Float]:
        weights = self.skinning_weights
        return weights.indptr.astype(np.int64), weights.indices.astype(np.int64), weights.data

    @cached_property
    def _rest(self) -> Poses:
        """Poses of the parts in the reference frame, from their mean shapes."""
        _, rotations, centres = registered(self.shapes, self.decomposition.parts, self.reference)
        return Poses(matrix_to_quat(rotations)[None], centres[None])

    @cached_property
    def radii(self) -> Float:
        """Radii of gyration ``(p,)`` of the parts, in diagonals; at least a small number."""
        return radii_of_gyration(self.shapes, self.decomposition.parts)

    @cached_property
    def articulation(self) -> Articulation:
        """Bodies, and relations of neighbouring parts."""
        return articulation_of(
            self.topology,
            self.decomposition,
            self.reference,
            self._rest.centres[0],
            self.radii,
            self.steadiness,
            self.projection.relations,
        )

    def cached_values(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.cached_values`."""
        _ = self.articulation._systems, self.articulation._tree, self._skinning, self.sizes
        if self.placement == "free":
            return (self.assembly,)
        if self.projection.steps:
            return self.joints, self.joints.shell
        return (self.joints,) if self.projection.share else ()

    # The vector --------------------------------------------------------------------------------------------

    @cached_property
    def _block_shapes(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of the blocks of a vector, in order."""
        parts, relations = len(self.decomposition.parts), len(self.articulation.pairs)
        bodies = self.articulation.body_count
        return (
            (len(self.edge_ids),),
            (len(self.hinge_ids),),
            (self.vertex_count, 3),
            (parts, 4),
            (parts, 3),
            (relations, 4),
            (relations, 3),
            (bodies, 4),
            (bodies, 3),
            (6 * parts,),
        )

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the blocks of a vector, in order."""
        return tuple(int(np.prod(shape)) for shape in self._block_shapes)

    @property
    def dim(self) -> int:
        """Length D of a vector."""
        return sum(self.sizes)

    @property
    def rotation_count(self) -> int:
        """One for every body."""
        return self.articulation.body_count

    @property
    def centre_count(self) -> int:
        """One for every body."""
        return self.articulation.body_count

    @property
    def correction_dim(self) -> int:
        """Implement `ShapeSpace.correction_dim`: six numbers per part."""
        return self.sizes[-1]

    @property
    def pose_dim(self) -> int:
        """Implement `ShapeSpace.pose_dim`: poses and relations of parts."""
        return sum(self.sizes[3:7])

    @cached_property
    def angle_weights(self) -> Float:
        """Weights ``(H',)`` of angles relative to lengths: `ANGLE` times the length of the edge in the reference."""
        edges = self.topology.edges[self.topology.hinge_edges[self.hinge_ids]]
        return ANGLE * edge_lengths(self.reference, edges)

    @cached_property
    def weights(self) -> Float:
        """Metric ``(D,)``: vertex displacement in diagonals per unit of each coordinate.

        1 for unposed vertices and centres of bodies; twice a radius of gyration for quaternions; `ARTICULATION_WEIGHT`
        times that, for all vertices of the part, for part poses; `JOINT_WEIGHT` for lengths, and for angles times the
        length of their edges. Relations follow part poses, and weigh nothing.
        """
        edges, _, vertices, *_ = self.sizes
        own = ARTICULATION_WEIGHT * np.sqrt(self.articulation.masses)
        return np.concatenate(
            [
                np.full(edges, JOINT_WEIGHT),
                JOINT_WEIGHT * self.angle_weights,
                np.ones(vertices),
                np.repeat(2.0 * self.radii * own, 4),
                np.repeat(own, 3),
                np.zeros(sum(self.sizes[5:7])),
                np.repeat(2.0 * self.articulation.body_radii, 4),
                np.ones(self.sizes[8]),
                np.repeat(self.radii, 3),
                np.ones(self.sizes[9] // 2),
            ]
        )

    @property
    def coarseness(self) -> Float:
        """Implement `ShapeSpace.coarseness`: angles rotate short edges, steps magnify errors of lengths."""
        edges, hinges, *_ = self.sizes
        result = np.ones(self.shape_dim)
        if self.projection.steps:
            result[:edges] = LENGTH_STEP_RATIO
        if self.placement == "anchored":
            sizes = np.clip(self.angle_weights / ANGLE, 1 / MAX_ANGLE_STEP_RATIO, 1.0)
            result[edges : edges + hinges] = 2.0 ** np.floor(-np.log2(sizes))
        return result

    @property
    def embedding_weights(self) -> Float:
        """Implement `ShapeSpace.embedding_weights`: mostly joints and part poses."""
        edges, hinges, *_ = self.sizes
        joints = np.concatenate(
            [np.full(edges, JOINT_EMBEDDING_WEIGHT), JOINT_EMBEDDING_WEIGHT * self.angle_weights]
        )
        rest = self.shape_weights[edges + hinges :].copy()
        rest[self.sizes[2] :] /= ARTICULATION_WEIGHT
        return np.concatenate([joints, rest])

    def split(self, vectors: Numbers) -> MixedBlocks:
        """Return the blocks of vectors ``(T, D)``, as views where possible; raises what `checked` does."""
        return MixedBlocks(*self._shaped(self.checked(vectors), slice(None)))

    def join(self, blocks: MixedBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return np.concatenate([block.reshape(len(block), -1) for block in blocks], axis=1)

    def part_poses(self, poses: Float) -> PartPoses:
        """Return the poses and relations of parts from the pose columns ``(T, pose_dim)`` of shapes."""
        return PartPoses(*self._shaped(poses, slice(3, 7)))

    def _shaped(self, columns: Numbers, which: slice) -> Iterator[Numbers]:
        """Cut columns ``(T, n)`` into some blocks of vectors."""
        blocks = np.split(columns, np.cumsum(self.sizes[which])[:-1], axis=1)
        shaped = zip(blocks, self._block_shapes[which], strict=True)
        return (block.reshape(len(columns), *shape) for block, shape in shaped)

    # Encoding ----------------------------------------------------------------------------------------------

    def encode_apart(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_apart`: the smallest angles, and quaternions with w >= 0."""
        frames = [frame.astype(np.float64) / self.scale for frame in points]
        found = [registered(self.shapes, self.decomposition.parts, x)[1:] for x in frames]
        rotations, centres = (np.stack(each) for each in zip(*found, strict=True))
        turns = quat_multiply(matrix_to_quat(rotations), quat_conjugate(self._rest.rotations))
        world = Poses(turns, centres)
        bodies = self.articulation.bodies_of(world)
        parts = self.articulation.with_relations(self.articulation.seen_from_bodies(world, bodies))
        parts = parts._replace(turns=_canonical(parts.turns), relation_turns=_canonical(parts.relation_turns))
        none = np.zeros((len(frames), self.correction_dim))
        rows = zip(*parts, bodies.rotations, bodies.centres, none, strict=True)
        duals = [self.articulation.motions(PartPoses(*row[:4]), (row[4], row[5]), row[6]) for row in rows]
        unposed = [self._unposed(dual, x) for dual, x in zip(duals, frames, strict=True)]
        joints = [self.lengths_and_angles(x) for x in frames]
        lengths, angles = (np.stack(each) for each in zip(*joints, strict=True))
        return self.join(
            MixedBlocks(lengths, angles, np.stack(unposed), *parts, bodies.rotations, bodies.centres, none)
        )

    def lengths_and_angles(self, x: Float) -> tuple[Float, Float]:
        """Return the lengths ``(..., E')`` and angles ``(..., H')`` of joints in frames ``(..., V, 3)``."""
        edges, hinges = self.topology.edges[self.edge_ids], self.topology.hinges_at(self.hinge_ids)
        return edge_lengths(x, edges), dihedral_angles(x, hinges)

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`."""
        blocks = self.split(vectors)
        before = None if previous is None else self.split(previous[None])
        start = self.lengths_and_angles(self.reference)[1] if before is None else before.angles[0]
        signed = {
            name: align_quat_signs(
                getattr(blocks, name), None if before is None else getattr(before, name)[0]
            )
            for name in QUATERNION_BLOCKS
        }
        return self.join(blocks._replace(angles=unwrap_angles(blocks.angles, start), **signed))

    def _unposed(self, duals: Float, x: Float) -> Float:
        return np.asarray(kernels.unpose(*self._skinning, duals, x))

    def _duals(self, row: MixedBlocks) -> Numbers:
        """Motions ``(p, 8)`` of the parts in one frame."""
        bodies = np.ascontiguousarray(row.body_turns), np.ascontiguousarray(row.body_centres)
        return self.articulation.motions(row.parts, bodies, np.ascontiguousarray(row.corrections))

    # Decoding ----------------------------------------------------------------------------------------------

    def decode(self, vectors: Float, progress: Progress = no_progress) -> Float:
        """Implement `ShapeSpace.decode`: the projection P_m, frame by frame."""
        blocks = self.split(np.asarray(vectors, dtype=np.float64))
        points = np.empty((len(vectors), self.vertex_count, 3))
        with one_blas_thread():
            for number, frame in enumerate(zip(*blocks, strict=True)):
                points[number] = self._projected(MixedBlocks(*frame))
                progress(number + 1, len(vectors), "decoding frames")
        points *= self.scale
        return points

    def _projected(self, row: MixedBlocks) -> Numbers:
        """Return the mesh ``(V, 3)`` of one vector, in diagonals; complex for a complex vector of an analytic P_m."""
        x = self._posed(row)
        lengths, angles = (np.ascontiguousarray(block) for block in (row.lengths, row.angles))
        if self.placement == "free":
            return self.assembly.assemble(FreeFrame(lengths, angles, row.unposed, x)).points
        moved = self.joints.project(x, lengths, angles, self.projection.share)
        if not self.projection.steps:
            return moved
        targets = self.joints.targets(x, lengths, angles)
        return self.joints.shell.relaxed(moved, *targets, self.projection.steps).points

    def _posed(self, row: MixedBlocks) -> Numbers:
        return np.asarray(kernels.pose(*self._skinning, self._duals(row), np.ascontiguousarray(row.unposed)))

    def posed(self, vectors: Float) -> Float:
        """Return posed vertices ``(T, V, 3)`` of vectors ``(T, D)``, in diagonals, before the projection at joints."""
        rows = zip(*self.split(vectors), strict=True)
        return np.stack([self._posed(MixedBlocks(*row)) for row in rows])

    def decode_moving(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_moving` by a complex step, where all of P_m is analytic."""
        if self.projection.steps or self.placement == "free":
            return super().decode_moving(vectors, rates)
        blocks = self.split(with_rates(np.asarray(vectors, dtype=np.float64), rates))
        points, velocities = np.empty((2, len(vectors), self.vertex_count, 3))
        with one_blas_thread():
            for number, frame in enumerate(zip(*blocks, strict=True)):
                points[number], velocities[number] = values_and_rates(self._projected(MixedBlocks(*frame)))
        return points * self.scale, velocities * self.scale

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference` with constant part poses; between frames it takes several rounds."""
        changed, found, size = vector.copy(), before, self.shape_dim
        rest, offset = np.inf, before - self.decode(vector[None])[0]
        for _ in range(MAX_EDIT_ROUNDS):
            tried = changed.copy()
            tried[:size] += self._measured_difference(changed, found, after)
            found = self.decode(tried[None])[0] + offset
            left = float(np.abs(found - after).max())
            if left > 0.5 * rest:
                break
            changed, rest = tried, left
            if rest <= EDIT_TOLERANCE * self.scale:
                break
        return changed[:size] - vector[:size]

    def _measured_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Return the differences ``(S,)`` of lengths, angles and unposed vertices of two frames."""
        row = MixedBlocks(*(block[0] for block in self.split(vector[None])))
        duals = self._duals(row)
        first, second = (x / self.scale for x in (before, after))
        (lengths, angles), (other_lengths, other_angles) = map(self.lengths_and_angles, (first, second))
        unposed = self._unposed(duals, second) - self._unposed(duals, first)
        change = other_lengths - lengths, wrap_angles(other_angles - angles), unposed.reshape(-1)
        return np.concatenate([*change, np.zeros(self.pose_dim)])

    # Between frames ----------------------------------------------------------------------------------------

    def predicted_poses(
        self, operator: Operator, poses: Float, placements: Float, times: Float, in_body: bool
    ) -> tuple[Float, Float]:
        """Implement `ShapeSpace.predicted_poses`: in the world, optionally in the body, and by neighbours."""
        found, seen = self.pose_prediction(operator, poses, placements, in_body).at(times)
        before = self.poses(placements[:1]).rotations[0]
        placed = self.placements(found._replace(rotations=align_quat_signs(found.rotations, before)))
        return np.concatenate([each.reshape(len(times), -1) for each in seen], axis=1), placed

    def pose_prediction(
        self, operator: Operator, poses: Float, placements: Float, in_body: bool
    ) -> PosePrediction:
        """Return the prediction of poses from those at the frames ``(T, pose_dim)``, ``(T, P)``."""
        parts = self.part_poses(poses)
        world = self.articulation.placed(Poses(parts.turns, parts.centres), self.poses(placements))
        world = world._replace(rotations=align_quat_signs(world.rotations))
        return PosePrediction(self.articulation, operator, world, in_body)

    def held(self, points: Float, vertices: Index, placements: Float) -> Float:
        """Implement `ShapeSpace.held`: in the axes of the body of each vertex's main part."""
        bodies = self.poses(placements)
        weights = self.skinning_weights[vertices]
        body = self.articulation.bodies[np.asarray(weights.argmax(axis=1)).reshape(-1)]
        back = np.swapaxes(quat_to_matrix(bodies.rotations), -1, -2)[:, body]
        return rotate_vectors(back, points - self.scale * bodies.centres[:, body])

    def signs(self, poses: Float, before: Float) -> Float:
        """Implement `ShapeSpace.signs`."""
        here, there = self.part_poses(poses[None]), self.part_poses(before[None])
        turns, relations = (
            np.where(np.einsum("tpi,tpi->p", one, other) < 0, -1.0, 1.0)
            for one, other in zip(here[::2], there[::2], strict=True)
        )
        blocks = (turns, 4), (np.ones_like(turns), 3), (relations, 4), (np.ones_like(relations), 3)
        return np.concatenate([np.repeat(factors, size) for factors, size in blocks])

    def corrections(self, poses: Float, targets: Float) -> Float:
        """Implement `ShapeSpace.corrections`."""
        parts = len(self.decomposition.parts)
        turns, centres = np.split(targets, [4 * parts], axis=1)
        wanted = Poses(turns.reshape(-1, parts, 4), centres.reshape(-1, parts, 3))
        return self.articulation.corrections(self.articulation.agreed(self.part_poses(poses)), wanted)

    def corrected_poses(self, poses: Float, corrections: Float) -> Poses:
        """Return part poses ``(T, p)`` relative to bodies, of pose columns and corrections ``(T, ...)``."""
        agreed = self.articulation.agreed(self.part_poses(poses))
        spins, shifts = corrections.reshape(len(poses), 2, -1, 3).swapaxes(0, 1)
        return Poses(quat_multiply(agreed.rotations, rotvec_to_quat(spins)), agreed.centres + shifts)


def as_mixed(space: ShapeSpace) -> MixedSpace:
    """Return a mixed shape space unchanged, or raise for other spaces."""
    if not isinstance(space, MixedSpace):
        raise SettingsError(f"the {space.name} space has no parts; fit a model with space='mixed'")
    return space


def _canonical(turns: Float) -> Float:
    """Return quaternions ``(..., 4)`` with w >= 0: rotations by at most half a turn."""
    return np.where(turns[..., :1] < 0, -turns, turns)
