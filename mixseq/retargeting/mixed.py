r"""Transfer in the mixed shape space S_m: parts, joints and poses, each carried in its own way.

The parts of the source are carried to the target (`carried`). A frame of the source then gives

- the shape of every part, as deformation gradients move it (`gradients`), registered to the part at rest. What a part
  does beside moving rigidly is so as large as the part, and the registration tells how the part is turned;
- where the part is: its pivots meet as those of the source do, with the proportions of the target (`pivots`);
- lengths and angles of the joints, as ratios and differences (`joints`), and where their free vertices are beside what
  the parts carry along, as gradients tell.

The projection P_m turns that into the target's frame (`mixseq.retargeting.anchored`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.pickling import PickledWithoutCaches
from mixseq.retargeting.alignment import Alignment
from mixseq.retargeting.anchored import AnchoredPlacement
from mixseq.retargeting.carried import CarriedParts
from mixseq.retargeting.gradients import GradientTransfer
from mixseq.retargeting.joints import JointChanges, OtherEdges, SameEdges
from mixseq.retargeting.linkage import Linkage
from mixseq.retargeting.meetings import Meetings
from mixseq.retargeting.pivots import Pivots
from mixseq.retargeting.placement import MixedFrame
from mixseq.segmentation.joints import Decomposition
from mixseq.shells.fitting import ShellSettings
from mixseq.shells.joint import length_weights
from mixseq.spaces.gradient import GradientSpace
from mixseq.spaces.registered import registered

HOLD = 0.3
"""Weight of where gradients put a free vertex against a length of its edges, both relative to these: enough to choose
between solutions, too little to stretch joints. Ours."""


class PartPoses(NamedTuple):
    """Where the parts of the target are: rotations ``(..., p', 3, 3)`` from rest, and centres ``(..., p', 3)``.

    Centres are in the unit of the target's space.
    """

    rotations: Float
    centres: Float


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of a mesh at rest, in the unit of its space.

    Attributes
    ----------
    vertices : tuple of (n_p,) int64
        Their vertices.
    shapes : (N, 3) float64
        These at rest, part by part, each part about its centre.
    centres : (p, 3) float64
        The centres.
    """

    vertices: tuple[Index, ...]
    shapes: Float
    centres: Float

    @classmethod
    def of(cls, decomposition: Decomposition, rest: Float) -> Parts:
        """Take the parts of a mesh ``(V, 3)``."""
        centres = np.stack([rest[part].mean(axis=0) for part in decomposition.parts])
        pairs = zip(decomposition.parts, centres, strict=True)
        shapes = np.concatenate([rest[part] - centre for part, centre in pairs])
        return cls(decomposition.parts, shapes, centres)

    def register(self, x: Float) -> tuple[Float, PartPoses]:
        """Return a frame's parts as aligned to their shapes ``(N, 3)``, and their poses."""
        aligned, rotations, centres = registered(self.shapes, self.vertices, x)
        return aligned, PartPoses(rotations, centres)


