"""The mixed shape space S_m: rigid parts by their vertices, joints by lengths and angles.

A vector is ``[joint edge lengths | joint hinge angles | aligned part vertices | pose]`` (paper, Section 2.2),
in units of the bounding-box diagonal and radians. Every part is registered over the whole sequence first
(Section 3.4): its mean shape is part of the space, a frame's part is stored as aligned to that mean. So vectors
combine by plain weighted sums.

Two placements tell where the parts of a decoded frame go:

anchored (default, ours)
    The pose is six numbers for every part, a rotation vector and a centre, and six for every pair of neighbouring
    parts, which say again how the two stand to each other (`mixseq.reconstruction.links`). At frames they agree;
    elsewhere the poses that agree best with all of them are taken. Joints are boundary value problems between
    parts that are already in place, and only lengths and angles at free vertices are stored.
free (the paper's)
    The pose is six numbers for every connected component, those of its first part (the largest, where parts were
    found by motion). Joints are rebuilt on their own, all pieces are registered through the vertices they share,
    and stitched.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, unwrap_angles, wrap
from mixseq.geometry.rigid import kabsch
from mixseq.geometry.rotations import vectors as shortest
from mixseq.geometry.rotations import without_jumps
from mixseq.progress import Progress, silent
from mixseq.reconstruction.agreement import cross_matrices, solve, velocities
from mixseq.reconstruction.anchored import AnchoredPlacement
from mixseq.reconstruction.free import FreePlacement
from mixseq.reconstruction.joint import length_weights
from mixseq.reconstruction.links import Links, complete
from mixseq.reconstruction.placement import MixedFrame, Placement
from mixseq.reconstruction.shells import ShellReport, ShellSettings
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import FloatArray
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.blocks import MixedBlocks
from mixseq.spaces.registered import radii_of_gyration, registered
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology

Float = NDArray[np.float64]
PlacementName = Literal["anchored", "free"]
PLACEMENTS: tuple[PlacementName, ...] = ("anchored", "free")

ANGLE = 0.3
"""Weight of a radian against the length of its hinge's edge, in the metric of the space."""

