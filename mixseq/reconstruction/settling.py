r"""Settling: parts and joints of the free placement give way to each other until lengths and angles fit best.

Registered pieces do not quite meet, and stitching leaves the misfit in the narrow strip where they overlap. So the
last step is ours: minimise

.. math:: \sum_e w_e^2 (l_e - l_e^*)^2 + \sum_h w_h^2\, \mathrm{wrap}(\theta_h - \theta_h^*)^2

over the free vertices of all joints *and* a rigid motion of every part (rotation :math:`\omega` about its centre c,
translation u: :math:`x \to e^{[\omega]} (x - c) + c + u`), with all edges and hinges that do not lie within one part.
It is `mixseq.reconstruction.shells`, restricted to motions that leave parts rigid. The residuals' derivatives by a
motion follow from those by the vertices, :math:`g_v`: by u they are the sum of the :math:`g_v` of the part, by
:math:`\omega` the sum of :math:`(x_v - c) \times g_v`. A part adds two triples of unknowns to those of the free
vertices, so that a step of Gauss-Newton is one sparse system, hardly larger than that of the joints alone. The first
part of every group stays where it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.lengths_angles import dihedral_gradients, length_gradients
from mixseq.geometry.rotations import matrices
from mixseq.reconstruction.block_pattern import BlockPattern
from mixseq.reconstruction.equations import Equations
from mixseq.reconstruction.gauss_newton import DampedStep, ShellReport, ShellSettings, damped, minimise
from mixseq.reconstruction.settling_kernels import add_motions
from mixseq.reconstruction.shell_kernels import shell_equations, shell_residuals
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_NO_PLACES, _NO_WEIGHTS = np.zeros((0, 3)), np.zeros(0)


@dataclass(frozen=True, eq=False)
class Settling:
    """What moves when pieces settle, and which lengths and angles change by it.

    Attributes
    ----------
    topology : Topology
        Connectivity of the mesh.
    parts : tuple of (V_i,) int64
        Vertices of the parts.
    staying : (g,) int64
        Parts that do not move.
    edge_ids, hinge_ids : (e',), (h',) int64
        Edges and hinges whose lengths and angles are wanted. Those that lie within one part do not change.
    """

    topology: Topology
    parts: tuple[Index, ...]
    staying: Index
    edge_ids: Index
    hinge_ids: Index

    @cached_property
    def holder(self) -> Index:
        """The part ``(V,)`` that alone holds a vertex, -1 where none or several do: such vertices are free."""
        count = np.zeros(self.topology.vertex_count, dtype=np.int64)
        holder = np.full(self.topology.vertex_count, -1, dtype=np.int64)
        for number, part in enumerate(self.parts):
            count[part] += 1
            holder[part] = number
        return np.where(count == 1, holder, -1)

    @cached_property
    def free(self) -> Index:
        """Vertices with an edge or hinge that no part holds alone."""
        used = np.zeros(self.topology.vertex_count, dtype=bool)
        used[self.topology.edges[self.edge_ids]] = used[self.topology.hinges[self.hinge_ids]] = True
        return np.flatnonzero(used & (self.holder < 0))

    @cached_property
    def moving(self) -> Index:
        """Parts ``(m,)`` that move: those with an edge or a hinge to something else, but for those that stay."""
        vertices = self.topology.edges[self.edge_ids], self.topology.hinges[self.hinge_ids]
        touched = np.unique(np.concatenate([self.holder[each].reshape(-1) for each in vertices]))
        return np.setdiff1d(touched[touched >= 0], self.staying)

    @cached_property
    def place(self) -> Index:
        """Place ``(V,)`` of every vertex's part among those that move, -1 for all other vertices."""
        place = np.full(len(self.parts) + 1, -1, dtype=np.int64)
        place[self.moving] = np.arange(len(self.moving))
        return place[self.holder]  # the last one is nobody's

    @cached_property
    def blocks(self) -> Index:
        """Triples of unknowns ``(V, 2)`` that move a vertex: its own, or rotation and translation; -1 for none."""
        count = len(self.free)
        blocks = np.where(self.place[:, None] < 0, -1, count + 2 * self.place[:, None] + np.arange(2))
        blocks[self.free, 0] = np.arange(count)
        return blocks

    @cached_property
    def equations(self) -> Equations:
        """The system of a step: free vertices, then two triples for every part that moves."""
        edges, hinges = self.topology.edges[self.edge_ids], self.topology.hinges[self.hinge_ids]
        tables = [self.blocks[edges].reshape(len(edges), 4), self.blocks[hinges].reshape(len(hinges), 8)]
        pairs = [np.stack(np.broadcast_arrays(t[:, :, None], t[:, None]), axis=-1) for t in tables]
        pattern = BlockPattern.of(
            len(self.free) + 2 * len(self.moving), np.concatenate([each.reshape(-1, 2) for each in pairs])
        )
        number = np.where(self.place < 0, self.blocks[:, 0], -1)
        p, o = np.tril_indices(4, -1)
        return Equations(
            edges=np.ascontiguousarray(edges),
            hinges=np.ascontiguousarray(hinges),
            free=self.free,
            number=number,
            pattern=pattern,
            edge_blocks=pattern.block(*number[edges].T),
            hinge_blocks=np.ascontiguousarray(pattern.block(number[hinges[:, p]], number[hinges[:, o]])),
        )

    @cached_property
    def borders(self) -> tuple[Border, Border]:
        """The edges and the hinges that know a moving part."""
        rows = self.equations
        return Border.of(rows.edges, self), Border.of(rows.hinges, self)

    @cached_property
    def members(self) -> Index:
        """Vertices of the moving parts."""
        return np.flatnonzero(self.place >= 0)

    def prepare(self) -> None:
        """Find the pattern of the system."""
        self.equations.pattern.analysis, self.borders, self.members  # noqa: B018 - cached properties

    def centres(self, x: Float) -> Float:
        """Centres ``(m, 3)`` of the moving parts."""
        place = self.place[self.members]
        sums = [np.bincount(place, column, len(self.moving)) for column in x[self.members].T]
        return np.stack(sums, axis=1) / np.bincount(place, minlength=len(self.moving))[:, None]

    def moved(self, x: Float, free: Float, motions: Float) -> Float:
        """Move free vertices by ``(f, 3)``, parts by rotation vectors and translations ``(m, 6)``."""
        result = x.copy()
        result[self.free] += free
        if len(self.moving):
            place, centres = self.place[self.members], self.centres(x)
            turned = np.einsum(
                "nij,nj->ni", matrices(motions[:, :3])[place], x[self.members] - centres[place]
            )
            result[self.members] = turned + (centres + motions[:, 3:])[place]
        return result


