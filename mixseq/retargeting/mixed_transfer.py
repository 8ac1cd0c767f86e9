"""Transfer by parts, joints and poses (the mixed shape space S_m).

The target is cut into the parts of the source (`transfer_parts`). A frame of the source determines

- the shapes and rotations of the parts: gradients deform the target (`gradient_transfer`), and each deformed part is
  rigidly registered to its rest shape;
- the centres of the parts: neighbouring parts meet at pivots, with the gaps of the source and the proportions of the
  target (`parts`);
- edge lengths and dihedral angles of the joints (`joints`), and the offsets of free vertices from their skinned
  positions.

Then the parts are posed, and the joints between them are solved (`JointSolver`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mixseq.mesh.measures import dihedral_angles, length_weights
from mixseq.mesh.rotations import rotvec_to_matrix
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.gradient_transfer import GradientTransfer
from mixseq.retargeting.joints import EdgewiseMetrics, GradientMetrics, JointFrame, JointSolver
from mixseq.retargeting.limbs import ArticulatedBody
from mixseq.retargeting.parts import (
    PartCorrespondence,
    PartPoses,
    Pivots,
    PivotSolver,
    RestShapes,
    transfer_parts,
)
from mixseq.retargeting.sources import Alignment, fit_alignment
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.low_memory import LargeArray
from mixseq.segmentation.joints import (
    Decomposition,
    PartShapes,
    decompose,
    measure_part_motion,
    sample_frame_ids,
)
from mixseq.shells.fitting import ShellSettings
from mixseq.spaces.gradient import GradientSpace
from mixseq.types import Float, FloatArray, Index

OFFSET_WEIGHT = 0.3
"""Weight of the offsets of free vertices relative to edge lengths; larger weights stretch joints."""

MIN_LIMB_TURN = 0.25
"""Smallest rotation of a limb at rest into the direction of the source's, in radians; bodies differ by smaller ones."""


