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
(`mixseq.spaces.mixed.joint_projection`). Between far poses relaxation steps over the whole mesh follow
(`mixseq.shells.shell`). With the free placement P_m finds the poses of parts from lengths and angles
(`mixseq.spaces.mixed.assembly`). All is exact at the frames, and, except for these steps, analytic, with a derivative
by a complex step.
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
from mixseq.spaces.base import ANGLE_WEIGHT, ShapeSpace, radii_of_gyration
from mixseq.spaces.mixed import posing_kernels as kernels
from mixseq.spaces.mixed.articulation import Articulation, PartPoses, Steadiness, find_articulation
from mixseq.spaces.mixed.assembly import Assembly, FreeFrame
from mixseq.spaces.mixed.joint_projection import (
    BENDING_WEIGHT,
    JointProjection,
    RealOrComplex,
    from_complex_step,
    to_complex_step,
)
from mixseq.spaces.mixed.pose_interpolation import PoseInterpolation
from mixseq.spaces.pieces import register_parts
from mixseq.spaces.temporal import Poses, TemporalOperator
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

    lengths: RealOrComplex  # (T, E') edge lengths of joint faces, in diagonals
    angles: RealOrComplex  # (T, H') hinge angles of joint faces, in radians, unwrapped
    rest_vertices: RealOrComplex  # (T, V, 3) vertices as seen from their frames
    part_rotations: (
        RealOrComplex  # (T, p, 4) quaternions of parts since the reference frame, seen from their bodies
    )
    part_centres: RealOrComplex  # (T, p, 3) centres of parts, seen from their bodies
    relation_rotations: (
        RealOrComplex  # (T, n, 4) quaternions of parts since the reference frame, seen from neighbours
    )
    relation_points: RealOrComplex  # (T, n, 3) pivots of parts, seen from neighbours
    body_rotations: RealOrComplex  # (T, B, 4) quaternions of the bodies since the reference frame
    body_centres: RealOrComplex  # (T, B, 3) centres of the bodies
    # (T, 6 p) rotation vectors of parts in their own axes, and shifts as seen from the body.
    corrections: RealOrComplex

    @property
    def part_poses(self) -> PartPoses:
        """Poses and relations of parts."""
        return PartPoses(*self[3:7])


