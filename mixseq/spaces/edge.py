r"""The space S_e of edge lengths and dihedral angles, and its projections to meshes (Froehlich and Botsch 2011).

A vector is ``[edge lengths | dihedral angles | volumes | pose]``, in diagonals, radians and cubic diagonals; volumes
are optional. The paper counts ``2 E + 6`` numbers, since a closed surface has as many hinges as edges. Lengths and
angles determine a mesh up to its pose, except at triangles without area, which have undefined normals.

Two projections find the mesh nearest to possibly inconsistent lengths and angles, piece by piece, without fixed
vertices:

`RelaxedShell`
    Frames of faces are chained from the middle of every piece by lengths and angles, and averaged
    (`mixseq.shells.face_frames`). Vertices follow from the sides of faces, and relaxation reduces the errors of lengths
    and angles (`mixseq.shells.shell`). Averaging, which distributes errors globally, then alternates with relaxation,
    which reduces errors locally. All matrices are constant.
`DiscreteShell` (DSO, Froehlich and Botsch 2011)
    Pose-independent linear initialisation is followed by Gauss-Newton (`mixseq.shells.fitting`). Without
    initialisation, Gauss-Newton would be trapped in local minima if poses are distant (the paper's Figure 17).

Both projections are exact for consistent lengths and angles. DSO optionally fits the volumes of pieces,

.. math:: V(x) = \tfrac16 \sum_{ijk} \det(x_i - c,\; x_j - c,\; x_k - c) ,

with the mean c of the vertices. For a closed surface V is independent of c; for an open surface it is the volume of the
cone from its centre, invariant under rigid motions. The residual is :math:`w\,(V - V^*) / \bar V` with the volume
:math:`\bar V` of the reference. Sheets, with :math:`|\bar V|` below `MIN_VOLUME_RATIO` times area to the 3/2, have no
volume term.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.choices import PROJECTIONS, ProjectionName
from mixseq.errors import SettingsError
from mixseq.mesh.measures import (
    clamp_lengths,
    dihedral_angles,
    edge_lengths,
    length_weights,
    signed_volume,
    triangle_areas,
    unwrap_angles,
)
from mixseq.mesh.rotations import quat_to_matrix
from mixseq.mesh.topology import Topology, connected_components
from mixseq.runtime.lazy import PickledWithoutCaches, cached_property
from mixseq.runtime.progress import log_progress
from mixseq.segmentation.joints import make_joint
from mixseq.shells.face_frames import FrameGraph, bridging_mask, flat_triangles, rotate_sides, triangle_frames
from mixseq.shells.fitting import Patch, ShellProblem, ShellReport, ShellSettings, fit_shell, linear_initialisation
from mixseq.shells.shell import ZERO_AREA_HEIGHT_RATIO, Relaxed, Shell
from mixseq.spaces.base import ANGLE_WEIGHT
from mixseq.spaces.pieces import Pieces, PosedSpace
from mixseq.types import Float, FloatArray, Index, IntArray


class ShellTargets(NamedTuple):
    """Target lengths, angles and volumes of a mesh, and their weights."""

    lengths: Float  # (E,) edge lengths
    length_weights: Float  # (E,) inverse typical lengths
    angles: Float  # (H,) dihedral angles in radians, modulo full turns
    volumes: Float  # (p,) volumes of the pieces; empty without volume terms
    volume_weights: Float  # (p,) volume weights, divided by typical volumes; 0 for sheets


MIN_VOLUME_RATIO = 1e-3  # least ratio of volume to area to the 3/2 of a surface with a volume term; a sphere has 0.094


def is_sheet(points: FloatArray, faces: IntArray) -> bool:
    """Whether a surface has too little volume for a volume term."""
    area = float(triangle_areas(points, faces).sum())
    return bool(abs(signed_volume(points, faces)) <= MIN_VOLUME_RATIO * area**1.5)


class ShellPiece(NamedTuple):
    """A hinge-connected piece: its rows and patch, and the edges and hinges of the mesh in the patch."""

    rows: slice
    patch: Patch
    edge_ids: Index
    hinge_ids: Index


@dataclass(frozen=True, eq=False)
class DiscreteShell(PickledWithoutCaches):
    """Projection of lengths and angles by Gauss-Newton over each piece of a mesh."""

    topology: Topology  # connectivity of the mesh
    pieces: Pieces  # its hinge-connected pieces

    @cached_property
    def shell_pieces(self) -> tuple[ShellPiece | None, ...]:
        """All pieces of the mesh, None for pieces of unused vertices."""
        no_vertices = np.zeros(self.topology.vertex_count, dtype=bool)
        shells: list[ShellPiece | None] = []
        for rows, face_ids in zip(self.pieces.row_slices, self.pieces.faces, strict=True):
            if not len(face_ids):
                shells.append(None)
                continue
            mask = np.isin(np.arange(len(self.topology.faces)), face_ids)
            joint = make_joint(self.topology, mask, no_vertices)
            patch = Patch.from_joint(self.topology, joint, np.zeros(len(joint.vertices), dtype=bool))
            shells.append(ShellPiece(rows, patch, joint.edge_ids, joint.hinge_ids))
        return tuple(shells)

    def piece_volumes(self, x: FloatArray) -> Float:
        """Return the signed volumes ``(p,)`` of the pieces of a frame ``(V, 3)``, 0 for unused vertices."""
        return np.array([signed_volume(*surface) for surface in self._surfaces(x)])

    def volume_weights(self, x: FloatArray) -> Float:
        """Return the inverse volumes ``(p,)`` of the pieces of a typical frame ``(V, 3)``, 0 for sheets."""
        surfaces = self._surfaces(x)
        return np.array([0.0 if is_sheet(x, f) else 1.0 / abs(signed_volume(x, f)) for x, f in surfaces])

    def piece_areas(self, x: FloatArray) -> Float:
        """Return the areas ``(p,)`` of the pieces of a frame ``(V, 3)``."""
        return np.array([float(triangle_areas(*surface).sum()) for surface in self._surfaces(x)])

    def _surfaces(self, x: FloatArray) -> list[tuple[FloatArray, Index]]:
        """Return the vertices and triangles of every piece of a frame ``(V, 3)``."""
        no_faces = np.zeros((0, 3), dtype=np.int64)
        pairs = zip(self.pieces.vertices, self.shell_pieces, strict=True)
        return [(x[ids], no_faces if piece is None else piece.patch.faces) for ids, piece in pairs]

    def fit(self, targets: ShellTargets, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Fit rows ``(N, 3)`` of pieces in any pose; raise `ReconstructionError` for lengths or angles not finite.

        *Rows* are the vertices of all pieces, piece after piece, see `mixseq.spaces.pieces`.
        """
        rows, reports = np.zeros_like(self.pieces.shapes), []
        for number, piece in enumerate(self.shell_pieces):
            if piece is None:
                continue
            problem = self.problem(number, piece, targets, settings)
            start = linear_initialisation(piece.patch, problem.lengths, problem.angles, rows[piece.rows])
            rows[piece.rows], report = fit_shell(problem, start, settings)
            reports.append(report)
        return rows, reports

    def problem(self, number: int, piece: ShellPiece, targets: ShellTargets, settings: ShellSettings) -> ShellProblem:
        """Return the fitting problem of one piece."""
        weights = targets.length_weights[piece.edge_ids]
        has_volume = targets.volumes.size > 0 and bool(targets.volume_weights[number])
        return ShellProblem(
            patch=piece.patch,
            lengths=clamp_lengths(targets.lengths[piece.edge_ids], weights),
            angles=targets.angles[piece.hinge_ids],
            length_weights=weights,
            bending=settings.bending,
            volume=float(targets.volumes[number]) if has_volume else None,
            volume_weight=float(targets.volume_weights[number]) if has_volume else 1.0,
        )