BESIDE_OFFSETS = 0.3
"""Weight of lengths and angles in the metric, where offsets, which weigh 1, tell of the same vertices."""


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
    links : Links
        Links between neighbouring parts; none in the free placement.
    trust : (q,) float64
        For every joint that is solved, how far between frames the offsets of its free vertices are to be trusted,
        relative to its lengths; none in the free placement.
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
    links: Links
    trust: Float
    settings: ShellSettings
    name = "mixed"

    @cached_property
    def projection(self) -> Placement:
        """What puts decoded parts and joints together."""
        return projection_of(self.topology, self.decomposition, self.placement, self.shapes, self.reference)

    def prepare(self) -> None:
        """Implement `ShapeSpace.prepare`."""
        self.projection.prepare()

    @cached_property
    def reference_angles(self) -> Float:
        """Hinge angles ``(H',)`` of the reference frame."""
        return dihedral_angles(self.reference, self.topology.hinges[self.projection.hinge_ids])

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the blocks of a vector, in order."""
        groups = len(self.projection.posed)
        edges, hinges = len(self.projection.edge_ids), len(self.projection.hinge_ids)
        poses = (3 * groups, 3 * groups, 3 * len(self.links), 3 * len(self.links))
        return (edges, hinges, 3 * len(self.shapes), *poses)

    @property
    def dim(self) -> int:
        """Length D of a vector."""
        return sum(self.sizes)

    @property
    def stored_placement_dim(self) -> int:
        """How many numbers of a vector say where parts are: rotations and translations."""
        return sum(self.sizes[3:5])

    @property
    def placement_dim(self) -> int:
        """How many numbers at the end of a vector say where parts are, and say it again: turns and gaps."""
        return sum(self.sizes[3:])

    def complete_placement(self, own: Float) -> Float:
        """Return the ends ``(N, placement_dim)`` of the vectors of consecutive frames from their own poses.

        Parameters
        ----------
        own : (N, stored_placement_dim) float64
            Rotations and translations.
        """
        if own.ndim != 2 or own.shape[1] != self.stored_placement_dim:
            raise SettingsError(
                f"placements have shape {own.shape}; (N, {self.stored_placement_dim}) is expected"
            )
        rotations, translations = np.moveaxis(own.reshape(len(own), 2, own.shape[1] // 6, 3), 1, 0)
        poses = complete(self.links, rotations, translations)
        return np.concatenate([block.reshape(len(own), -1) for block in poses], axis=1)

    @cached_property
    def radii(self) -> Float:
        """Radii of gyration ``(p,)`` of the parts, a small number for a part that has none."""
        return radii_of_gyration(self.shapes, self.decomposition.parts)

    @property
    def weights(self) -> Float:
        """The metric ``(D,)``: by how many diagonals vertices move when a number of a vector changes by one.

        1 for lengths, vertices, translations and gaps; for an angle `ANGLE` times the length of its edge in the
        reference; for a rotation vector the radius of gyration of the part, for a turn that of the smaller part.
        Where offsets tell of the joints too, lengths and angles count `BESIDE_OFFSETS` as much.
        """
        told = BESIDE_OFFSETS if self.offset_dim else 1.0
        edges = self.topology.hinge_edges[self.projection.hinge_ids]
        angles = ANGLE * edge_lengths(self.reference, self.topology.edges[edges])
        rotations = np.repeat(self.radii[self.projection.posed], 3)
        turns = np.repeat(self.radii[self.links.parts].min(axis=1), 3)
        lengths, _, parts, _, translations, _, gaps = (np.ones(size) for size in self.sizes)
        return np.concatenate([told * lengths, told * angles, parts, rotations, translations, turns, gaps])

    def split(self, vectors: Float) -> MixedBlocks:
        """Return the blocks of vectors ``(T, D)``, as views where possible."""
        if vectors.ndim != 2 or vectors.shape[1] != self.dim:
            raise SettingsError(f"vectors have shape {vectors.shape}; (T, {self.dim}) is expected")
        lengths, angles, *others = np.split(vectors, np.cumsum(self.sizes)[:-1], axis=1)
        triples = (block.reshape(len(block), block.shape[1] // 3, 3) for block in others)
        return MixedBlocks(lengths, angles, *triples)

    def join(self, blocks: MixedBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return np.concatenate([block.reshape(len(block), -1) for block in blocks], axis=1)

    def encode(self, points: FloatArray, previous: Float | None = None) -> Float:
        """Turn frames ``(T, V, 3)`` into vectors ``(T, D)``; see `ShapeSpace.encode`.

        A rigid motion of a frame changes nothing but its pose.
        """
        return self.without_jumps(self.encode_apart(points), previous)

    def encode_apart(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_apart`: angles and rotation vectors are the shortest ones."""
        vectors = np.empty((len(points), self.dim))
        edges = self.topology.edges[self.projection.edge_ids]
        hinges = self.topology.hinges[self.projection.hinge_ids]
        posed = self.projection.posed
        for vector, frame in zip(vectors, points, strict=True):
            x = frame.astype(np.float64) / self.scale
            aligned, turned, centres = registered(self.shapes, self.decomposition.parts, x)
            poses = complete(self.links, shortest(turned[None, posed]), centres[None, posed])
            lengths, angles = edge_lengths(x, edges), dihedral_angles(x, hinges)
            blocks = lengths, angles, aligned, *poses
            np.concatenate([block.reshape(-1) for block in blocks], out=vector)
        return vectors

    def without_jumps(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.without_jumps`."""
        before = self.split(previous[None]) if previous is not None else None
        blocks = self.split(vectors)
        return self.join(
            blocks._replace(
                angles=unwrap_angles(blocks.angles, before.angles[0] if before else self.reference_angles),
                rotations=without_jumps(blocks.rotations, before.rotations[0] if before else None),
                turns=without_jumps(blocks.turns, before.turns[0] if before else None),
            )
        )

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference`.

        Parts keep their poses, so that vertices that did not move stay where they are: what vertices of a part moved
        by is turned back by its rotation, not registered anew.
        """
        x = np.stack([before, after]) / self.scale
        lengths = np.diff(edge_lengths(x, self.topology.edges[self.projection.edge_ids]), axis=0)
        angles = np.diff(dihedral_angles(x, self.topology.hinges[self.projection.hinge_ids]), axis=0)
        rotations = self._rotations(vector, x[0])
        parts = self.decomposition.parts
        moved = [
            (x[1, part] - x[0, part]) @ rotation for part, rotation in zip(parts, rotations, strict=True)
        ]
        return np.concatenate([lengths[0], wrap(angles[0]), np.concatenate(moved).reshape(-1)])

    def _rotations(self, vector: Float, x: Float) -> Float:
        """Rotations ``(p, 3, 3)`` of all parts in a frame ``(V, 3)`` that was decoded from a vector, in diagonals."""
        blocks = self.split(vector[None])
        if self.placement == "anchored":
            rotations, _ = solve(self.links, blocks.poses)
            return np.asarray(rotations[0])
        ends = np.cumsum([len(part) for part in self.decomposition.parts])[:-1]
        shapes = np.split(blocks.parts[0], ends)
        pairs = zip(shapes, self.decomposition.parts, strict=True)
        return np.stack([kabsch(shape, x[part])[0] for shape, part in pairs])

    def decode(self, vectors: Float, progress: Progress = silent, offsets: Float | None = None) -> Float:
        """Turn vectors ``(T, D)`` into positions ``(T, V, 3)``: the projection P_m, frame by frame."""
        return self.decode_with_reports(vectors, progress, offsets)[0]

    def decode_with_reports(
        self,
        vectors: Float,
        progress: Progress = silent,
        offsets: Float | None = None,
        shell: ShellSettings | None = None,
    ) -> tuple[Float, list[list[ShellReport]]]:
        """Decode and tell how every joint of every frame was solved; other settings of the fits may be given."""
        vectors = np.asarray(vectors, dtype=np.float64)
        points = np.empty((len(vectors), self.topology.vertex_count, 3))
        reports = []
        with one_blas_thread():
            for number in range(len(vectors)):
                frame = self._frame(vectors[number], None if offsets is None else offsets[number])
                points[number], report = self.projection.assemble(frame, shell or self.settings)
                reports.append(report)
                progress(number + 1, len(vectors), "decoding frames")
        return points * self.scale, reports

    def decode_for_differences(self, vectors: Float, offsets: Float | None = None) -> Float:
        """Implement `ShapeSpace.decode_for_differences`."""
        return self.decode_with_reports(vectors, offsets=offsets, shell=self.settings.for_differences())[0]

    def decode_moving(
        self,
        vectors: Float,
        rates: Float,
        offsets: Float | None = None,
        offset_rates: Float | None = None,
    ) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_moving`; closed derivatives for the anchored placement."""
        projection = self.projection
        if not isinstance(projection, AnchoredPlacement):
            return super().decode_moving(vectors, rates, offsets, offset_rates)
        points, velocities = np.empty((2, len(vectors), self.topology.vertex_count, 3))
        with one_blas_thread():
            for number in range(len(vectors)):
                frame = self._frame(vectors[number], None if offsets is None else offsets[number])
                moving = self._rate(
                    frame,
                    vectors[number],
                    rates[number],
                    None if offset_rates is None else offset_rates[number],
                )
                points[number], _ = projection.assemble(frame, self.settings)
                velocities[number] = projection.velocities(frame, moving, points[number], self.settings)
        return points * self.scale, velocities * self.scale

    def _frame(self, vector: Float, offsets: Float | None) -> MixedFrame:
        """The blocks of a vector, with poses that agree."""
        blocks = self.split(vector[None])
        rotations, translations = solve(self.links, blocks.poses)
        return MixedFrame(
            lengths=blocks.lengths[0],
            angles=blocks.angles[0],
            weights=length_weights(self.reference_lengths),
            parts=blocks.parts[0],
            rotations=rotations[0],
            translations=translations[0],
            offsets=np.zeros((0, 3)) if offsets is None else offsets.reshape(-1, 3),
            holds=np.zeros(0) if offsets is None else self.holds,
        )

    def _rate(self, frame: MixedFrame, vector: Float, rate: Float, offset_rate: Float | None) -> MixedFrame:
        """The derivative of `_frame` by time."""
        blocks, changes = self.split(vector[None]), self.split(rate[None])
        spins, speeds = velocities(self.links, blocks.poses, changes.poses)
        return frame._replace(
            lengths=changes.lengths[0],
            angles=changes.angles[0],
            parts=changes.parts[0],
            rotations=cross_matrices(spins[0]) @ frame.rotations,
            translations=speeds[0],
            offsets=np.zeros_like(frame.offsets) if offset_rate is None else offset_rate.reshape(-1, 3),
        )

    @cached_property
    def holds(self) -> Float:
        """Weights ``(F,)`` of the offsets of all free vertices: the joint's trust over the mean edge length."""
        projection = self.projection
        if not isinstance(projection, AnchoredPlacement):
            return np.zeros(0)
        rows = projection.rows
        counts = [len(patch.free) for patch in rows.patches]
        spacing = np.maximum(rows.spacing(self.reference_lengths), np.finfo(np.float64).tiny)
        return np.repeat(self.trust, counts) / spacing

    @property
    def offset_dim(self) -> int:
        """Three numbers for every free vertex of the anchored placement."""
        return 3 * len(self.holds)

    def offsets(self, points: FloatArray, vectors: Float) -> Float:
        """Implement `ShapeSpace.offsets`: see `AnchoredPlacement.offsets`."""
        projection = self.projection
        if not isinstance(projection, AnchoredPlacement):
            return np.zeros((len(vectors), 0))
        rotations, translations = solve(self.links, self.split(vectors).poses)
        frames = zip(rotations, translations, points, strict=True)
        offsets = [projection.offsets(r, t, x.astype(np.float64) / self.scale) for r, t, x in frames]
        return np.stack(offsets).reshape(len(vectors), -1)


def projection_of(
    topology: Topology,
    decomposition: Decomposition,
    placement: PlacementName,
    shapes: Float,
    reference: Float,
) -> Placement:
    """Return what puts parts and joints together in a placement."""
    if placement == "anchored":
        return AnchoredPlacement(topology, decomposition, shapes, reference)
    return FreePlacement(topology, decomposition, shapes)