@dataclass(frozen=True, eq=False)
class SettlingProblem:
    """What to fit: lengths ``(e',)`` and their weights, angles ``(h',)`` and their weight, of a `Settling`'s rows."""

    settling: Settling
    lengths: Float
    angles: Float
    length_weights: Float
    bending: float

    def measured(self, x: Float) -> tuple[Float, float]:
        """Weighted residuals ``(e' + h',)`` at points ``(V, 3)``, and the sum of their squares."""
        rows = self.settling.equations
        residuals = np.empty(len(rows.edges) + len(rows.hinges))
        energy = shell_residuals(
            x,
            rows.edges,
            rows.hinges,
            self.lengths,
            self.angles,
            self.length_weights,
            self.bending,
            rows.free,
            _NO_PLACES,
            _NO_WEIGHTS,
            residuals,
        )
        return residuals, float(energy)

    def normal_equations(self, x: Float, residuals: Float) -> tuple[Float, Float]:
        """Values ``(N,)`` of ``J^T J`` in the pattern, and the gradient ``J^T r`` ``(3f + 6m,)``."""
        settling, rows = self.settling, self.settling.equations
        values, gradient = np.empty(len(rows.pattern.rows)), np.empty(3 * rows.pattern.count)
        shell_equations(
            x,
            rows.edges,
            rows.hinges,
            self.length_weights,
            self.bending,
            _NO_WEIGHTS,
            residuals,
            rows.number,
            rows.edge_blocks,
            rows.hinge_blocks,
            rows.pattern.places,
            values,
            gradient,
        )
        edges, hinges = settling.borders
        stretch = length_gradients(x, edges.vertices) * self.length_weights[edges.rows, None]
        by_vertices = (
            np.stack([-stretch, stretch], axis=1),
            self.bending * dihedral_gradients(x, hinges.vertices),
        )
        centres = settling.centres(x)
        for border, by_vertex, first in zip(settling.borders, by_vertices, (0, len(rows.edges)), strict=True):
            place = settling.place[border.vertices]
            moves = (place >= 0)[:, :, None]
            arms = x[border.vertices] - centres[np.maximum(place, 0)]
            by_block = np.stack([np.where(moves, np.cross(arms, by_vertex), by_vertex), by_vertex], axis=2)
            add_motions(
                border.blocks,
                border.pairs,
                by_block.reshape(len(place), 2 * by_block.shape[1], 3),
                residuals[first + border.rows],
                len(settling.free),
                rows.pattern.places,
                values,
                gradient,
            )
        return values, gradient

    def linearised(self, x: Float, residuals: Float) -> tuple[Float, DampedStep]:
        """Implement `LeastSquares.linearised`."""
        pattern = self.settling.equations.pattern
        values, gradient = self.normal_equations(x, residuals)
        with_damping = damped(pattern, values)
        return gradient, lambda damping: -pattern.analysis.factor(with_damping(damping)).solve(gradient)

    def moved(self, x: Float, step: Float) -> Float:
        """Implement `LeastSquares.moved`."""
        free = 3 * len(self.settling.free)
        return self.settling.moved(x, step[:free].reshape(-1, 3), step[free:].reshape(-1, 6))


