"""The mixed shape space S_m: rigid parts by their vertices, joints by lengths and angles.

A vector is ``[joint edge lengths | joint hinge angles | aligned part vertices | pose]`` (paper, Section 2.2),
in units of the bounding-box diagonal and radians. Every part is registered over the whole sequence first
(Section 3.4): its mean shape is part of the space, a frame's part is stored as aligned to that mean. So vectors
combine by plain weighted sums.

Two placements tell where the parts of a decoded frame go:

anchored (default, ours)
    The pose is six numbers for every part, a rotation vector and a centre. Joints are boundary value problems
    between parts that are already in place, and only lengths and angles at free vertices are stored.
free (the paper's)
    The pose is six numbers for every connected component, those of its first part (the largest, where parts were
    found by motion). Joints are rebuilt on their own, all pieces are registered through the vertices they share,
    and stitched.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, unwrap_angles
from mixseq.geometry.rigid import kabsch, mean_shape
from mixseq.geometry.rotations import continuous_vectors, matrices
from mixseq.progress import Progress, silent
from mixseq.reconstruction.anchored import AnchoredPlacement
from mixseq.reconstruction.free import FreePlacement
from mixseq.reconstruction.placement import MixedFrame, Placement
from mixseq.reconstruction.shells import ShellReport, ShellSettings
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import FloatArray, bounding_diagonal
from mixseq.spaces.base import ShapeSpace
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology

Float = NDArray[np.float64]
PlacementName = Literal["anchored", "free"]
PLACEMENTS: tuple[PlacementName, ...] = ("anchored", "free")


class MixedBlocks(NamedTuple):
    """The blocks of T vectors of S_m: p parts with N vertices in all, g poses.

    Attributes
    ----------
    lengths : (T, E')
        Edge lengths, joint by joint.
    angles : (T, H')
        Hinge angles in radians, joint by joint, unwrapped.
    parts : (T, N, 3)
        Vertices of the parts, aligned to their mean shapes, part by part.
    rotations : (T, g, 3)
        Rotation vectors from the mean shape to the frame, unwrapped.
    translations : (T, g, 3)
        Where the centre of the mean shape goes.
    """

    lengths: Float
    angles: Float
    parts: Float
    rotations: Float
    translations: Float


@dataclass(frozen=True, eq=False)
class MixedSpace(ShapeSpace):
    """The mixed shape space of one mesh sequence; make it with `mixed_space`.

    Attributes
    ----------
    topology : Topology
        Connectivity of the mesh.
    decomposition : Decomposition
        Its parts and joints.
    placement : {"anchored", "free"}
        How parts are placed, see the module.
    scale : float
        Length of the unit of the space, in the units of the sequence: the diagonal of the first frame.
    shapes : (N, 3) float64
        Mean shapes of all parts, each centred, part by part, in the space's unit.
    reference_lengths : (E',) float64
        Mean edge lengths; their inverses weigh lengths in joint solves.
    reference : (V, 3) float64
        The first frame, in the space's unit: the first frame of an encoded sequence stays near its angles, and
        guesses of the joints are blended from it.
    settings : ShellSettings
        Settings of the joint solves.
    """

    topology: Topology
    decomposition: Decomposition
    placement: PlacementName
    scale: float
    shapes: Float
    reference_lengths: Float
    reference: Float
    settings: ShellSettings

    @cached_property
    def projection(self) -> Placement:
        """What puts decoded parts and joints together."""
        return _projection(self.topology, self.decomposition, self.placement, self.shapes, self.reference)

    @cached_property
    def reference_angles(self) -> Float:
        """Hinge angles ``(H',)`` of the reference frame."""
        return dihedral_angles(self.reference, self.topology.hinges[self.projection.hinge_ids])

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the blocks of a vector, in order."""
        groups = len(self.projection.posed)
        edges, hinges = len(self.projection.edge_ids), len(self.projection.hinge_ids)
        return (edges, hinges, 3 * len(self.shapes), 3 * groups, 3 * groups)

    @property
    def dim(self) -> int:
        """Length D of a vector."""
        return sum(self.sizes)

    def split(self, vectors: Float) -> MixedBlocks:
        """Return the blocks of vectors ``(T, D)``, as views where possible."""
        if vectors.ndim != 2 or vectors.shape[1] != self.dim:
            raise SettingsError(f"vectors have shape {vectors.shape}; (T, {self.dim}) is expected")
        lengths, angles, parts, rotations, translations = np.split(
            vectors, np.cumsum(self.sizes)[:-1], axis=1
        )
        triples = (
            block.reshape(len(block), block.shape[1] // 3, 3) for block in (parts, rotations, translations)
        )
        return MixedBlocks(lengths, angles, *triples)

    def join(self, blocks: MixedBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return np.concatenate([block.reshape(len(block), -1) for block in blocks], axis=1)

    def encode(self, points: FloatArray, previous: Float | None = None) -> Float:
        """Turn frames ``(T, V, 3)`` into vectors ``(T, D)``; see `ShapeSpace.encode`.

        A rigid motion of a frame changes nothing but its pose.
        """
        before = self.split(previous[None]) if previous is not None else None
        x = points.astype(np.float64) / self.scale
        projection = self.projection
        lengths = edge_lengths(x, self.topology.edges[projection.edge_ids])
        angles = unwrap_angles(
            dihedral_angles(x, self.topology.hinges[projection.hinge_ids]),
            before.angles[0] if before else self.reference_angles,
        )
        aligned, rotations, centres = [], [], []
        start = 0
        for vertices in self.decomposition.parts:
            shape = self.shapes[start : start + len(vertices)]
            rotation, centre = kabsch(shape, x[:, vertices])
            aligned.append((x[:, vertices] - centre[:, None]) @ rotation)
            rotations.append(rotation)
            centres.append(centre)
            start += len(vertices)
        posed = projection.posed
        turns = continuous_vectors(
            np.stack(rotations, axis=1)[:, posed], before.rotations[0] if before else None
        )
        translations = np.stack(centres, axis=1)[:, posed]
        return self.join(MixedBlocks(lengths, angles, np.concatenate(aligned, axis=1), turns, translations))

    def decode(self, vectors: Float, progress: Progress = silent) -> Float:
        """Turn vectors ``(T, D)`` into positions ``(T, V, 3)``: the projection P_m, frame by frame."""
        return self.decode_with_reports(vectors, progress)[0]

    def decode_with_reports(
        self, vectors: Float, progress: Progress = silent
    ) -> tuple[Float, list[list[ShellReport]]]:
        """Decode and tell how every joint of every frame was solved."""
        blocks = self.split(np.asarray(vectors, dtype=np.float64))
        points = np.empty((len(vectors), self.topology.vertex_count, 3))
        reports = []
        weights = 1.0 / np.maximum(self.reference_lengths, np.finfo(np.float64).tiny)
        with one_blas_thread():
            for frame in range(len(vectors)):
                mixed = MixedFrame(
                    lengths=blocks.lengths[frame],
                    angles=blocks.angles[frame],
                    weights=weights,
                    parts=blocks.parts[frame],
                    rotations=matrices(blocks.rotations[frame]),
                    translations=blocks.translations[frame],
                )
                points[frame], report = self.projection.assemble(mixed, self.settings)
                reports.append(report)
                progress(frame + 1, len(vectors), "decoding frames")
        return points * self.scale, reports


def _projection(
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName,
    shapes: Float,
    reference: Float,
) -> Placement:
    if placement == "anchored":
        return AnchoredPlacement(topology, decomposition, shapes, reference)
    return FreePlacement(topology, decomposition, shapes)


def mixed_space(
    points: FloatArray,
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName = "anchored",
    settings: ShellSettings | None = None,
) -> MixedSpace:
    """Make the mixed shape space of a sequence.

    Parameters
    ----------
    points : (T, V, 3) float
        The sequence, in any unit.
    topology : Topology
        Its connectivity.
    decomposition : Decomposition
        Parts and joints.
    placement : {"anchored", "free"}
        How parts are placed.
    settings : ShellSettings, optional
        Settings of the joint solves.

    Raises
    ------
    SettingsError
        If the placement is neither.
    """
    if placement not in PLACEMENTS:
        raise SettingsError(f"placement is {placement!r}; {' or '.join(map(repr, PLACEMENTS))} is expected")
    scale = bounding_diagonal(points[0]) or 1.0
    shapes = np.concatenate([mean_shape(points[:, part] / scale) for part in decomposition.parts])
    reference = points[0].astype(np.float64) / scale
    projection = _projection(topology, decomposition, placement, shapes, reference)
    edges = topology.edges[projection.edge_ids]
    lengths = np.mean([edge_lengths(frame.astype(np.float64), edges) for frame in points], axis=0)
    return MixedSpace(
        topology=topology,
        decomposition=decomposition,
        placement=placement,
        scale=scale,
        shapes=shapes,
        reference_lengths=lengths / scale,
        reference=reference,
        settings=settings or ShellSettings(),
    )
