r"""Projections of the space S_e: from lengths and angles that no mesh may have to the nearest mesh.

There are two, `mixseq.spaces.edge` and `mixseq.spaces.edge`.

Discrete shells (DSO, Froehlich and Botsch 2011): every piece of a mesh as a whole, without fixed vertices.

Linear initialisation (`mixseq.shells.fitting`) is followed by Gauss-Newton on all lengths and angles, and on the
volume if that is a target. Gauss-Newton gets trapped from distant poses (the paper's Figure 17); the linear start uses
no pose, and is exact where a mesh has these lengths and angles.

With :math:`c` the mean of a piece's vertices its signed volume is

.. math:: V(x) = \tfrac16 \sum_{ijk} \det(x_i - c,\; x_j - c,\; x_k - c) .

For a closed surface this is independent of c; for an open one it is the volume of the cone from its centre, invariant
under rigid motions. The volume term is one residual :math:`w\,(V - V^*) / \bar V`, with :math:`\bar V` the volume of
the reference. Sheets, with :math:`|\bar V|` below `FLAT` times area to the 3/2, have no volume term.

The projection of the space S_e by steps with constant matrices.

Faces are rebuilt from their lengths and rotated by the angles: frames are chained from the middle of every piece, and
averaged (`mixseq.shells.face_frames`). Vertices follow from the sides of faces, and relaxation steps reduce the errors
of lengths and angles (`mixseq.shells.shell`). Then frames and steps alternate a few times: frames distribute errors
globally, steps locally. The first mesh is exact where a mesh has these lengths and angles. All matrices are constant.

The space S_e of edge lengths and dihedral angles (Winkler et al. 2010; Froehlich and Botsch 2011).

A vector is ``[edge lengths | dihedral angles | volumes | pose]``, in diagonals, radians and cubic diagonals; volumes
are optional. The paper counts ``2 E + 6`` numbers: a closed surface has as many hinges as edges.

Lengths and angles determine a mesh up to its pose, except at triangles without area: their normals are undefined, and
the surface around them may come back bent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.choices import PROJECTIONS, ProjectionName
from mixseq.errors import SettingsError
from mixseq.mesh.measures import dihedral_angles, edge_lengths, length_weights, sound_lengths, unwrap_angles
from mixseq.mesh.topology import Topology
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, silent
from mixseq.segmentation.joints import make_joint
from mixseq.shells.face_frames import (
    FrameGraph,
    Hinges,
    bridging,
    connected,
    flat_triangles,
    frames_of,
    turned_sides,
)
from mixseq.shells.fitting import Patch, ShellProblem, fit_shell, linear_initialisation
from mixseq.shells.gauss_newton import ShellReport, ShellSettings
from mixseq.shells.shell import THIN, Relaxation, Relaxed, Shell
from mixseq.spaces.base import ANGLE
from mixseq.spaces.pieces import Pieces, PosedSpace
from mixseq.types import Float, FloatArray, Index, IntArray


class Wanted(NamedTuple):
    """Targets of a mesh, and their weights."""

    lengths: Float  # (E,) edge lengths
    weights: Float  # (E,) weights of the lengths: one over the typical length
    angles: Float  # (H,) dihedral angles of all hinges in radians, whole turns do not matter
    volumes: Float  # (p,) volumes of the pieces; empty without a volume term
    volume_weights: Float  # (p,) weights of the volumes, over the typical volume; 0 for sheets


class EdgeProjection(Protocol):
    """Rebuilds the hinge-connected pieces of one mesh.

    *Rows* are the vertices of all pieces, piece after piece, see `mixseq.spaces.pieces`.
    """

    def prepared(self) -> Self:
        """Compute what all frames share, as `PickledWithoutCaches.prepared`."""

    def fit(self, wanted: Wanted, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Fit rows ``(N, 3)``, pieces in any pose; raises `ReconstructionError` if lengths or angles are not finite."""


FLAT = 1e-3
"""Least ratio of volume to area to the 3/2 of a surface with a volume term; that of a sphere is 0.094."""


def volume(points: FloatArray, faces: IntArray) -> float:
    """Return the signed volume of points ``(n, 3)`` about their mean, over faces ``(m, 3)``."""
    x = points - points.mean(axis=0)
    a, b, c = (x[corner] for corner in faces.T)
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6.0


