"""Transfer by parts, joints and poses (the mixed shape space S_m).

The target is cut into parts as the source (`carry_parts`). A frame of the source gives

- the shape of every part by deformation gradients (`gradient_transfer`), registered to the part at rest. Its
  deformation scales with the part, and the registration gives its rotation;
- the place of every part: its pivots meet as those of the source, with the proportions of the target (`parts`);
- lengths and angles of the joints, as ratios and differences (`joints`), and, by gradients, the offsets of their free
  vertices from the skinned positions.

Parts are posed and joints are solved between them (`JointSolver`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mixseq.mesh.measures import length_weights
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.gradient_transfer import GradientTransfer
from mixseq.retargeting.joints import JointChanges, JointFrame, JointSolver, OtherEdges, SameEdges
from mixseq.retargeting.limbs import ArticulatedBody
from mixseq.retargeting.parts import (
    PartCorrespondence,
    PartPoses,
    Pivots,
    PivotSolver,
    RestShapes,
    carry_parts,
)
from mixseq.retargeting.sources import Alignment
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.low_memory import LargeArray
from mixseq.segmentation.joints import Decomposition, Watched, decompose, frames_to_look_at, observe
from mixseq.shells.gauss_newton import ShellSettings
from mixseq.spaces.gradient import GradientSpace
from mixseq.types import Float, FloatArray, Index

OFFSET_WEIGHT = 0.3
"""Weight of offsets of free vertices against edge lengths, both relative; small enough not to stretch joints."""


@dataclass(frozen=True, eq=False)
class MixedTransfer(PickledWithoutCaches):
    """Transfer by the parts and joints of the source."""

    gradients: GradientTransfer  # the two meshes at rest, and their correspondence
    parts: PartCorrespondence  # parts and joints of both
    settings: ShellSettings  # settings of the joint solves
    stride: float = 1.0  # ratio of the root's travel to that scaled by the size of the meshes

    @property
    def _rest(self) -> Float:
        """The target at rest ``(V', 3)``, in its unit."""
        return self.gradients.target.reference

    @cached_property
    def _alignment(self) -> Alignment:
        """The alignment of the meshes in their units."""
        whole, ratio = self.gradients.alignment, self.gradients.source.scale / self.gradients.target.scale
        return Alignment(whole.rotation, whole.scale * ratio)

    @cached_property
    def shapes(self) -> RestShapes:
        """The rest shapes of the target's parts."""
        return RestShapes.of(self.parts.target, self._rest)

    @cached_property
    def _source_shapes(self) -> RestShapes:
        """The rest shapes of the source's parts."""
        return RestShapes.of(self.parts.source, self.gradients.source.reference)

    @cached_property
    def solver(self) -> JointSolver:
        """The solver for the target's parts and joints."""
        topology = self.gradients.target.topology
        return JointSolver(topology, self.parts.target, self.shapes.shapes, self._rest)

    @cached_property
    def _pivots(self) -> Pivots:
        return Pivots.of(self.gradients, self.parts.target)

    @cached_property
    def body(self) -> ArticulatedBody:
        """The target's parts, and their pivots at rest; the root has the largest product of areas on both meshes."""
        areas = _part_areas(self.gradients.target, self.parts.target)
        others = _part_areas(self.gradients.source, self.parts.source)
        root = int((areas * others[self.parts.sources[: len(areas)]]).argmax())
        pivots = self._pivots
        return ArticulatedBody(self.shapes.centres, pivots.pairs, pivots.points(self._rest), root)

    @cached_property
    def source_body(self) -> ArticulatedBody:
        """The source's parts that move those of the target, and the source points of their pivots."""
        points = self._pivots.points(
            self.gradients.correspondence.interpolate(self.gradients.source.reference)
        )
        return replace(self.body, pivots=points, centres=self._source_shapes.centres[self.parts.sources])

    @cached_property
    def _pivot_solver(self) -> PivotSolver:
        return PivotSolver(self.body, *self._pivots.sizes(self._rest))

    @cached_property
    def joint_changes(self) -> JointChanges:
        """The changes of joints."""
        source, target, solved = self.gradients.source, self.gradients.target, self.solver.solved
        if self.parts.target is self.parts.source:
            return SameEdges(target.topology, solved, source.reference, target.reference)
        return OtherEdges(self.gradients, solved)

    def by_gradients(self, x: FloatArray) -> Float:
        """Return the target ``(V', 3)`` moved by gradients in a frame ``(V, 3)``, in its unit."""
        return self.gradients.transfer_frame(x) / self.gradients.target.scale

    def poses(self, x: FloatArray, moved: PartPoses) -> PartPoses:
        """Pose the target's parts as those of the source in a frame ``(V, 3)``."""
        points = x.astype(np.float64) / self.gradients.source.scale
        _, own = self._source_shapes.register(points)
        rotations, centres = (values[self.parts.sources] for values in own)
        gaps = self._alignment.shifted(self.source_body.gaps(rotations, centres))
        root = self.body.root
        travel = self.stride * self._alignment.shifted(centres[root] - self.source_body.centres[root])
        near = self._pivot_solver.within_reach(gaps, self.body.gaps(*moved))
        placed = self._pivot_solver.place(moved.rotations, near, self.body.centres[root] + travel)
        return PartPoses(moved.rotations, placed)

    def transfer_frame(self, x: FloatArray, poses: PartPoses | None = None) -> Float:
        """Move the target ``(V', 3)`` as the source in a frame ``(V, 3)``, optionally with other poses of its parts."""
        smooth = self.by_gradients(x)
        aligned, moved = self.shapes.register(smooth)
        placed = self.poses(x, moved) if poses is None else poses
        lengths, angles = self.joint_changes.of(x.astype(np.float64) / self.gradients.source.scale)
        frame = JointFrame(
            lengths=lengths,
            angles=angles,
            weights=length_weights(self._rest_lengths),
            parts=aligned,
            rotations=placed.rotations,
            translations=placed.centres,
            offsets=self.solver.offsets(moved.rotations, moved.centres, smooth),
            offset_weights=self._offset_weights,
        )
        return self.solver.solve(frame, self.settings)[0] * self.gradients.target.scale

    @cached_property
    def _rest_lengths(self) -> Float:
        """Lengths ``(E',)`` at rest of the edges of the joints."""
        edges = self.gradients.target.topology.edges[self.solver.solved.edge_ids]
        return np.asarray(np.linalg.norm(self._rest[edges[:, 1]] - self._rest[edges[:, 0]], axis=1))

    @cached_property
    def _offset_weights(self) -> Float:
        """Weights ``(F,)`` of the offsets of free vertices."""
        spacing = self.solver.solved.spacing(self._rest_lengths)
        return np.asarray(OFFSET_WEIGHT / np.maximum(spacing, np.finfo(np.float64).tiny))


def mixed_transfer(
    gradients: GradientTransfer,
    points: LargeArray,
    part_of_face: Index,
    joint_width: int,
    settings: ShellSettings,
) -> MixedTransfer:
    """Make a transfer by parts and joints: points ``(T, V, 3)``; part_of_face ``(F,)``."""
    source, target = gradients.source, gradients.target
    looked_at = points[frames_to_look_at(len(points))]
    watched = Watched.of(source.topology, part_of_face, source.reference[None])
    observed = observe(watched, np.concatenate([source.reference[None] * source.scale, looked_at]))
    decomposition = decompose(source.topology, part_of_face, joint_width, observed)
    if _same_mesh(gradients):
        parts = PartCorrespondence(decomposition, decomposition, np.arange(len(decomposition.parts)))
    else:
        parts = carry_parts(
            decomposition,
            observed.rotations,
            gradients.correspondence,
            target.topology,
            target.reference,
            joint_width,
        )
    return MixedTransfer(gradients, parts, settings)


def _same_mesh(gradients: GradientTransfer) -> bool:
    """Whether both meshes have the same triangles, and every vertex and triangle corresponds to itself."""
    source, target, given = gradients.source.topology, gradients.target.topology, gradients.correspondence
    if not np.array_equal(source.faces, target.faces):
        return False
    own = np.where(given.corners == np.arange(len(given.corners))[:, None], given.weights, 0.0).sum(axis=1)
    return bool(np.allclose(own, 1.0) and np.array_equal(given.faces, np.arange(len(target.faces))))


def _part_areas(space: GradientSpace, decomposition: Decomposition) -> Float:
    """Areas of the parts that have faces."""
    areas = TriangleMesh(space.reference, space.topology).face_areas
    return np.asarray(np.bincount(decomposition.part_of_face, areas))
