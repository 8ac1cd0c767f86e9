r"""Transfer in the mixed shape space S_m: parts, joints and poses, each carried in its own way.

The parts of the source are carried to the target (`carried`). A frame of the source then gives

- the shape of every part, as deformation gradients move it (`gradients`), registered to the part at rest. What a part
  does beside moving rigidly is so as large as the part, and the registration tells how the part is turned;
- where the part is: its pivots meet as those of the source do, with the proportions of the target (`pivots`);
- lengths and angles of the joints, as ratios and differences (`joints`), and where their free vertices are beside what
  the parts carry along, as gradients tell.

The projection P_m turns that into the target's frame (`mixseq.reconstruction.anchored`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.correspondence.dense import Correspondence
from mixseq.reconstruction.anchored import AnchoredPlacement
from mixseq.reconstruction.joint import length_weights
from mixseq.reconstruction.links import Boundaries
from mixseq.reconstruction.placement import MixedFrame
from mixseq.reconstruction.shells import ShellSettings
from mixseq.retargeting.alignment import Alignment
from mixseq.retargeting.bridges import Bridges
from mixseq.retargeting.carried import CarriedParts, vertex_parts
from mixseq.retargeting.gradients import GradientTransfer
from mixseq.retargeting.joints import JointChanges, OtherEdges, SameEdges
from mixseq.retargeting.pivots import Pivots
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import FloatArray
from mixseq.spaces.registered import registered

Float = NDArray[np.float64]
Index = NDArray[np.int64]


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
class MixedTransfer:
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
        By how much farther the root goes than the scale of the meshes tells.
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
    def _meetings(self) -> tuple[Boundaries, Bridges]:
        """Where parts of the target meet: boundaries, and what holds its pieces."""
        topology, labels = self.gradients.target.topology, self.carried.decomposition.part_of_face
        return Boundaries.of(topology, labels), self.gradients.bridges

    def _at_meetings(self, points: Float) -> Float:
        """Where parts meet ``(n, 3)``, for points ``(V', 3)``."""
        boundaries, held = self._meetings
        return np.concatenate([boundaries.middles(points), points[held.own]])

    @cached_property
    def pivots(self) -> Pivots:
        """Where the target's parts meet; the largest is the root."""
        boundaries, held = self._meetings
        bridged = np.stack(
            [self._parts_at(held.pieces, held.own), self._parts_at(held.holders, held.other)], axis=1
        )
        root = int(np.bincount(self.carried.decomposition.part_of_face).argmax())
        pairs, points = np.concatenate([boundaries.parts, bridged]), self._at_meetings(self._rest)
        lengths, radii = self._sizes(points)
        return Pivots(pairs, points, self.parts.centres, root, lengths, radii)

    def _sizes(self, pivots: Float) -> tuple[Float, Float]:
        """Lengths and radii ``(n,)`` of the boundaries at pivots; zero where pieces are held by a vertex."""
        boundaries, _ = self._meetings
        ends = self._rest[boundaries.edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        away = np.square(ends.mean(axis=1) - pivots[boundaries.link]).sum(axis=1)
        whole, squares = (
            np.bincount(boundaries.link, each, len(pivots)) for each in (lengths, lengths * away)
        )
        squared = np.divide(squares, whole, out=np.zeros(len(pivots)), where=whole > 0)
        return whole.astype(np.float64), np.sqrt(squared)

    def _parts_at(self, pieces: Index, vertices: Index) -> Index:
        """A part ``(n,)`` at each vertex, of the piece that is meant: several may share the vertex."""
        topology, decomposition = self.gradients.target.topology, self.carried.decomposition
        result = vertex_parts(decomposition, topology)[vertices]
        for row, (piece, vertex) in enumerate(zip(pieces.tolist(), vertices.tolist(), strict=True)):
            faces = self.gradients.target.pieces.faces[piece]
            here = faces[(topology.faces[faces] == vertex).any(axis=1)]
            if here.size:  # vertices of no face have none
                result[row] = decomposition.part_of_face[here].min()
        return result

    @cached_property
    def source_pivots(self) -> Pivots:
        """The target's parts and pivots on the source: the parts that move them, and the points that they are."""
        points = self._at_meetings(self._correspondence.carry(self.gradients.source.reference))
        return replace(self.pivots, points=points, centres=self._source_parts.centres[self.carried.sources])

    @cached_property
    def joints(self) -> JointChanges:
        """What tells how the joints change."""
        source, target, rows = self.gradients.source, self.gradients.target, self.placement.rows
        if self.carried.decomposition is self.source:
            return SameEdges(target.topology, rows, source.reference, target.reference)
        return OtherEdges(self.gradients, rows)

    def poses(self, x: FloatArray) -> PartPoses:
        """Place the target's parts as a frame ``(V, 3)`` of the source places its own."""
        return self._poses(x, self._registered(x)[1])

    def _registered(self, x: FloatArray) -> tuple[Float, PartPoses]:
        """The target's parts as gradients move them."""
        return self.parts.register(self._by_gradients(x))

    def _by_gradients(self, x: FloatArray) -> Float:
        return self.gradients.frame(x) / self.gradients.target.scale

    def _poses(self, x: FloatArray, moved: PartPoses) -> PartPoses:
        """Find the poses in a frame ``(V, 3)``, with those of the parts as gradients move them."""
        points = x.astype(np.float64) / self.gradients.source.scale
        _, own = self._source_parts.register(points)
        rotations, centres = (values[self.carried.sources] for values in own)
        gaps = self._alignment.shifted(self.source_pivots.gaps(rotations, centres))
        root = self.pivots.root
        travel = self.stride * self._alignment.shifted(centres[root] - self.source_pivots.centres[root])
        near = self.pivots.within_reach(gaps, self.pivots.gaps(*moved))
        placed = self.pivots.place(moved.rotations, near, self.pivots.centres[root] + travel)
        return PartPoses(moved.rotations, placed)

    def frame(self, x: FloatArray, poses: PartPoses | None = None) -> Float:
        """Move the target ``(V', 3)`` as the source is moved in a frame ``(V, 3)``; its parts may have other poses."""
        smooth = self._by_gradients(x)
        aligned, moved = self.parts.register(smooth)
        placed = self._poses(x, moved) if poses is None else poses
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