CHAIN_AVERAGING_ROUNDS = 10  # rounds of rotation averaging after chaining
MAX_CYCLES = 4  # largest number of cycles of relaxation; between cycles, frames are averaged once
STEPS_PER_CYCLE = 20  # relaxation steps per cycle


@dataclass(frozen=True, eq=False)
class RelaxedShell(PickledWithoutCaches):
    """Projection of lengths and angles to a mesh by constant matrices."""

    topology: Topology  # connectivity of the mesh
    pieces: Pieces  # its hinge-connected pieces, with shapes of typical lengths
    typical_lengths: Float  # (E,) typical lengths of all edges

    @cached_property
    def _piece_mesh(self) -> tuple[Topology, Index, Index]:
        """The mesh with separate vertices for every piece, and the ids of its edges and hinges in the original mesh."""
        topology = Topology(self.pieces.face_rows(self.topology), len(self.pieces.shapes))
        # Pieces share no edges, so that both meshes have the same edges. Hinges are ordered by edges, then by faces.
        edge_ids = np.empty(len(topology.edges), dtype=np.int64)
        edge_ids[topology.face_edges] = self.topology.face_edges
        hinge_ids = np.argsort(np.argsort(edge_ids[topology.hinge_edges], kind="stable"))
        return topology, edge_ids, hinge_ids

    @cached_property
    def shell(self) -> Shell:
        """The mesh as a shell, with one fixed vertex per piece."""
        topology, edge_ids, _ = self._piece_mesh
        position_weights = np.zeros(topology.vertex_count)
        position_weights[[rows.start for rows in self.pieces.row_slices]] = 1.0
        typical = self.typical_lengths[edge_ids]
        return Shell(topology, self.pieces.shapes, typical, position_weights)

    @cached_property
    def _bridging_hinge_ids(self) -> Index:
        """Hinges ``(h,)`` between frames: sound hinges, and unsound hinges where no sound hinges connect faces."""
        hinge_faces = self._piece_mesh[0].hinge_faces
        sound = self.shell.sound_hinge_mask
        return np.flatnonzero(bridging_mask(len(self.topology.faces), hinge_faces, sound))

    @cached_property
    def frame_graph(self) -> FrameGraph:
        """Graph of the frames of all faces; chains start in the middle of every piece."""
        pairs = self._piece_mesh[0].hinge_faces[self._bridging_hinge_ids].astype(np.int64)
        count = len(self.topology.faces)
        known = np.isin(np.arange(count), _central_nodes(count, pairs))
        return FrameGraph(
            pairs,
            np.maximum(self.shell.relative_angle_weights[self._bridging_hinge_ids], ZERO_AREA_HEIGHT_RATIO),
            known,
        )

    def fit(self, targets: ShellTargets, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Fit rows as `DiscreteShell.fit` does; only the tolerance of the settings is used."""
        topology, edge_ids, hinge_ids = self._piece_mesh
        lengths = clamp_lengths(targets.lengths, targets.length_weights)[edge_ids]
        angles = targets.angles[hinge_ids]
        flat = flat_triangles(lengths[topology.face_edges])
        rotations = self.shell.hinge_frames.rotations(flat, angles)[self._bridging_hinge_ids]
        known = np.tile([1.0, 0.0, 0.0, 0.0], (int(np.count_nonzero(self.frame_graph.known_mask)), 1))
        frames = self.frame_graph.chain(rotations, known)
        frames = self.frame_graph.average(frames, rotations, CHAIN_AVERAGING_ROUNDS)
        best, steps = Relaxed(self.pieces.shapes, np.inf), 0
        for _ in range(MAX_CYCLES):
            start = self.shell.integrate(rotate_sides(quat_to_matrix(frames), flat), best.points)
            points = self.shell.relax(start, lengths, angles, STEPS_PER_CYCLE).points
            steps += STEPS_PER_CYCLE
            energy = self.shell.energy(points, lengths, angles)
            is_done = self.shell.is_exact(energy) or energy > (1.0 - settings.tolerance) * best.energy
            best = min(Relaxed(points, energy), best, key=lambda relaxed: relaxed.energy)
            if is_done:
                break
            frames = self.frame_graph.average(triangle_frames(best.points, topology.faces), rotations, 1)
        return best.points, [ShellReport(2.0 * best.energy, steps, True)]


def _central_nodes(count: int, pairs: Index) -> Index:
    """Return the node in the middle of the longest path of every component connected by pairs ``(h, 2)``."""
    graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    component = connected_components(count, pairs)

    def nearest(distances: Float) -> Index:
        order = np.lexsort((np.arange(count), distances, component))
        return order[np.unique(component[order], return_index=True)[1]]

    def distances_from(sources: Index) -> Float:
        search = partial(csgraph.dijkstra, directed=False, unweighted=True, min_only=True)
        return np.asarray(search(graph, indices=sources))

    from_end = distances_from(nearest(-distances_from(nearest(np.zeros(count)))))
    return nearest(np.maximum(from_end, distances_from(nearest(-from_end))))


@dataclass(frozen=True)
class EdgeSettings:
    """Settings of the projection of edge lengths and dihedral angles to a mesh.

    Attributes
    ----------
    projection : {"steps", "dso"}
        Fixed number of steps with constant matrices, or Gauss-Newton until convergence (Froehlich and Botsch 2011).
    volume : float
        DSO: weight of a relative change of volume against a relative change of length; 0 for no volume term. Weights
        are large, because a mesh has thousands of lengths for one volume: 10 halves the error of volumes between poses
        of animals, 100 leaves less than 0.1 %.
    shell : ShellSettings, optional
        DSO: weight of the angles, and convergence limits of Gauss-Newton.

    Raises
    ------
    SettingsError
        If a setting is out of range, or does not apply to the projection.
    """

    projection: ProjectionName = "steps"
    volume: float = 0.0
    shell: ShellSettings | None = None

    def __post_init__(self) -> None:
        if self.projection not in PROJECTIONS:
            names = " or ".join(map(repr, PROJECTIONS))
            raise SettingsError(f"projection is {self.projection!r}; {names} is expected")
        if not (np.isfinite(self.volume) and self.volume >= 0):
            raise SettingsError(f"volume is {self.volume}; a weight of 0 or more is expected")
        if self.volume and self.projection != "dso":
            raise SettingsError(f"projection {self.projection!r} has no use for volume; leave it out, or choose 'dso'")


@dataclass(frozen=True, eq=False)
class EdgeSpace(PosedSpace):
    """Shapes are edge lengths and dihedral angles."""

    reference_lengths: Float  # (E,) mean lengths of edges; inverse weights of lengths in the fits
    settings: EdgeSettings
    name = "edge"

    @property
    def shell(self) -> ShellSettings:
        """Settings of the fits to lengths and angles."""
        return self.settings.shell or ShellSettings()

    @cached_property
    def projection(self) -> DiscreteShell | RelaxedShell:
        """Projection of lengths and angles to a mesh."""
        if self.settings.projection == "dso":
            return self.discrete_shell
        return RelaxedShell(self.topology, self.pieces, self.reference_lengths)

    @cached_property
    def discrete_shell(self) -> DiscreteShell:
        """The mesh as a discrete shell."""
        return DiscreteShell(self.topology, self.pieces)

    @cached_property
    def _volume_weights(self) -> Float:
        """Weights ``(p,)`` of the volumes of pieces, 0 for sheets; empty without volume terms."""
        if not self.settings.volume:
            return np.zeros(0)
        return self.settings.volume * self.discrete_shell.volume_weights(self.reference)

    @property
    def block_sizes(self) -> tuple[int, int, int]:
        """Numbers of lengths, angles and volumes of a shape."""
        return len(self.topology.edges), len(self.topology.hinges), len(self._volume_weights)

    @property
    def shape_dim(self) -> int:
        """Implement `PosedSpace.shape_dim`."""
        return sum(self.block_sizes)

    @property
    def paper_dimension(self) -> int:
        """Dimension as counted in the paper: a length and an angle for every edge, and a pose."""
        return 2 * len(self.topology.edges) + 6

    @property
    def shape_metric(self) -> Float:
        """Implement `PosedSpace.shape_metric`; vertices move by the change of volume over the area."""
        lengths, volumes = edge_lengths(self.reference, self.topology.edges), np.zeros(0)
        if len(self._volume_weights):
            areas = self.discrete_shell.piece_areas(self.reference)
            volumes = np.divide(1.0, areas, out=np.zeros_like(areas), where=areas > 0)
        angles = ANGLE_WEIGHT * lengths[self.topology.hinge_edges]
        return np.concatenate([np.ones(len(lengths)), angles, volumes])

    def measure_shape(self, x: Float) -> Float:
        """Implement `PosedSpace.measure_shape`."""
        volumes = self.discrete_shell.piece_volumes(x) if len(self._volume_weights) else np.zeros(0)
        lengths, angles = edge_lengths(x, self.topology.edges), dihedral_angles(x, self.topology.hinges)
        return np.concatenate([lengths, angles, volumes])

    def unwrap_shapes(self, shapes: Float, previous: Float | None) -> Float:
        """Implement `PosedSpace.unwrap_shapes`."""
        result, start = np.array(shapes), len(self.topology.edges)
        angles = slice(start, start + len(self.topology.hinges))
        reference = dihedral_angles(self.reference, self.topology.hinges)
        before = reference if previous is None else previous[angles]
        result[:, angles] = unwrap_angles(result[:, angles], before)
        return result

    def rebuild_rows(self, shape: Float) -> Float:
        """Implement `PosedSpace.rebuild_rows`."""
        return self.projection.fit(self.targets(shape), self.shell)[0]

    def targets(self, shape: Float) -> ShellTargets:
        """Return the target lengths, angles and volumes of a shape ``(S,)``."""
        lengths, angles, volumes = np.split(shape, np.cumsum(self.block_sizes)[:-1])
        weights = length_weights(self.reference_lengths)
        return ShellTargets(lengths, weights, angles, volumes, self._volume_weights)

    def decode_for_differences(self, vectors: Float) -> Float:
        """Implement `ShapeSpace.decode_for_differences`."""
        return self.decode_with_reports(vectors, shell=self.shell.for_differences())[0]

    def decode_with_reports(
        self, vectors: Float, shell: ShellSettings | None = None
    ) -> tuple[Float, list[list[ShellReport]]]:
        """Decode vectors ``(T, D)`` to points ``(T, V, 3)``, and return the reports of the fits of every frame."""
        reports: list[list[ShellReport]] = []

        def rebuild(shape: Float) -> Float:
            rows, report = self.projection.fit(self.targets(shape), shell or self.shell)
            reports.append(report)
            return rows

        return self._decode_with(vectors, rebuild, log_progress), reports
