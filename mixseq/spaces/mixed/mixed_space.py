"""The mixed shape space S_m: near-rigid parts have vertices and poses, joints have lengths and angles.

A vector, in diagonals and radians, is

``[joint lengths | joint angles | rest vertices | part poses | relations | body poses | corrections]``

- Parts are registered to their mean shapes (paper, Section 3.4). Their poses are relative to the *bodies* that they
  form, and *relations* are poses relative to neighbours (`mixseq.spaces.mixed.articulation`): a rigid motion of a body
  changes only its own pose.
- Vertices are skinned to the parts around them by dual quaternions (Kavan and others 2008). *Rest vertices* are the
  vertices in rest space, after inverse skinning. Inside a part they are the paper's aligned part vertices.
- Lengths and angles are stored for *joint faces*, whose errors half-way between frames would be large.
- Corrections are zero in encoded frames. Between frames they move blended part poses to poses interpolated in time.

The projection P_m reconciles poses and relations, skins the rest vertices, and moves vertices of joints towards the
joints' lengths and angles (`mixseq.spaces.mixed.joint_projection`). Between far poses, relaxation of the whole mesh
follows (`mixseq.shells.shell`). With the free placement, P_m finds part poses from lengths and angles
(`mixseq.spaces.mixed.assembly`). P_m is exact at the frames. Except for relaxation it is analytic, so that velocities
are derivatives by a complex step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

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
from mixseq.runtime.lazy import cached_property
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, log_progress
from mixseq.segmentation.joints import Decomposition
from mixseq.spaces.base import ANGLE_WEIGHT, ShapeSpace, flatten_blocks, radii_of_gyration
from mixseq.spaces.mixed import posing_kernels as kernels
from mixseq.spaces.mixed.articulation import Articulation, PartPoses, Steadiness, find_articulation
from mixseq.spaces.mixed.assembly import Assembly, FreeFrame
from mixseq.spaces.mixed.joint_projection import JointProjection, RealOrComplex, from_complex_step, to_complex_step
from mixseq.spaces.mixed.pose_interpolation import PoseInterpolation
from mixseq.spaces.pieces import register_parts
from mixseq.spaces.temporal import Poses, TemporalOperator
from mixseq.types import Float, FloatArray, Index, Int32, Mask

JOINT_WEIGHT = 1e-3  # weight of lengths and angles in the metric; rest vertices determine the same shape
JOINT_EMBEDDING_WEIGHT = 2.0  # weight of lengths and angles in embeddings
MAX_EDIT_ROUNDS, EDIT_TOLERANCE = 12, 1e-11  # iterations to reach an edited frame, and their error in diagonals
ARTICULATION_WEIGHT = 0.2  # weight of part poses in the metric, relative to the vertices they move
PROJECTION_WEIGHT_RANGE = (1e-6, 1e6)  # range of `hold` and `relations`, outside which linear systems are singular
LENGTH_STEP_RATIO = 1 / 4  # ratio of the rounding step of lengths to the rounding step of positions, if P_m relaxes
MAX_ANGLE_STEP_RATIO = 64  # largest ratio of the rounding step of angles in radians to that of positions in diagonals
MAX_PROJECTED_FRAMES, MAX_PROJECTED_VERTICES = 16, 1 << 19  # projected at once, sharing factors


@dataclass(frozen=True)
class Projection:
    """Settings of the projection P_m; raises `SettingsError` if a number is out of range."""

    placement: PlacementName = "anchored"  # placement of parts by their poses, or by lengths and angles
    share: float = 0.0  # share of the vector's lengths and angles at joints, from 0 (skinned vertices) to 1
    hold: float = 0.1  # weight of skinned vertices at joints
    steps: int = 0  # relaxation steps over the lengths and angles of the whole mesh
    relations: float = 0.1  # weight of relations against part poses of equal steadiness

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
    rest_vertices: RealOrComplex  # (T, V, 3) vertices in rest space
    part_rotations: RealOrComplex  # (T, p, 4) quaternions of parts since the reference frame, in body axes
    part_centres: RealOrComplex  # (T, p, 3) centres of parts, in body axes
    relation_rotations: RealOrComplex  # (T, n, 4) quaternions of parts in the axes of neighbours
    relation_points: RealOrComplex  # (T, n, 3) pivots of parts in the axes of neighbours
    body_rotations: RealOrComplex  # (T, B, 4) quaternions of bodies since the reference frame
    body_centres: RealOrComplex  # (T, B, 3) centres of bodies
    corrections: RealOrComplex  # (T, 6 p) rotation vectors of parts in their own axes, shifts in body axes

    @property
    def part_poses(self) -> PartPoses:
        """Part poses and relations."""
        return PartPoses(*self[3:7])


QUATERNION_BLOCKS = ("part_rotations", "relation_rotations", "body_rotations")  # names of the blocks of quaternions


@dataclass(frozen=True, eq=False)
class MixedSpace(ShapeSpace):
    """The mixed shape space of one mesh sequence; made by `mixed_space`."""

    topology: Topology  # connectivity of the mesh
    decomposition: Decomposition  # parts and joints
    scale: float  # unit of errors, see `reference_diagonal`, in the units of the sequence
    shapes: Float  # (N, 3) centred mean shapes, part by part, in diagonals
    reference: Float  # (V, 3) the first frame, in diagonals
    skinning_weights: sparse.csr_array  # (V, p) rows add up to one
    steadiness: Steadiness | None  # inverse variances of part poses and relations: their weights in P_m
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
        """Placement of parts: "anchored" or "free"."""
        return self.projection.placement

    @property
    def edge_ids(self) -> Index:
        """Edges ``(E',)`` with a length in the vector, ascending."""
        return self.joint_projection.edge_ids

    @property
    def hinge_ids(self) -> Index:
        """Hinges ``(H',)`` with an angle in the vector, ascending."""
        return self.joint_projection.hinge_ids

    @cached_property
    def joint_projection(self) -> JointProjection:
        """Projection of skinned vertices at joints to lengths and angles."""
        return JointProjection(self.topology, self.reference, self.joint_faces, self.projection.hold)

    @cached_property
    def assembly(self) -> Assembly:
        """Projection of the free placement."""
        return Assembly(
            self.topology,
            self.rigid_part_of_vertex,
            self.joint_faces,
            self.edge_ids,
            self.hinge_ids,
            self.reference,
            self.projection.steps,
        )

    @cached_property
    def rigid_part_of_vertex(self) -> Index:
        """Part ``(V,)`` of vertices skinned to a single part, else -1."""
        starts, parts, _ = self._skinning
        return np.where(np.diff(starts) == 1, parts[starts[:-1]], -1)

    @property
    def _skinning(self) -> tuple[Int32, Int32, Float]:
        """Starts of rows ``(V + 1,)``, parts and weights ``(n,)`` of the skinning weights."""
        weights = self.skinning_weights
        starts, parts = (each.astype(np.int32, copy=False) for each in (weights.indptr, weights.indices))
        return starts, parts, weights.data

    @cached_property
    def _rest_poses(self) -> Poses:
        """Poses of the parts in the reference frame, relative to their mean shapes."""
        rotations, centres = register_parts(self.shapes, self.decomposition.parts, self.reference)
        return Poses(matrix_to_quat(rotations)[None], centres[None])

    @cached_property
    def part_radii(self) -> Float:
        """Radii of gyration ``(p,)`` of the parts, in diagonals."""
        return radii_of_gyration(self.shapes, self.decomposition.parts)

    @cached_property
    def articulation(self) -> Articulation:
        """Bodies and relations of the parts."""
        return find_articulation(
            self.topology,
            self.decomposition,
            self.reference,
            self._rest_poses.centres[0],
            self.part_radii,
            self.steadiness,
            self.projection.relations,
        )

    def with_weights(self, **changes: Any) -> MixedSpace:
        """Return the space with other steadiness, joint faces or projection, and the same bodies and relations."""
        space = replace(self, **changes)
        weights: dict[str, Any] = {"relation_weight": space.projection.relations}
        if space.steadiness is not None:
            weights["steadiness"] = space.steadiness
        space.__dict__["articulation"] = replace(self.articulation, **weights)  # bodies take long to find
        return space

    def at_vertices(self, vertex_ids: Index) -> tuple[MixedSpace, Index]:
        """Return the space of vertices ``(n,)`` alone, skinned to all parts, and its columns ``(D',)`` of vectors."""
        space = replace(
            self,
            topology=Topology(np.zeros((0, 3), dtype=np.int32), len(vertex_ids)),
            reference=self.reference[vertex_ids],
            skinning_weights=self.skinning_weights[vertex_ids],
            joint_faces=np.zeros(0, dtype=bool),
            projection=replace(self.projection, share=0.0, steps=0),
        )
        space.__dict__["articulation"] = self.articulation
        joints, vertices = sum(self.block_sizes[:2]), np.arange(3 * self.vertex_count).reshape(-1, 3)
        columns = vertices[vertex_ids].reshape(-1), np.arange(vertices.size, self.dim - joints)
        return space, joints + np.concatenate(columns)

    @cached_property
    def _block_shapes(self) -> tuple[tuple[int, ...], ...]:
        """Array shapes of the blocks of a vector, in order."""
        parts, relations = len(self.decomposition.parts), len(self.articulation.pairs)
        joints = (len(self.edge_ids),), (len(self.hinge_ids),)
        poses = [(count, size) for count in (parts, relations, self.articulation.body_count) for size in (4, 3)]
        return *joints, (self.vertex_count, 3), *poses, (6 * parts,)

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
        """Implement `ShapeSpace.rotation_count`: one per body."""
        return self.articulation.body_count

    @property
    def correction_dim(self) -> int:
        """Implement `ShapeSpace.correction_dim`: six per part."""
        return self.block_sizes[-1]

    @property
    def pose_dim(self) -> int:
        """Implement `ShapeSpace.pose_dim`: part poses and relations."""
        return sum(self.block_sizes[3:7])

    @cached_property
    def angle_weights(self) -> Float:
        """Weights ``(H',)`` of angles relative to lengths, proportional to the length of their edges."""
        edges = self.topology.edges[self.topology.hinge_edges[self.hinge_ids]]
        return ANGLE_WEIGHT * edge_lengths(self.reference, edges)

    @property
    def weights(self) -> Float:
        """Metric ``(D,)``: vertex displacement in diagonals per unit of each coordinate.

        1 for rest vertices and centres of bodies; twice a radius of gyration for quaternions; `ARTICULATION_WEIGHT`
        times these weights, over all vertices of the part, for part poses; `JOINT_WEIGHT` for lengths, and its product
        with the edge length for angles. Relations follow from part poses and have the weight 0.
        """
        edge_count, _, coordinate_count, *_ = self.block_sizes
        part_weights = ARTICULATION_WEIGHT * np.sqrt(self.articulation.masses)
        return np.concatenate(
            [
                np.full(edge_count, JOINT_WEIGHT),
                JOINT_WEIGHT * self.angle_weights,
                np.ones(coordinate_count),
                np.repeat(2.0 * self.part_radii * part_weights, 4),
                np.repeat(part_weights, 3),
                np.zeros(sum(self.block_sizes[5:7])),
                np.repeat(2.0 * self.articulation.body_radii, 4),
                np.ones(self.block_sizes[8]),
                np.repeat(self.part_radii, 3),
                np.ones(self.block_sizes[9] // 2),
            ]
        )

    @property
    def rounding_step_ratios(self) -> Float:
        """Implement `ShapeSpace.rounding_step_ratios`: coarse for angles at short edges, fine for relaxed lengths."""
        edge_count, hinge_count, *_ = self.block_sizes
        result = np.ones(self.shape_dim)
        if self.projection.steps:
            result[:edge_count] = LENGTH_STEP_RATIO
        if self.placement == "anchored":
            lengths = np.clip(self.angle_weights / ANGLE_WEIGHT, 1 / MAX_ANGLE_STEP_RATIO, 1.0)
            result[edge_count : edge_count + hinge_count] = 2.0 ** np.floor(-np.log2(lengths))
        return result

    @property
    def embedding_weights(self) -> Float:
        """Implement `ShapeSpace.embedding_weights`: dominated by joints and part poses."""
        edge_count, hinge_count, *_ = self.block_sizes
        joints = JOINT_EMBEDDING_WEIGHT * np.append(np.ones(edge_count), self.angle_weights)
        rest = self.shape_weights[edge_count + hinge_count :].copy()
        rest[self.block_sizes[2] :] /= ARTICULATION_WEIGHT
        return np.concatenate([joints, rest])

    def split(self, vectors: RealOrComplex) -> MixedBlocks:
        """Return the blocks of vectors ``(T, D)``, as views where possible; raises as `check_vectors`."""
        return MixedBlocks(*self._split_columns(self.check_vectors(vectors), slice(None)))

    def join(self, blocks: MixedBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return flatten_blocks(blocks)

    def split_poses(self, poses: Float) -> PartPoses:
        """Return part poses and relations from the pose columns ``(T, pose_dim)`` of shapes."""
        return PartPoses(*self._split_columns(poses, slice(3, 7)))

    def _split_columns(self, columns: RealOrComplex, block_range: slice) -> Iterator[RealOrComplex]:
        """Split columns ``(T, n)`` into a range of the blocks of vectors."""
        blocks = np.split(columns, np.cumsum(self.block_sizes[block_range])[:-1], axis=1)
        shaped = zip(blocks, self._block_shapes[block_range], strict=True)
        return (block.reshape(len(columns), *shape) for block, shape in shaped)

    def encode_independently(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_independently`: wrapped angles, and quaternions with w >= 0."""
        frames = (np.divide(frame, self.scale, dtype=np.float64) for frame in points)
        columns = [slice(*ends) for ends in pairwise(np.cumsum([0, *self.block_sizes]))]
        vectors, poses = np.zeros((len(points), self.dim)), []
        for vector, x in zip(vectors, frames, strict=True):  # large frames take much memory: one at a time
            poses.append(register_parts(self.shapes, self.decomposition.parts, x))
            vector[columns[0]], vector[columns[1]] = self.measure_joints(x)
            vector[columns[2]] = x.reshape(-1)
        rotations, centres = (np.stack(arrays) for arrays in zip(*poses, strict=True))
        to_rest = quat_conjugate(self._rest_poses.rotations)
        world = Poses(quat_multiply(matrix_to_quat(rotations), to_rest), centres)
        bodies = self.articulation.fit_bodies(world)
        parts = self.articulation.add_relations(self.articulation.to_body_axes(world, bodies))
        parts = parts._replace(
            rotations=_with_positive_w(parts.rotations), relation_rotations=_with_positive_w(parts.relation_rotations)
        )
        vectors[:, columns[3].start : columns[8].stop] = flatten_blocks((*parts, *bodies))
        for vector, *frame in zip(vectors, *parts, *bodies, strict=True):
            poses_of_bodies, correction = (frame[4], frame[5]), np.zeros(self.correction_dim)
            motions = self.articulation.part_motions(PartPoses(*frame[:4]), poses_of_bodies, correction)
            vertices = vector[columns[2]].reshape(-1, 3)
            vertices[:] = self._unskin(motions, vertices)
        return vectors

    def measure_joints(self, x: Float) -> tuple[Float, Float]:
        """Return lengths ``(..., E')`` and angles ``(..., H')`` of joint faces in frames ``(..., V, 3)``."""
        if not self.joint_faces.any():  # needs no tables of edges and hinges
            return np.zeros((*x.shape[:-2], 0)), np.zeros((*x.shape[:-2], 0))
        edges, hinges = self.topology.edges[self.edge_ids], self.topology.hinges_at(self.hinge_ids)
        return edge_lengths(x, edges), dihedral_angles(x, hinges)

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`, in place."""
        blocks = self.split(vectors)
        before = None if previous is None else self.split(previous[None])
        start = self.measure_joints(self.reference)[1] if before is None else before.angles[0]
        blocks.angles[:] = unwrap_angles(blocks.angles, start)
        for name in QUATERNION_BLOCKS:
            block = getattr(blocks, name)
            block[:] = align_quat_signs(block, before and getattr(before, name)[0])
        return vectors

    def _unskin(self, motions: Float, x: Float) -> Float:
        return np.asarray(kernels.unskin_vertices(*self._skinning, motions, x))

    def _part_motions(self, frame: MixedBlocks) -> RealOrComplex:
        """Motions ``(p, 8)`` of the parts in one frame, as dual quaternions."""
        bodies = np.ascontiguousarray(frame.body_rotations), np.ascontiguousarray(frame.body_centres)
        correction = np.ascontiguousarray(frame.corrections)
        return self.articulation.part_motions(frame.part_poses, bodies, correction)

    def decode(self, vectors: Float, progress: Progress = log_progress) -> Float:
        """Implement `ShapeSpace.decode`: the projection P_m."""
        points = np.empty((len(vectors), self.vertex_count, 3))
        for frames, projected in self._project(np.asarray(vectors, dtype=np.float64)):
            np.multiply(projected, self.scale, out=points[frames])
            progress(frames.stop, len(vectors), "decoding frames")
        return points

    def _project(self, vectors: RealOrComplex) -> Iterator[tuple[slice, RealOrComplex]]:
        """Yield meshes ``(B, V, 3)`` of vectors, in diagonals; complex for complex vectors and an analytic P_m."""
        size = max(1, min(MAX_PROJECTED_FRAMES, MAX_PROJECTED_VERTICES // self.vertex_count))
        blocks = self.split(vectors)
        for start in range(0, len(vectors), size):
            frames = slice(start, min(start + size, len(vectors)))
            with one_blas_thread():
                yield frames, self._project_frames(MixedBlocks(*(block[frames] for block in blocks)))

    def _project_frames(self, blocks: MixedBlocks) -> RealOrComplex:
        meshes = [self._skin(MixedBlocks(*frame)) for frame in zip(*blocks, strict=True)]
        skinned = meshes[0][None] if len(meshes) == 1 else np.stack(meshes)  # large frames are not copied
        lengths, angles = (np.ascontiguousarray(block) for block in (blocks.lengths, blocks.angles))
        frames = zip(lengths, angles, blocks.rest_vertices, skinned, strict=True)
        if self.placement == "free":
            return np.stack([self.assembly.assemble(FreeFrame(*frame)).points for frame in frames])
        projected = self.joint_projection.project(skinned, lengths, angles, self.projection.share)
        if self.projection.steps:
            for mesh, (mesh_lengths, mesh_angles, _, x) in zip(projected, frames, strict=True):
                targets = self.joint_projection.mesh_targets(x, mesh_lengths, mesh_angles)
                mesh[:] = self.joint_projection.shell.relax(mesh, *targets, self.projection.steps).points
        return projected

    def _skin(self, frame: MixedBlocks) -> RealOrComplex:
        rest_vertices = np.ascontiguousarray(frame.rest_vertices)
        return np.asarray(kernels.skin_vertices(*self._skinning, self._part_motions(frame), rest_vertices))

    def skin(self, vectors: RealOrComplex) -> RealOrComplex:
        """Return skinned vertices ``(T, V, 3)`` of vectors ``(T, D)``, in diagonals, before the joint projection."""
        return np.stack([self._skin(MixedBlocks(*frame)) for frame in zip(*self.split(vectors), strict=True)])

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_with_velocities` by a complex step, where all of P_m is analytic."""
        if self.projection.steps or self.placement == "free":
            return super().decode_with_velocities(vectors, rates)
        points, velocities = np.empty((2, len(vectors), self.vertex_count, 3))
        for frames, projected in self._project(to_complex_step(np.asarray(vectors, dtype=np.float64), rates)):
            points[frames], velocities[frames] = from_complex_step(projected)
        return points * self.scale, velocities * self.scale

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference` with constant part poses, iteratively between frames."""
        edited, points, size = vector.copy(), before, self.shape_dim
        error, offset = np.inf, before - self.decode(vector[None])[0]
        for _ in range(MAX_EDIT_ROUNDS):
            candidate = edited.copy()
            candidate[:size] += self._rest_difference(edited, points, after)
            points = self.decode(candidate[None])[0] + offset
            candidate_error = float(np.abs(points - after).max())
            if candidate_error > 0.5 * error:
                break
            edited, error = candidate, candidate_error
            if error <= EDIT_TOLERANCE * self.scale:
                break
        return edited[:size] - vector[:size]

    def _rest_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Return the differences ``(S,)`` of lengths, angles and rest vertices of two frames."""
        motions = self._part_motions(MixedBlocks(*(block[0] for block in self.split(vector[None]))))
        first, second = (x / self.scale for x in (before, after))
        (lengths, angles), (new_lengths, new_angles) = map(self.measure_joints, (first, second))
        rest_change = self._unskin(motions, second) - self._unskin(motions, first)
        changes = new_lengths - lengths, wrap_angles(new_angles - angles), rest_change.reshape(-1)
        return np.concatenate([*changes, np.zeros(self.pose_dim)])

    def interpolate_poses(
        self, operator: TemporalOperator, poses: Float, placements: Float, times: Float
    ) -> tuple[Poses, Float]:
        """Implement `ShapeSpace.interpolate_poses`: in root axes, by relations and in world axes."""
        bodies, parts = self.pose_interpolation(operator, poses, placements).at(times)
        first = self.unpack_placements(placements[:1]).rotations[0]
        bodies = bodies._replace(rotations=align_quat_signs(bodies.rotations, first))
        return parts, self.pack_placements(bodies)

    def group_coordinates(self, group_of_vertex: Index) -> Index:
        """Implement `ShapeSpace.group_coordinates`; a body's axes, and so the poses in them, change with its parts."""
        body = self.articulation.body_of_part
        group_of_body = np.zeros(self.articulation.body_count, dtype=np.int64)
        np.maximum.at(group_of_body, body, self._group_of_part(group_of_vertex))
        first_vertices = self.topology.edges[self.edge_ids, 0], self.topology.hinges[self.hinge_ids, 0]
        parts, relations = group_of_body[body], group_of_body[body[self.articulation.pairs[:, 0]]]
        vertices = (*(group_of_vertex[ids] for ids in first_vertices), np.repeat(group_of_vertex, 3))
        poses = zip((parts, parts, relations, relations), (4, 3, 4, 3), strict=True)
        return np.concatenate([*vertices, *(np.repeat(groups, size) for groups, size in poses)])

    def merge_poses(self, poses: Sequence[tuple[Poses, Float]], group_of_vertex: Index) -> tuple[Poses, Float]:
        """Implement `ShapeSpace.merge_poses`: parts of all groups in world axes, then bodies that fit them."""
        groups, parts = self._group_of_part(group_of_vertex), np.arange(len(self.decomposition.parts))
        in_body_axes = [targets for targets, _ in poses]
        placed = [self.unpack_placements(placements) for _, placements in poses]
        world = [self.articulation.to_world_axes(*each) for each in zip(in_body_axes, placed, strict=True)]
        merged = Poses(*(np.stack(blocks)[groups, :, parts].swapaxes(0, 1) for blocks in zip(*world, strict=True)))
        bodies = self.articulation.fit_bodies(merged)
        bodies = bodies._replace(rotations=align_quat_signs(bodies.rotations, placed[0].rotations[0]))
        new_parts = self.articulation.to_body_axes(merged, bodies)
        new_parts = new_parts._replace(rotations=align_quat_signs(new_parts.rotations, in_body_axes[0].rotations[0]))
        return new_parts, self.pack_placements(bodies)

    def _group_of_part(self, group_of_vertex: Index) -> Index:
        return group_of_vertex[[vertex_ids[0] for vertex_ids in self.decomposition.parts]]

    def pose_interpolation(self, operator: TemporalOperator, poses: Float, placements: Float) -> PoseInterpolation:
        """Return the interpolation of part poses ``(T, pose_dim)`` and placements ``(T, P)`` of the frames."""
        parts = self.split_poses(poses)
        bodies = self.unpack_placements(placements)
        world = self.articulation.to_world_axes(Poses(parts.rotations, parts.centres), bodies)
        world = world._replace(rotations=align_quat_signs(world.rotations))
        return PoseInterpolation(self.articulation, operator, world)

    def to_body_axes(self, points: Float, vertex_ids: Index, placements: Float) -> Float:
        """Implement `ShapeSpace.to_body_axes`, with the body of each vertex's main part."""
        bodies = self.unpack_placements(placements)
        main_parts = np.asarray(self.skinning_weights[vertex_ids].argmax(axis=1)).reshape(-1)
        body = self.articulation.body_of_part[main_parts]
        back = np.swapaxes(quat_to_matrix(bodies.rotations), -1, -2)[:, body]
        return rotate_vectors(back, points - self.scale * bodies.centres[:, body])

    def quaternion_signs(self, poses: Float, previous: Float) -> Float:
        """Implement `ShapeSpace.quaternion_signs`."""
        blocks, previous_blocks = self.split_poses(poses[None]), self.split_poses(previous[None])
        parts, relations = (
            np.where(np.einsum("tpi,tpi->p", q, before) < 0, -1.0, 1.0)
            for q, before in zip(blocks[::2], previous_blocks[::2], strict=True)
        )
        signs = (parts, 4), (np.ones_like(parts), 3), (relations, 4), (np.ones_like(relations), 3)
        return np.concatenate([np.repeat(values, size) for values, size in signs])

    def pose_corrections(self, poses: Float, targets: Poses) -> Float:
        """Implement `ShapeSpace.pose_corrections`."""
        return self.articulation.pose_corrections(self.articulation.reconcile(self.split_poses(poses)), targets)

    def correct_poses(self, poses: Float, corrections: Float) -> Poses:
        """Return part poses ``(T, p)`` in body axes, from pose columns and corrections ``(T, ...)``."""
        blended = self.articulation.reconcile(self.split_poses(poses))
        rotation_vectors, shifts = corrections.reshape(len(poses), 2, -1, 3).swapaxes(0, 1)
        rotations = quat_multiply(blended.rotations, rotvec_to_quat(rotation_vectors))
        return Poses(rotations, blended.centres + shifts)


def as_mixed(space: ShapeSpace) -> MixedSpace:
    """Return a mixed shape space unchanged; raise `SettingsError` for other spaces."""
    if not isinstance(space, MixedSpace):
        raise SettingsError(f"the {space.name} space has no parts; fit a model with space='mixed'")
    return space


def _with_positive_w(q: Float) -> Float:
    """Return quaternions ``(..., 4)`` with w >= 0: rotations by at most 180 degrees."""
    return np.where(q[..., :1] < 0, -q, q)