QUATERNION_BLOCKS = ("part_rotations", "relation_rotations", "body_rotations")
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
    def segmentation(self) -> Decomposition:
        """Implement `ShapeSpace.segmentation`."""
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
        return self.joint_projection.edge_ids

    @property
    def hinge_ids(self) -> Index:
        """Hinges ``(H',)`` whose angles are in a vector, ascending."""
        return self.joint_projection.hinge_ids

    @cached_property
    def joint_projection(self) -> JointProjection:
        """The projection at the joints."""
        return JointProjection(self.topology, self.reference, self.joint_faces, self.projection.hold)

    @cached_property
    def assembly(self) -> Assembly:
        """The projection of the free placement."""
        return Assembly(
            self.topology,
            self.rigid_part_of_vertex,
            self.joint_faces,
            self.edge_ids,
            self.hinge_ids,
            self.reference,
            Relaxation(BENDING_WEIGHT, self.projection.steps),
        )

    @cached_property
    def rigid_part_of_vertex(self) -> Index:
        """Part ``(V,)`` of vertices skinned to one part alone, -1 for others."""
        weights = self.skinning_weights
        first = weights.indices[weights.indptr[:-1]]
        return np.where(np.diff(weights.indptr) == 1, first, -1).astype(np.int64)

    @cached_property
    def _skinning(self) -> tuple[Index, Index, Float]:
        weights = self.skinning_weights
        return weights.indptr.astype(np.int64), weights.indices.astype(np.int64), weights.data

    @cached_property
    def _rest_poses(self) -> Poses:
        """Poses of the parts in the reference frame, from their mean shapes."""
        _, rotations, centres = register_parts(self.shapes, self.decomposition.parts, self.reference)
        return Poses(matrix_to_quat(rotations)[None], centres[None])

    @cached_property
    def part_radii(self) -> Float:
        """Radii of gyration ``(p,)`` of the parts, in diagonals; at least a small number."""
        return radii_of_gyration(self.shapes, self.decomposition.parts)

    @cached_property
    def articulation(self) -> Articulation:
        """Bodies, and relations of neighbouring parts."""
        return find_articulation(
            self.topology,
            self.decomposition,
            self.reference,
            self._rest_poses.centres[0],
            self.part_radii,
            self.steadiness,
            self.projection.relations,
        )

    def cached_values(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.cached_values`."""
        _ = self.articulation._systems, self.articulation._tree, self._skinning, self.block_sizes
        if self.placement == "free":
            return (self.assembly,)
        if self.projection.steps:
            return self.joint_projection, self.joint_projection.shell
        return (self.joint_projection,) if self.projection.share else ()

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
    def block_sizes(self) -> tuple[int, ...]:
        """Lengths of the blocks of a vector, in order."""
        return tuple(int(np.prod(shape)) for shape in self._block_shapes)

    @property
    def dim(self) -> int:
        """Length D of a vector."""
        return sum(self.block_sizes)

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
        return self.block_sizes[-1]

    @property
    def pose_dim(self) -> int:
        """Implement `ShapeSpace.pose_dim`: poses and relations of parts."""
        return sum(self.block_sizes[3:7])

    @cached_property
    def angle_weights(self) -> Float:
        """Weights ``(H',)`` of angles relative to lengths: `ANGLE` times the length of the edge in the reference."""
        edges = self.topology.edges[self.topology.hinge_edges[self.hinge_ids]]
        return ANGLE_WEIGHT * edge_lengths(self.reference, edges)

    @cached_property
    def weights(self) -> Float:
        """Metric ``(D,)``: vertex displacement in diagonals per unit of each coordinate.

        1 for unposed vertices and centres of bodies; twice a radius of gyration for quaternions; `ARTICULATION_WEIGHT`
        times that, for all vertices of the part, for part poses; `JOINT_WEIGHT` for lengths, and for angles times the
        length of their edges. Relations follow part poses, and weigh nothing.
        """
        edges, _, vertices, *_ = self.block_sizes
        own = ARTICULATION_WEIGHT * np.sqrt(self.articulation.masses)
        return np.concatenate(
            [
                np.full(edges, JOINT_WEIGHT),
                JOINT_WEIGHT * self.angle_weights,
                np.ones(vertices),
                np.repeat(2.0 * self.part_radii * own, 4),
                np.repeat(own, 3),
                np.zeros(sum(self.block_sizes[5:7])),
                np.repeat(2.0 * self.articulation.body_radii, 4),
                np.ones(self.block_sizes[8]),
                np.repeat(self.part_radii, 3),
                np.ones(self.block_sizes[9] // 2),
            ]
        )

    @property
    def rounding_step_ratios(self) -> Float:
        """Implement `ShapeSpace.rounding_step_ratios`: angles rotate short edges, steps magnify errors of lengths."""
        edges, hinges, *_ = self.block_sizes
        result = np.ones(self.shape_dim)
        if self.projection.steps:
            result[:edges] = LENGTH_STEP_RATIO
        if self.placement == "anchored":
            sizes = np.clip(self.angle_weights / ANGLE_WEIGHT, 1 / MAX_ANGLE_STEP_RATIO, 1.0)
            result[edges : edges + hinges] = 2.0 ** np.floor(-np.log2(sizes))
        return result

    @property
    def embedding_weights(self) -> Float:
        """Implement `ShapeSpace.embedding_weights`: mostly joints and part poses."""
        edges, hinges, *_ = self.block_sizes
        joints = np.concatenate(
            [np.full(edges, JOINT_EMBEDDING_WEIGHT), JOINT_EMBEDDING_WEIGHT * self.angle_weights]
        )
        rest = self.shape_weights[edges + hinges :].copy()
        rest[self.block_sizes[2] :] /= ARTICULATION_WEIGHT
        return np.concatenate([joints, rest])

    def split(self, vectors: RealOrComplex) -> MixedBlocks:
        """Return the blocks of vectors ``(T, D)``, as views where possible; raises what `checked` does."""
        return MixedBlocks(*self._split_columns(self.check_vectors(vectors), slice(None)))

    def join(self, blocks: MixedBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return np.concatenate([block.reshape(len(block), -1) for block in blocks], axis=1)

    def split_poses(self, poses: Float) -> PartPoses:
        """Return the poses and relations of parts from the pose columns ``(T, pose_dim)`` of shapes."""
        return PartPoses(*self._split_columns(poses, slice(3, 7)))

    def _split_columns(self, columns: RealOrComplex, which: slice) -> Iterator[RealOrComplex]:
        """Cut columns ``(T, n)`` into some blocks of vectors."""
        blocks = np.split(columns, np.cumsum(self.block_sizes[which])[:-1], axis=1)
        shaped = zip(blocks, self._block_shapes[which], strict=True)
        return (block.reshape(len(columns), *shape) for block, shape in shaped)

    # Encoding ----------------------------------------------------------------------------------------------

    def encode_independently(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_independently`: the smallest angles, and quaternions with w >= 0."""
        frames = [frame.astype(np.float64) / self.scale for frame in points]
        found = [register_parts(self.shapes, self.decomposition.parts, x)[1:] for x in frames]
        rotations, centres = (np.stack(each) for each in zip(*found, strict=True))
        turns = quat_multiply(matrix_to_quat(rotations), quat_conjugate(self._rest_poses.rotations))
        world = Poses(turns, centres)
        bodies = self.articulation.fit_bodies(world)
        parts = self.articulation.add_relations(self.articulation.to_body_axes(world, bodies))
        parts = parts._replace(
            rotations=_with_positive_w(parts.rotations),
            relation_rotations=_with_positive_w(parts.relation_rotations),
        )
        none = np.zeros((len(frames), self.correction_dim))
        rows = zip(*parts, bodies.rotations, bodies.centres, none, strict=True)
        duals = [
            self.articulation.part_motions(PartPoses(*row[:4]), (row[4], row[5]), row[6]) for row in rows
        ]
        unposed = [self._unskin(dual, x) for dual, x in zip(duals, frames, strict=True)]
        joints = [self.measure_joints(x) for x in frames]
        lengths, angles = (np.stack(each) for each in zip(*joints, strict=True))
        return self.join(
            MixedBlocks(lengths, angles, np.stack(unposed), *parts, bodies.rotations, bodies.centres, none)
        )

    def measure_joints(self, x: Float) -> tuple[Float, Float]:
        """Return the lengths ``(..., E')`` and angles ``(..., H')`` of joints in frames ``(..., V, 3)``."""
        edges, hinges = self.topology.edges[self.edge_ids], self.topology.hinges_at(self.hinge_ids)
        return edge_lengths(x, edges), dihedral_angles(x, hinges)

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`."""
        blocks = self.split(vectors)
        before = None if previous is None else self.split(previous[None])
        start = self.measure_joints(self.reference)[1] if before is None else before.angles[0]
        signed = {
            name: align_quat_signs(
                getattr(blocks, name), None if before is None else getattr(before, name)[0]
            )
            for name in QUATERNION_BLOCKS
        }
        return self.join(blocks._replace(angles=unwrap_angles(blocks.angles, start), **signed))

    def _unskin(self, duals: Float, x: Float) -> Float:
        return np.asarray(kernels.unskin_vertices(*self._skinning, duals, x))

    def _part_motions(self, row: MixedBlocks) -> RealOrComplex:
        """Motions ``(p, 8)`` of the parts in one frame."""
        bodies = np.ascontiguousarray(row.body_rotations), np.ascontiguousarray(row.body_centres)
        return self.articulation.part_motions(row.part_poses, bodies, np.ascontiguousarray(row.corrections))

    # Decoding ----------------------------------------------------------------------------------------------

    def decode(self, vectors: Float, progress: Progress = no_progress) -> Float:
        """Implement `ShapeSpace.decode`: the projection P_m, frame by frame."""
        blocks = self.split(np.asarray(vectors, dtype=np.float64))
        points = np.empty((len(vectors), self.vertex_count, 3))
        with one_blas_thread():
            for number, frame in enumerate(zip(*blocks, strict=True)):
                points[number] = self._project(MixedBlocks(*frame))
                progress(number + 1, len(vectors), "decoding frames")
        points *= self.scale
        return points

    def _project(self, row: MixedBlocks) -> RealOrComplex:
        """Return the mesh ``(V, 3)`` of one vector, in diagonals; complex for a complex vector of an analytic P_m."""
        x = self._skin(row)
        lengths, angles = (np.ascontiguousarray(block) for block in (row.lengths, row.angles))
        if self.placement == "free":
            return self.assembly.assemble(FreeFrame(lengths, angles, row.rest_vertices, x)).points
        moved = self.joint_projection.project(x, lengths, angles, self.projection.share)
        if not self.projection.steps:
            return moved
        targets = self.joint_projection.mesh_targets(x, lengths, angles)
        return self.joint_projection.shell.relax(moved, *targets, self.projection.steps).points

    def _skin(self, row: MixedBlocks) -> RealOrComplex:
        return np.asarray(
            kernels.skin_vertices(
                *self._skinning, self._part_motions(row), np.ascontiguousarray(row.rest_vertices)
            )
        )

    def skin(self, vectors: Float) -> Float:
        """Return posed vertices ``(T, V, 3)`` of vectors ``(T, D)``, in diagonals, before the projection at joints."""
        rows = zip(*self.split(vectors), strict=True)
        return np.stack([self._skin(MixedBlocks(*row)) for row in rows])

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_with_velocities` by a complex step, where all of P_m is analytic."""
        if self.projection.steps or self.placement == "free":
            return super().decode_with_velocities(vectors, rates)
        blocks = self.split(to_complex_step(np.asarray(vectors, dtype=np.float64), rates))
        points, velocities = np.empty((2, len(vectors), self.vertex_count, 3))
        with one_blas_thread():
            for number, frame in enumerate(zip(*blocks, strict=True)):
                points[number], velocities[number] = from_complex_step(self._project(MixedBlocks(*frame)))
        return points * self.scale, velocities * self.scale

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference` with constant part poses; between frames it takes several rounds."""
        changed, found, size = vector.copy(), before, self.shape_dim
        rest, offset = np.inf, before - self.decode(vector[None])[0]
        for _ in range(MAX_EDIT_ROUNDS):
            tried = changed.copy()
            tried[:size] += self._rest_difference(changed, found, after)
            found = self.decode(tried[None])[0] + offset
            left = float(np.abs(found - after).max())
            if left > 0.5 * rest:
                break
            changed, rest = tried, left
            if rest <= EDIT_TOLERANCE * self.scale:
                break
        return changed[:size] - vector[:size]

    def _rest_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Return the differences ``(S,)`` of lengths, angles and unposed vertices of two frames."""
        row = MixedBlocks(*(block[0] for block in self.split(vector[None])))
        duals = self._part_motions(row)
        first, second = (x / self.scale for x in (before, after))
        (lengths, angles), (other_lengths, other_angles) = map(self.measure_joints, (first, second))
        unposed = self._unskin(duals, second) - self._unskin(duals, first)
        change = other_lengths - lengths, wrap_angles(other_angles - angles), unposed.reshape(-1)
        return np.concatenate([*change, np.zeros(self.pose_dim)])

    # Between frames ----------------------------------------------------------------------------------------

    def interpolate_poses(
        self, operator: TemporalOperator, poses: Float, placements: Float, times: Float, in_body: bool
    ) -> tuple[Float, Float]:
        """Implement `ShapeSpace.interpolate_poses`: in the world, optionally in the body, and by neighbours."""
        found, seen = self.pose_interpolation(operator, poses, placements, in_body).at(times)
        before = self.unpack_placements(placements[:1]).rotations[0]
        placed = self.pack_placements(found._replace(rotations=align_quat_signs(found.rotations, before)))
        return np.concatenate([each.reshape(len(times), -1) for each in seen], axis=1), placed

    def pose_interpolation(
        self, operator: TemporalOperator, poses: Float, placements: Float, in_body: bool
    ) -> PoseInterpolation:
        """Return the prediction of poses from those at the frames ``(T, pose_dim)``, ``(T, P)``."""
        parts = self.split_poses(poses)
        world = self.articulation.to_world_axes(
            Poses(parts.rotations, parts.centres), self.unpack_placements(placements)
        )
        world = world._replace(rotations=align_quat_signs(world.rotations))
        return PoseInterpolation(self.articulation, operator, world, in_body)

    def to_body_axes(self, points: Float, vertices: Index, placements: Float) -> Float:
        """Implement `ShapeSpace.to_body_axes`: in the axes of the body of each vertex's main part."""
        bodies = self.unpack_placements(placements)
        weights = self.skinning_weights[vertices]
        body = self.articulation.body_of_part[np.asarray(weights.argmax(axis=1)).reshape(-1)]
        back = np.swapaxes(quat_to_matrix(bodies.rotations), -1, -2)[:, body]
        return rotate_vectors(back, points - self.scale * bodies.centres[:, body])

    def quaternion_signs(self, poses: Float, before: Float) -> Float:
        """Implement `ShapeSpace.quaternion_signs`."""
        here, there = self.split_poses(poses[None]), self.split_poses(before[None])
        turns, relations = (
            np.where(np.einsum("tpi,tpi->p", one, other) < 0, -1.0, 1.0)
            for one, other in zip(here[::2], there[::2], strict=True)
        )
        blocks = (turns, 4), (np.ones_like(turns), 3), (relations, 4), (np.ones_like(relations), 3)
        return np.concatenate([np.repeat(factors, size) for factors, size in blocks])

    def pose_corrections(self, poses: Float, targets: Float) -> Float:
        """Implement `ShapeSpace.pose_corrections`."""
        parts = len(self.decomposition.parts)
        turns, centres = np.split(targets, [4 * parts], axis=1)
        wanted = Poses(turns.reshape(-1, parts, 4), centres.reshape(-1, parts, 3))
        return self.articulation.pose_corrections(
            self.articulation.reconcile(self.split_poses(poses)), wanted
        )

    def correct_poses(self, poses: Float, corrections: Float) -> Poses:
        """Return part poses ``(T, p)`` relative to bodies, of pose columns and corrections ``(T, ...)``."""
        agreed = self.articulation.reconcile(self.split_poses(poses))
        spins, shifts = corrections.reshape(len(poses), 2, -1, 3).swapaxes(0, 1)
        return Poses(quat_multiply(agreed.rotations, rotvec_to_quat(spins)), agreed.centres + shifts)


def as_mixed(space: ShapeSpace) -> MixedSpace:
    """Return a mixed shape space unchanged, or raise for other spaces."""
    if not isinstance(space, MixedSpace):
        raise SettingsError(f"the {space.name} space has no parts; fit a model with space='mixed'")
    return space


def _with_positive_w(turns: Float) -> Float:
    """Return quaternions ``(..., 4)`` with w >= 0: rotations by at most half a turn."""
    return np.where(turns[..., :1] < 0, -turns, turns)