@dataclass(frozen=True, eq=False)
class Border:
    """Edges or hinges with a vertex of a moving part.

    Attributes
    ----------
    rows : (n,) int64
        Which of all they are.
    vertices : (n, k) int64
        Their vertices.
    blocks : (n, 2k) int64
        Triples of unknowns that move these, two for every vertex, -1 for none.
    pairs : (n, 2k, 2k) int64
        Block of the pattern that couples two of them, -1 for none.
    """

    rows: Index
    vertices: Index
    blocks: Index
    pairs: Index

    @classmethod
    def of(cls, vertices: Index, settling: Settling) -> Border:
        """Find those among edges ``(e', 2)`` or hinges ``(h', 4)``."""
        rows = np.flatnonzero((settling.place[vertices] >= 0).any(axis=1))
        blocks = np.ascontiguousarray(
            settling.blocks[vertices[rows]].reshape(len(rows), 2 * vertices.shape[1])
        )
        pairs = settling.equations.pattern.block(*np.broadcast_arrays(blocks[:, :, None], blocks[:, None]))
        return cls(rows, vertices[rows], blocks, np.ascontiguousarray(pairs))


def settle(problem: SettlingProblem, start: Float, settings: ShellSettings) -> tuple[Float, ShellReport]:
    """Let parts and joints give way to each other.

    Parameters
    ----------
    problem : SettlingProblem
        What to fit.
    start : (V, 3) float64
        The mesh, its parts rigid already.
    settings : ShellSettings
        When to stop; rotations, in radians, count as translations do, no part being larger than a diagonal.

    Returns
    -------
    points : (V, 3) float64
    report : ShellReport

    Raises
    ------
    ReconstructionError
        If the start, or a length or an angle, is not finite.
    """
    return minimise(problem, start, settings)