@dataclass(frozen=True, eq=False)
class MixedTransfer(PickledWithoutCaches):
    """From frames of the source to frames of the target.

    Attributes
    ----------
    gradients : GradientTransfer
        The two meshes at rest, and how they correspond.
    source : Decomposition
        Parts and joints of the source.
    carried : CarriedParts
        Parts and joints of the target.
    settings : ShellSettings
        Settings of the joint solves.
    stride : float
        How many times as far the root goes as the scale of the meshes tells.
    """

    gradients: GradientTransfer
    source: Decomposition
    carried: CarriedParts
    settings: ShellSettings
    stride: float = 1.0

    @property
    def _correspondence(self) -> Correspondence:
        return self.gradients.correspondence

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
    def parts(self) -> Parts:
        """The parts of the target."""
        return Parts.of(self.carried.decomposition, self._rest)

    @cached_property
    def _source_parts(self) -> Parts:
        """The parts of the source."""
        return Parts.of(self.source, self.gradients.source.reference)

    @cached_property
    def placement(self) -> AnchoredPlacement:
        """What puts the target's parts and joints together."""
        topology = self.gradients.target.topology
        return AnchoredPlacement(topology, self.carried.decomposition, self.parts.shapes, self._rest)

    @cached_property
    def _meetings(self) -> Meetings:
        return Meetings.of(self.gradients, self.carried.decomposition)

    @cached_property
    def linkage(self) -> Linkage:
        """The target's parts, and where they meet at rest.

        The root has the largest product of areas on both meshes: it is the same back.
        """
        areas = _part_areas(self.gradients.target, self.carried.decomposition)
        others = _part_areas(self.gradients.source, self.source)
        root = int((areas * others[self.carried.sources[: len(areas)]]).argmax())
        meetings = self._meetings
        return Linkage(self.parts.centres, meetings.parts, meetings.points(self._rest), root)

    @cached_property
    def source_linkage(self) -> Linkage:
        """The same on the source: the parts that move those of the target, and the points that their pivots are."""
        points = self._meetings.points(self._correspondence.carry(self.gradients.source.reference))
        return replace(self.linkage, pivots=points, centres=self._source_parts.centres[self.carried.sources])

    @cached_property
    def _pivots(self) -> Pivots:
        return Pivots(self.linkage, *self._meetings.sizes(self._rest))

    @cached_property
    def joints(self) -> JointChanges:
        """What tells how the joints change."""
        source, target, rows = self.gradients.source, self.gradients.target, self.placement.rows
        if self.carried.decomposition is self.source:
            return SameEdges(target.topology, rows, source.reference, target.reference)
        return OtherEdges(self.gradients, rows)

    def by_gradients(self, x: FloatArray) -> Float:
        """Return the target ``(V', 3)`` as gradients move it in a frame ``(V, 3)``, in its unit."""
        return self.gradients.frame(x) / self.gradients.target.scale

    def poses(self, x: FloatArray, moved: PartPoses) -> PartPoses:
        """Place the target's parts as a frame ``(V, 3)`` of the source places its own.

        Parameters
        ----------
        x : (V, 3) float
            The frame, in the source's units.
        moved : PartPoses
            The target's parts as gradients move them (`by_gradients`).
        """
        points = x.astype(np.float64) / self.gradients.source.scale
        _, own = self._source_parts.register(points)
        rotations, centres = (values[self.carried.sources] for values in own)
        gaps = self._alignment.shifted(self.source_linkage.gaps(rotations, centres))
        root = self.linkage.root
        travel = self.stride * self._alignment.shifted(centres[root] - self.source_linkage.centres[root])
        near = self._pivots.within_reach(gaps, self.linkage.gaps(*moved))
        placed = self._pivots.place(moved.rotations, near, self.linkage.centres[root] + travel)
        return PartPoses(moved.rotations, placed)

    def frame(self, x: FloatArray, poses: PartPoses | None = None) -> Float:
        """Move the target ``(V', 3)`` as the source is moved in a frame ``(V, 3)``; its parts may have other poses."""
        smooth = self.by_gradients(x)
        aligned, moved = self.parts.register(smooth)
        placed = self.poses(x, moved) if poses is None else poses
        lengths, angles = self.joints.of(x.astype(np.float64) / self.gradients.source.scale)
        frame = MixedFrame(
            lengths=lengths,
            angles=angles,
            weights=length_weights(self._rest_lengths),
            parts=aligned,
            rotations=placed.rotations,
            translations=placed.centres,
            offsets=self.placement.offsets(moved.rotations, moved.centres, smooth),
            holds=self._holds,
        )
        return self.placement.assemble(frame, self.settings)[0] * self.gradients.target.scale

    @cached_property
    def _rest_lengths(self) -> Float:
        """Lengths ``(E',)`` at rest of the edges of the joints."""
        edges = self.gradients.target.topology.edges[self.placement.edge_ids]
        return np.asarray(np.linalg.norm(self._rest[edges[:, 1]] - self._rest[edges[:, 0]], axis=1))

    @cached_property
    def _holds(self) -> Float:
        """Weights ``(F,)`` of the offsets of free vertices."""
        spacing = self.placement.rows.spacing(self._rest_lengths)
        return np.asarray(HOLD / np.maximum(spacing, np.finfo(np.float64).tiny))


def _part_areas(space: GradientSpace, decomposition: Decomposition) -> Float:
    """Areas of the parts that have faces."""
    areas = TriangleMesh(space.reference, space.topology).face_areas
    return np.asarray(np.bincount(decomposition.part_of_face, areas))