@dataclass(frozen=True, eq=False)
class MixedTransfer(PickledWithoutCaches):
    """Transfer by the parts and joints of the source."""

    gradients: GradientTransfer  # the two meshes at rest, and their correspondence
    parts: PartCorrespondence  # parts and joints of both meshes
    settings: ShellSettings  # settings of the joint solves
    stride_ratio: float = 1.0  # ratio of the root's travel to the source's travel scaled to the target

    @property
    def _rest(self) -> Float:
        """Target at rest ``(V', 3)``, in the unit of its space."""
        return self.gradients.target.reference

    @property
    def alignment(self) -> Alignment:
        """How the target stands to the source, in the units of their meshes."""
        return self.gradients.alignment

    @cached_property
    def _alignment(self) -> Alignment:
        """Alignment from source to target, in the units of their spaces."""
        alignment = self.alignment
        unit_ratio = self.gradients.source.scale / self.gradients.target.scale
        return Alignment(alignment.rotation, alignment.scale * unit_ratio)

    @cached_property
    def rest_shapes(self) -> RestShapes:
        """Rest shapes of the target's parts."""
        return RestShapes.from_decomposition(self.parts.target, self._rest)

    @cached_property
    def _source_rest_shapes(self) -> RestShapes:
        """Rest shapes of the source's parts."""
        return RestShapes.from_decomposition(self.parts.source, self.gradients.source.reference)

    @cached_property
    def joint_solver(self) -> JointSolver:
        """Solver of the target's joints."""
        topology = self.gradients.target.topology
        return JointSolver(topology, self.parts.target, self.rest_shapes.shapes, self._rest)

    @cached_property
    def _pivots(self) -> Pivots:
        return Pivots.from_decomposition(self.gradients, self.parts.target)

    @cached_property
    def body(self) -> ArticulatedBody:
        """Parts and pivots of the target at rest; the root is the part with the largest area on both meshes."""
        areas = _part_areas(self.gradients.target, self.parts.target)
        source_areas = _part_areas(self.gradients.source, self.parts.source)
        root = int((areas * source_areas[self.parts.source_parts[: len(areas)]]).argmax())
        pivots = self._pivots
        return ArticulatedBody(self.rest_shapes.centres, pivots.pairs, pivots.points(self._rest), root)

    @cached_property
    def source_body(self) -> ArticulatedBody:
        """Articulated body of the source: source parts of the target's parts, and source points of its pivots."""
        source_points = self.gradients.correspondence.interpolate(self.gradients.source.reference)
        return replace(
            self.body,
            pivots=self._pivots.points(source_points),
            centres=self._source_rest_shapes.centres[self.parts.source_parts],
        )

    @cached_property
    def _pivot_solver(self) -> PivotSolver:
        return PivotSolver(self.body, *self._pivots.boundary_sizes(self._rest))

    @cached_property
    def joint_metrics(self) -> EdgewiseMetrics | GradientMetrics:
        """Metrics of the joints: edgewise for meshes with the same parts, otherwise by gradients."""
        source, target, joints = self.gradients.source, self.gradients.target, self.joint_solver.joints
        if self.parts.target is self.parts.source:
            return EdgewiseMetrics(target.topology, joints, source.reference, target.reference)
        return GradientMetrics(self.gradients, joints)

    def deform_by_gradients(self, points: FloatArray) -> Float:
        """Return the target ``(B, V', 3)`` deformed by gradients of frames ``(B, V, 3)``, in the unit of its space."""
        return self.gradients.transfer_frames(points) / self.gradients.target.scale

    def transfer_poses(self, points: FloatArray, deformed_poses: PartPoses) -> PartPoses:
        """Return poses of the target's parts for a source frame ``(V, 3)``, with the rotations of `deformed_poses`."""
        source_points = points.astype(np.float64) / self.gradients.source.scale
        _, source_poses = self._source_rest_shapes.register(source_points)
        source_rotations, source_centres = (values[self.parts.source_parts] for values in source_poses)
        source_gaps = self._alignment.map_vectors(self.source_body.gaps(source_rotations, source_centres))
        root = self.body.root
        travel = self._alignment.map_vectors(source_centres[root] - self.source_body.centres[root])
        gaps = self._pivot_solver.limit_gaps(source_gaps, self.body.gaps(*deformed_poses))
        root_centre = self.body.centres[root] + self.stride_ratio * travel
        rotations = deformed_poses.rotations
        return PartPoses(rotations, self._pivot_solver.solve_centres(rotations, gaps, root_centre))

    def transfer_frames(self, points: FloatArray, poses: PartPoses | None = None) -> Float:
        """Return the target ``(B, V', 3)`` for source frames ``(B, V, 3)``; `poses` replace the transferred poses."""
        given = [None] * len(points) if poses is None else map(PartPoses, *poses)
        frames = zip(points, self.deform_by_gradients(points), given, strict=True)
        return np.stack([self._transfer_frame(*frame) for frame in frames])

    def _transfer_frame(self, points: FloatArray, deformed: Float, poses: PartPoses | None) -> Float:
        """Return the target ``(V', 3)`` for a source frame ``(V, 3)``, the deformed target ``(V', 3)``, given poses."""
        part_vertices, deformed_poses = self.rest_shapes.register(deformed)
        poses = self.transfer_poses(points, deformed_poses) if poses is None else poses
        source_points = points.astype(np.float64) / self.gradients.source.scale
        lengths, angles = self.joint_metrics.lengths_and_angles(source_points)
        offsets = self.joint_solver.skinning_offsets(*deformed_poses, deformed)
        return self._solve_joints(poses, part_vertices, lengths, angles, offsets)

    @cached_property
    def limb_turns(self) -> tuple[Float, Float]:
        """Rotations ``(p, 3, 3)`` of parts at rest into the directions of the source's, and turns ``(p,)`` in degrees.

        A part turns with its parent, and at its pivot if its direction differs much: the turn, else zero.
        """
        body, source_body, parts = self.body, self.source_body, self.parts.target.parts
        matched = [part[self.gradients.correspondence.matched[part]] for part in parts]
        carried, trunk = self.gradients.correspondence.interpolate(self.gradients.source.reference), matched[body.root]
        turn_of_trunk = fit_alignment(carried[trunk], self._rest[trunk], np.ones(len(trunk))).rotation
        rotations, degrees = np.tile(np.eye(3), (len(parts), 1, 1)), np.zeros(len(parts))
        for part, (parent, pivot) in body.parents.items():
            rotations[part] = rotations[parent]
            if not len(matched[part]):
                continue
            arms = self._rest[matched[part]] - body.pivots[pivot]
            arm = arms.mean(axis=0)
            goal = turn_of_trunk @ (carried[matched[part]].mean(axis=0) - source_body.pivots[pivot])
            turn = _turn_between(rotations[parent] @ arm, goal)
            is_long = np.linalg.norm(arm) > np.linalg.norm(arms - arm, axis=1).mean()  # others have no direction
            if is_long and np.linalg.norm(turn) > MIN_LIMB_TURN:
                rotations[part] = rotvec_to_matrix(turn) @ rotations[parent]
                degrees[part] = np.degrees(np.linalg.norm(turn))
        return rotations, degrees

    def turned_to_source(self) -> Float:
        """Return the target ``(V', 3)`` at rest after `limb_turns`, with its shapes of parts and metrics of joints."""
        body, solver, rotations = self.body, self.joint_solver, self.limb_turns[0]
        gaps = np.zeros_like(body.pivots)
        poses = PartPoses(rotations, self._pivot_solver.solve_centres(rotations, gaps, body.centres[body.root]))
        angles = dihedral_angles(self._rest, self.gradients.target.topology.hinges[solver.joints.hinge_ids])
        offsets = np.zeros((len(solver.joints.vertices), 3))
        return self._solve_joints(poses, self.rest_shapes.shapes, self._rest_lengths, angles, offsets)

    def _solve_joints(
        self, poses: PartPoses, part_vertices: Float, lengths: Float, angles: Float, offsets: Float
    ) -> Float:
        """Return the target ``(V', 3)`` with posed parts and solved joints."""
        weights = length_weights(self._rest_lengths)
        frame = JointFrame(lengths, angles, weights, part_vertices, *poses, offsets, self._offset_weights)
        return self.joint_solver.solve(frame, self.settings) * self.gradients.target.scale

    @cached_property
    def _rest_lengths(self) -> Float:
        """Rest lengths ``(E',)`` of the joints' edges."""
        edges = self.gradients.target.topology.edges[self.joint_solver.joints.edge_ids]
        return np.asarray(np.linalg.norm(self._rest[edges[:, 1]] - self._rest[edges[:, 0]], axis=1))

    @cached_property
    def _offset_weights(self) -> Float:
        """Weights ``(F,)`` of the offsets of free vertices, in inverse edge lengths."""
        spacing = self.joint_solver.joints.vertex_spacing(self._rest_lengths)
        return np.asarray(OFFSET_WEIGHT / np.maximum(spacing, np.finfo(np.float64).tiny))