def volume_gradient(points: FloatArray, faces: IntArray) -> Float:
    """Return the derivatives ``(n, 3)`` of `volume`; they add up to zero."""
    x = points - points.mean(axis=0)
    a, b, c = (x[corner] for corner in faces.T)
    pulls = np.concatenate([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) / 6.0
    corners = faces.T.reshape(-1)
    gradient = np.stack([np.bincount(corners, pull, minlength=len(x)) for pull in pulls.T], axis=1)
    return np.asarray(gradient - gradient.mean(axis=0))


def surface_area(points: FloatArray, faces: IntArray) -> float:
    """Return the area of points ``(n, 3)`` over faces ``(m, 3)``."""
    a, b, c = (points[corner] for corner in faces.T)
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def is_sheet(points: FloatArray, faces: IntArray) -> bool:
    """Return whether a surface has too little volume for a volume term; see the module."""
    return bool(abs(volume(points, faces)) <= FLAT * surface_area(points, faces) ** 1.5)


@dataclass(frozen=True, eq=False)
class VolumeTerm:
    """The residual of the volume, a `DenseTerm` of `mixseq.shells.fitting`."""

    faces: NDArray[np.int64]  # (m, 3) triangles of the surface
    target: float  # target volume
    # Weight of the term over the volume of the reference, so that the residual counts relative changes.
    weight: float

    def residual(self, points: Float) -> float:
        """Implement `DenseTerm.residual`."""
        return self.weight * (volume(points, self.faces) - self.target)

    def gradient(self, points: Float) -> Float:
        """Implement `DenseTerm.gradient`."""
        return self.weight * volume_gradient(points, self.faces)


class ShellPiece(NamedTuple):
    """A hinge-connected piece: its rows, its patch, and the mesh's edges and hinges in the patch."""

    rows: slice
    patch: Patch
    edge_ids: Index
    hinge_ids: Index


@dataclass(frozen=True, eq=False)
class DiscreteShell(PickledWithoutCaches):
    """An `EdgeProjection` by Gauss-Newton over each piece of a mesh."""

    topology: Topology  # connectivity of the mesh
    pieces: Pieces  # its hinge-connected pieces

    @cached_property
    def shells(self) -> tuple[ShellPiece | None, ...]:
        """All pieces; None for vertices without faces."""
        nowhere = np.zeros(self.topology.vertex_count, dtype=bool)
        shells: list[ShellPiece | None] = []
        for rows, faces in zip(self.pieces.slices, self.pieces.faces, strict=True):
            if not len(faces):
                shells.append(None)
                continue
            mask = np.zeros(len(self.topology.faces), dtype=bool)
            mask[faces] = True
            whole = make_joint(self.topology, mask, nowhere)
            patch = Patch.of_joint(self.topology, whole, np.zeros(len(whole.vertices), dtype=bool))
            shells.append(ShellPiece(rows, patch, whole.edge_ids, whole.hinge_ids))
        return tuple(shells)

    def constants(self) -> list[object]:
        """Implement `PickledWithoutCaches.constants`."""
        return [piece.patch for piece in self.shells if piece is not None]

    def volumes(self, x: FloatArray) -> Float:
        """Return the volumes ``(p,)`` of the pieces of a frame ``(V, 3)``, 0 of single vertices; see `volume`."""
        pairs = zip(self.pieces.vertices, self.shells, strict=True)
        return np.array([0.0 if piece is None else volume(x[own], piece.patch.faces) for own, piece in pairs])

    def volume_weights(self, x: FloatArray) -> Float:
        """Return inverse volumes ``(p,)`` of the pieces of a typical frame ``(V, 3)``, 0 where `is_sheet`."""
        weights = np.zeros(len(self.shells))
        for number, (own, piece) in enumerate(zip(self.pieces.vertices, self.shells, strict=True)):
            if piece is not None and not is_sheet(x[own], piece.patch.faces):
                weights[number] = 1.0 / abs(volume(x[own], piece.patch.faces))
        return weights

    def areas(self, x: FloatArray) -> Float:
        """Return the areas ``(p,)`` of the pieces of a frame ``(V, 3)``."""
        pairs = zip(self.pieces.vertices, self.shells, strict=True)
        return np.array(
            [0.0 if piece is None else surface_area(x[own], piece.patch.faces) for own, piece in pairs]
        )

    def fit(self, wanted: Wanted, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Implement `EdgeProjection.fit`."""
        rows, reports = np.zeros_like(self.pieces.shapes), []
        for number, piece in enumerate(self.shells):
            if piece is None:
                continue
            problem = self.problem(number, piece, wanted, settings)
            start = linear_initialisation(piece.patch, problem.lengths, problem.angles, rows[piece.rows])
            rows[piece.rows], report = fit_shell(problem, start, settings)
            reports.append(report)
        return rows, reports

    def problem(
        self, number: int, piece: ShellPiece, wanted: Wanted, settings: ShellSettings
    ) -> ShellProblem:
        """Return the fitting problem of one piece."""
        weights = wanted.weights[piece.edge_ids]
        term = None
        if wanted.volumes.size and wanted.volume_weights[number]:
            target, weight = wanted.volumes[number], wanted.volume_weights[number]
            term = VolumeTerm(piece.patch.faces, float(target), float(weight))
        return ShellProblem(
            patch=piece.patch,
            lengths=sound_lengths(wanted.lengths[piece.edge_ids], weights),
            angles=wanted.angles[piece.hinge_ids],
            length_weights=weights,
            bending=settings.bending,
            dense=term,
        )


ROUNDS = 10
"""Rounds of rotation averaging of chained frames."""

CYCLES = 4
"""Largest number of cycles of steps; in between, frames of the mesh are averaged once."""

STEPS = 20
"""Relaxation steps per cycle."""

NOTHING = np.zeros((0, 3))


class _Rows(NamedTuple):
    """The mesh with pieces that share no vertices; its faces are those of the mesh."""

    topology: Topology  # connectivity of the rows
    edge_ids: Index  # (E,) the mesh edge of every edge of the rows
    hinge_ids: Index  # (H,) the mesh hinge of every hinge of the rows


@dataclass(frozen=True, eq=False)
class RelaxedShell(PickledWithoutCaches):
    """An `EdgeProjection` by constant matrices."""

    topology: Topology  # connectivity of the mesh
    pieces: Pieces  # its hinge-connected pieces, with shapes of typical lengths
    typical: Float  # (E,) typical lengths of all edges
    bending: float  # weight of an angle in radians against a relative length

    @cached_property
    def _rows(self) -> _Rows:
        mesh, faces = self.topology, np.zeros((len(self.topology.faces), 3), dtype=np.int64)
        pieces = zip(self.pieces.slices, self.pieces.vertices, self.pieces.faces, strict=True)
        for rows, vertices, own in pieces:
            faces[own] = rows.start + np.searchsorted(vertices, mesh.faces[own])
        topology = Topology(faces, len(self.pieces.shapes))
        vertex = np.concatenate(self.pieces.vertices)
        # Both tables of edges have the same ones, as pieces share none; so have those of hinges.
        edge_ids = _places(vertex[topology.edges], mesh.edges)
        hinges = np.column_stack([edge_ids[topology.hinge_edges], topology.hinge_faces])
        hinge_ids = _places(hinges, np.column_stack([mesh.hinge_edges, mesh.hinge_faces]))
        return _Rows(topology, edge_ids, hinge_ids)

    @cached_property
    def shell(self) -> Shell:
        """The mesh as a shell, with one fixed vertex per piece."""
        topology, edge_ids, _ = self._rows
        position_weights = np.zeros(topology.vertex_count)
        position_weights[[rows.start for rows in self.pieces.slices]] = 1.0
        ties = np.zeros((0, 2), dtype=np.int64)
        return Shell(
            topology, self.pieces.shapes, self.typical[edge_ids], ties, position_weights, self.bending
        )

    @cached_property
    def _crossing(self) -> Index:
        """Hinges ``(h,)`` between frames: the sound ones, and others where they alone connect faces."""
        hinge_faces = self._rows.topology.hinge_faces
        return np.flatnonzero(bridging(len(self.topology.faces), hinge_faces, self.shell.sound))

    @cached_property
    def graph(self) -> FrameGraph:
        """Frames of all faces; chains start in the middle of every piece."""
        count, pairs = (
            len(self.topology.faces),
            self._rows.topology.hinge_faces[self._crossing].astype(np.int64),
        )
        known = np.zeros(count, dtype=bool)
        known[_middles(count, pairs)] = True
        return FrameGraph(count, pairs, np.maximum(self.shell.bend[self._crossing], THIN), known, 1.0)

    @cached_property
    def hinges(self) -> Hinges:
        """The hinges of the mesh."""
        topology = self._rows.topology
        return Hinges(topology.faces, topology.hinges, topology.hinge_faces)

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.graph, self.shell

    def fit(self, wanted: Wanted, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Implement `EdgeProjection.fit`; of the settings only the tolerance is used."""
        topology, edge_ids, hinge_ids = self._rows
        lengths = sound_lengths(wanted.lengths, wanted.weights)[edge_ids]
        angles = wanted.angles[hinge_ids]
        flat = flat_triangles(lengths[topology.face_edges])
        turns = self.hinges.turns(flat, angles)[self._crossing]
        known = np.tile([1.0, 0.0, 0.0, 0.0], (int(np.count_nonzero(self.graph.known)), 1))
        frames, x = self.graph.averaged(self.graph.chained(turns, known), turns, ROUNDS), self.pieces.shapes
        best = Relaxed(x, np.inf)
        steps = 0
        for _ in range(CYCLES):
            start = self.shell.integrated(turned_sides(frames, flat), NOTHING, best.points)
            points, steps = self.shell.relaxed(start, lengths, angles, STEPS).points, steps + STEPS
            found = Relaxed(points, self.shell.energy(points, lengths, angles))
            done = self.shell.agree(found.energy) or found.energy > (1.0 - settings.tolerance) * best.energy
            best = min(found, best, key=lambda each: each.energy)
            if done:
                break
            frames = self.graph.averaged(frames_of(best.points, topology.faces), turns, 1)
        return best.points, [ShellReport(2.0 * best.energy, steps, True)]


def _places(rows: Index, table: Index) -> Index:
    """Return the places of rows ``(n, k)`` in a table ``(n, k)`` with the same rows in another order."""
    places = np.empty(len(rows), dtype=np.int64)
    places[np.lexsort(rows.T)] = np.lexsort(table.T)
    return places


def _middles(count: int, pairs: Index) -> Index:
    """Return one node for every component connected by pairs ``(h, 2)``, in the middle of its longest path."""
    graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    component = connected(count, pairs)

    def best(distances: Float) -> Index:
        order = np.lexsort((np.arange(count), distances, component))
        return order[np.unique(component[order], return_index=True)[1]]

    def away(sources: Index) -> Float:
        return np.asarray(
            csgraph.dijkstra(graph, directed=False, indices=sources, unweighted=True, min_only=True)
        )

    one = away(best(-away(best(np.zeros(count)))))
    return best(np.maximum(one, away(best(-one))))


@dataclass(frozen=True)
class EdgeSettings:
    """How meshes are found that have nearly given lengths and angles.

    Attributes
    ----------
    projection : {"steps", "dso"}
        A fixed number of steps by constant matrices, or Gauss-Newton until it converges (Froehlich and Botsch 2011).
    volume : float
        DSO: weight of a relative change of volume against that of a length; 0 for no volume term. There are thousands
        of lengths for one volume: half way between poses of animals 10 halves its error, 100 leaves less than 0.1 %.
    shell : ShellSettings, optional
        DSO: weight of the angles, and convergence limits of Gauss-Newton.

    Raises
    ------
    SettingsError
        If a setting is out of range, or does not go with the projection.
    """

    projection: ProjectionName = "steps"
    volume: float = 0.0
    shell: ShellSettings | None = None

    def __post_init__(self) -> None:
        if self.projection not in PROJECTIONS:
            names = " or ".join(map(repr, PROJECTIONS))
            raise SettingsError(f"projection is {self.projection!r}; {names} is expected")
        if not (np.isfinite(self.volume) and self.volume >= 0):
            raise SettingsError(
                f"volume is {self.volume}; a weight of 0 (no volume term) or more is expected"
            )
        if self.volume and self.projection != "dso":
            raise SettingsError(
                f"projection {self.projection!r} has no use for volume; leave it out, or choose 'dso'"
            )


@dataclass(frozen=True, eq=False)
class EdgeSpace(PosedSpace):
    """Shapes by edge lengths and dihedral angles."""

    reference_lengths: Float  # (E,) mean lengths of all edges; their inverses weigh lengths in the fits
    settings: EdgeSettings
    name = "edge"

    @property
    def shell(self) -> ShellSettings:
        """Settings of the fits to lengths and angles."""
        return self.settings.shell or ShellSettings()

    @cached_property
    def projection(self) -> EdgeProjection:
        """The projection of lengths and angles to a mesh."""
        if self.settings.projection == "dso":
            return self.discrete
        return RelaxedShell(self.topology, self.pieces, self.reference_lengths, Relaxation().bending)

    @cached_property
    def discrete(self) -> DiscreteShell:
        """The mesh as a discrete shell, which measures volumes."""
        return DiscreteShell(self.topology, self.pieces)

    @cached_property
    def _volume_weights(self) -> Float:
        """Weights ``(p,)`` of the volumes of all pieces, 0 for sheets; empty without volume terms."""
        told = self.settings.volume > 0
        return self.settings.volume * self.discrete.volume_weights(self.reference) if told else np.zeros(0)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of lengths, angles and volumes of a shape."""
        return len(self.topology.edges), len(self.topology.hinges), len(self._volume_weights)

    @property
    def shape_dim(self) -> int:
        """Implement `PosedSpace.shape_dim`."""
        return sum(self.sizes)

    @property
    def paper_dimension(self) -> int:
        """Dimension as the paper counts it: a length and an angle for every edge, and a pose."""
        return 2 * len(self.topology.edges) + 6

    @property
    def shape_metric(self) -> Float:
        """Implement `PosedSpace.shape_metric`; a change of volume moves vertices by its ratio to the area."""
        lengths, volumes = edge_lengths(self.reference, self.topology.edges), np.zeros(0)
        if len(self._volume_weights):
            areas = self.discrete.areas(self.reference)
            volumes = np.divide(1.0, areas, out=np.zeros_like(areas), where=areas > 0)
        return np.concatenate([np.ones(len(lengths)), ANGLE * lengths[self.topology.hinge_edges], volumes])

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.projection, self._volume_weights, self.pieces.radii

    def shape_of(self, x: Float) -> Float:
        """Implement `PosedSpace.shape_of`."""
        volumes = self.discrete.volumes(x) if len(self._volume_weights) else np.zeros(0)
        lengths, angles = edge_lengths(x, self.topology.edges), dihedral_angles(x, self.topology.hinges)
        return np.concatenate([lengths, angles, volumes])

    def unwrap_shapes(self, shapes: Float, previous: Float | None) -> Float:
        """Implement `PosedSpace.unwrap_shapes`."""
        result, start = np.array(shapes), len(self.topology.edges)
        angles = slice(start, start + len(self.topology.hinges))
        before = (
            dihedral_angles(self.reference, self.topology.hinges) if previous is None else previous[angles]
        )
        result[:, angles] = unwrap_angles(result[:, angles], before)
        return result

    def rebuilt(self, shape: Float) -> Float:
        """Implement `PosedSpace.rebuilt`."""
        return self.rebuilt_with_reports(shape)[0]

    def rebuilt_with_reports(
        self, shape: Float, shell: ShellSettings | None = None
    ) -> tuple[Float, list[ShellReport]]:
        """Return the result of `rebuilt`, with optional other settings, and reports of the fits."""
        return self.projection.fit(self.wanted(shape), shell or self.shell)

    def wanted(self, shape: Float) -> Wanted:
        """Return the target lengths, angles and volumes of a shape ``(S,)``."""
        lengths, angles, volumes = np.split(shape, np.cumsum(self.sizes)[:-1])
        weights = length_weights(self.reference_lengths)
        return Wanted(lengths, weights, angles, volumes, self._volume_weights)

    def decode_for_differences(self, vectors: Float) -> Float:
        """Implement `ShapeSpace.decode_for_differences`."""
        return self.decode_with_reports(vectors, shell=self.shell.for_differences())[0]

    def decode_with_reports(
        self, vectors: Float, progress: Progress = silent, shell: ShellSettings | None = None
    ) -> tuple[Float, list[list[ShellReport]]]:
        """Decode vectors ``(T, D)`` to points ``(T, V, 3)``, and return the reports of the fits of every frame."""
        shapes, turns, centres = self.split(np.asarray(vectors, dtype=np.float64))
        points, reports = np.empty((len(shapes), self.topology.vertex_count, 3)), []
        with one_blas_thread():
            for number, shape in enumerate(shapes):
                rows, report = self.rebuilt_with_reports(shape, shell)
                points[number] = self.placed(rows, turns[number], centres[number])
                reports.append(report)
                progress(number + 1, len(shapes), "decoding frames")
        return points, reports
