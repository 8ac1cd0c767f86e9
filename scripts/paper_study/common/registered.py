"""P_m as the paper prints it (Section 3.4): joints by themselves, registration of all pieces, stitching, a pose.

mixseq itself does it at once, see `mixseq.spaces.mixed.assembly`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.geometry.rigid import transform
from mixseq.geometry.rotations import rotations_of
from mixseq.spaces.mixed import FreeSpace
from mixseq.spaces.mixed.assembly import FreeFrame
from scripts.paper_study.common.registration import Overlaps, register
from scripts.paper_study.common.stitching import Seams, stitch


@dataclass(frozen=True, eq=False)
class Registered:
    """Puts parts, and joints that are found by themselves, together; of one connected mesh."""

    space: FreeSpace

    @cached_property
    def pieces(self) -> list[Index]:
        """Vertices of all parts, then of all joints."""
        cut = self.space.decomposition
        return [*cut.parts, *(joint.vertices for joint in cut.joints)]

    @cached_property
    def overlaps(self) -> Overlaps:
        """Which vertices they share."""
        cut = self.space.decomposition
        # Pairs are judged by their first piece, and pairs of joints (which share no face) do not count.
        shapes = np.split(self.space.shapes, np.cumsum([len(part) for part in cut.parts])[:-1])
        nowhere = [np.zeros((len(joint.vertices), 3)) for joint in cut.joints]
        return Overlaps.of(self.pieces, [*shapes, *nowhere])

    @cached_property
    def seams(self) -> Seams:
        """Their edges."""
        return Seams.of(self.space.topology, self.pieces)

    def assembled(self, frame: FreeFrame, joints: list[Float]) -> Float:
        """Return the mesh ``(V, 3)`` of parts and of joints ``(n, 3)``, each anywhere.

        Edges have the lengths that joints say, as far as these are stored, and elsewhere their own.
        """
        lengths = np.full(len(self.space.topology.edges), np.nan)
        lengths[self.space.edge_ids] = frame.lengths
        placed = self._placed(frame, np.concatenate([frame.parts, *joints]))
        return stitch(self.seams, placed, lengths)

    def _placed(self, frame: FreeFrame, points: Float) -> Float:
        """Register all pieces ``(N, 3)``, parts and then joints, and move them to where the poses say."""
        overlaps, posed = self.overlaps, self.space.projection.posed
        rotation, translation = register(overlaps, points)
        pose = np.searchsorted(posed, overlaps.group)
        turns = rotations_of(frame.rotations)[pose]
        to_world = turns @ rotation
        centre = transform(translation[:, None], turns, frame.centres[pose])[:, 0]
        owner = np.repeat(np.arange(len(overlaps.sizes)), overlaps.sizes)
        return np.asarray(np.einsum("nij,nj->ni", to_world[owner], points) + centre[owner])