def mixed_transfer(
    gradients: GradientTransfer,
    points: LargeArray,
    part_of_face: Index,
    joint_width: int,
    settings: ShellSettings,
) -> MixedTransfer:
    """Prepare a transfer by parts and joints: all source frames ``(T, V, 3)``, part of every triangle ``(F,)``."""
    source, target = gradients.source, gradients.target
    samples = points[sample_frame_ids(len(points))]
    watched = PartShapes.from_labels(source.topology, part_of_face, source.reference[None])
    observed = measure_part_motion(watched, np.concatenate([source.reference[None] * source.scale, samples]))
    decomposition = decompose(source.topology, part_of_face, joint_width, observed)
    if _is_same_mesh(gradients):
        parts = PartCorrespondence(decomposition, decomposition, np.arange(len(decomposition.parts)))
    else:
        parts = transfer_parts(
            decomposition,
            observed.rotations,
            gradients.correspondence,
            target.topology,
            target.reference,
            joint_width,
        )
    return MixedTransfer(gradients, parts, settings)


def _turn_between(first: Float, second: Float) -> Float:
    """Return the least rotation vector ``(3,)`` that turns the direction of a vector to that of another."""
    axis = np.cross(first, second)
    sine = float(np.linalg.norm(axis))
    return np.asarray(axis * (np.arctan2(sine, float(first @ second)) / sine if sine > 0 else 0.0))


def _is_same_mesh(gradients: GradientTransfer) -> bool:
    """Return whether both meshes have the same triangles, and each vertex and triangle corresponds to itself."""
    source, target = gradients.source.topology, gradients.target.topology
    correspondence = gradients.correspondence
    if not np.array_equal(source.faces, target.faces):
        return False
    is_own_corner = correspondence.corners == np.arange(len(correspondence.corners))[:, None]
    own_weights = np.where(is_own_corner, correspondence.weights, 0.0).sum(axis=1)
    is_own_face = np.array_equal(correspondence.faces, np.arange(len(target.faces)))
    return bool(np.allclose(own_weights, 1.0) and is_own_face)


def _part_areas(space: GradientSpace, decomposition: Decomposition) -> Float:
    """Return the areas of the parts that have faces."""
    areas = TriangleMesh(space.reference, space.topology).face_areas
    return np.asarray(np.bincount(decomposition.part_of_face, areas))
