"""S_m and P_m as the paper prints them (Sections 2.2 and 2.3).

A point of S_m is the aligned vertices of parts, the lengths and angles of joints, and poses. P_m finds joints by
themselves, registers all pieces, and stitches them. The product's way is `mixseq.spaces.mixed`.

Joints and parts overlap by a strip, whose lengths and angles follow from the blended part as well. Two readings: joints
have all their own (the dimension that the paper defines counts them), or only those that no part has.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.mesh.measures import clamp_lengths, dihedral_angles, edge_lengths, length_weights
from mixseq.mesh.rigid import mean_shape, transform_points
from mixseq.mesh.rotations import align_quat_signs, matrix_to_quat, quat_to_matrix
from mixseq.segmentation.joints import Decomposition
from mixseq.shells.solvers import index_of
from mixseq.spaces.pieces import align_parts
from mixseq.types import Float, Index
from scripts.paper_study.common.poses import Poses
from scripts.paper_study.common.registration import Overlaps, register
from scripts.paper_study.common.stitching import Seams, stitch


class PaperFrame(NamedTuple):
    """A point of S_m: p parts with N vertices in all, in diagonals and radians."""

    lengths: Float  # (E,) lengths: blended where joints have them, else of the blended part
    angles: Float  # (H,) angles, likewise
    parts: Float  # (N, 3) aligned vertices of all parts
    rotations: Float  # (p, 4) quaternions of any length of the parts, of which the first of a group counts
    centres: Float  # (p, 3) their centres


@dataclass(frozen=True, eq=False)
class PaperSpace:
    """S_m of some poses of one connected mesh, and its parts."""

    poses: Poses
    decomposition: Decomposition
    complete: bool = False  # whether joints have the lengths and angles that a part has as well

    @cached_property
    def shapes(self) -> Float:
        """Mean shapes ``(N, 3)`` of all parts."""
        points = self.poses.points / self.poses.diagonal
        return np.concatenate([mean_shape(points[:, part]) for part in self.decomposition.parts])

    @cached_property
    def aligned(self) -> tuple[Float, Float, Float]:
        """Aligned vertices ``(T, N, 3)`` of all parts, and their poses: quaternions and centres."""
        frames = self.poses.points / self.poses.diagonal
        found = [align_parts(self.shapes, self.decomposition.parts, frame) for frame in frames]
        parts, rotations, centres = (np.stack(each) for each in zip(*found, strict=True))
        return parts, align_quat_signs(matrix_to_quat(rotations)), centres

    @cached_property
    def _rows(self) -> tuple[Index, Index]:
        """Rows of part vertices that edges and hinges connect, -1 where no part has all of them."""
        topology = self.poses.topology
        return self._in_one_part(topology.edges), self._in_one_part(topology.hinges)

    def _in_one_part(self, vertices: NDArray[np.integer]) -> Index:
        """Rows of vertices ``(n, k)`` in the first part that has all k of them, -1 where none has."""
        result, start = np.full(vertices.shape, -1, dtype=np.int64), 0
        for part in self.decomposition.parts:
            rows = index_of(part, self.poses.topology.vertex_count)[vertices]
            inside = (rows >= 0).all(axis=1) & (result[:, 0] < 0)
            result[inside] = start + rows[inside]
            start += len(part)
        return result

    @cached_property
    def blended_edges(self) -> NDArray[np.bool_]:
        """Mark the edges ``(E,)`` whose lengths are those of joints."""
        return self._blended(self._rows[0], [joint.edge_ids for joint in self.decomposition.joints])

    @cached_property
    def blended_hinges(self) -> NDArray[np.bool_]:
        """Mark the hinges ``(H,)`` whose angles are those of joints."""
        return self._blended(self._rows[1], [joint.hinge_ids for joint in self.decomposition.joints])

    def _blended(self, rows: Index, of_joints: list[Index]) -> NDArray[np.bool_]:
        """Mark what no part has, and what joints have if they are complete."""
        mask = rows[:, 0] < 0
        for ids in of_joints if self.complete else ():
            mask[ids] = True
        return np.asarray(mask)

    @cached_property
    def length_weights(self) -> Float:
        """One over the mean lengths ``(E,)`` of edges."""
        return length_weights(self.poses.lengths.mean(axis=0) / self.poses.diagonal)

    def frame(self, weights: Float) -> PaperFrame:
        """Blend poses with weights ``(T,)``."""
        parts, rotations, centres = (np.tensordot(weights, each, 1) for each in self.aligned)
        edges, hinges = (np.maximum(rows, 0) for rows in self._rows)
        lengths, angles = edge_lengths(parts, edges), dihedral_angles(parts, hinges)
        blended_lengths, blended_angles = self.poses.target(weights)
        mine = self.blended_edges
        lengths[mine] = clamp_lengths(blended_lengths[mine] / self.poses.diagonal, self.length_weights[mine])
        angles[self.blended_hinges] = blended_angles[self.blended_hinges]
        return PaperFrame(lengths, angles, parts, rotations, centres)

    @cached_property
    def pieces(self) -> list[Index]:
        """Vertices of all parts, then of all joints."""
        cut = self.decomposition
        return [*cut.parts, *(joint.vertices for joint in cut.joints)]

    @cached_property
    def overlaps(self) -> Overlaps:
        """The vertices that they share."""
        cut = self.decomposition
        # Pairs are judged by their first piece, and pairs of joints (which share no face) do not count.
        shapes = np.split(self.shapes, np.cumsum([len(part) for part in cut.parts])[:-1])
        nowhere = [np.zeros((len(joint.vertices), 3)) for joint in cut.joints]
        return Overlaps.of(self.pieces, [*shapes, *nowhere])

    @cached_property
    def seams(self) -> Seams:
        """Their edges."""
        return Seams.of(self.poses.topology, self.pieces)

    def assembled(self, frame: PaperFrame, joints: list[Float]) -> Float:
        """Return the mesh ``(V, 3)`` of parts and of joints ``(n, 3)``, each anywhere.

        Edges of joints have the blended lengths, as far as joints have them, and others their own.
        """
        lengths = np.where(self.blended_edges, frame.lengths, np.nan)
        overlaps, points = self.overlaps, np.concatenate([frame.parts, *joints])
        rotation, translation = register(overlaps, points)
        turns = quat_to_matrix(frame.rotations)[overlaps.group]
        centres = transform_points(translation[:, None], turns, frame.centres[overlaps.group])[:, 0]
        return stitch(self.seams, overlaps.move(points, turns @ rotation, centres), lengths)
