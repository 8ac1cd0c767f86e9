r"""Vertices from their differences: the sparse Poisson systems at the end of linear reconstructions.

Given the sides ``ij`` of a mesh, the vertices are

.. math:: \min_x \sum_{ij} w_{ij} \, | x_j - x_i - s_{ij} |^2 ,

which is ``L x = B^T W s`` with the incidence matrix B of the sides and the Laplacian ``L = B^T W B``. The first vertex
of every connected component is the origin. L depends on connectivity and weights only: it is factored once.

Sides of triangles weighted by half the cotangent of the angle opposite to each make this the Poisson equation
:math:`\min_x \sum_f A_f | \nabla x - J_f |^2` of face gradients J with areas A (Botsch et al. 2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, Index
from mixseq.errors import SettingsError
from mixseq.pickling import PickledWithoutCaches
from mixseq.shells.solvers import Factor, factorise


@dataclass(frozen=True, eq=False)
class Integration(PickledWithoutCaches):
    """The Poisson system of given sides."""

    # (S, 2) pairs i, j of vertices; a pair may be there more than once, or name one vertex twice.
    sides: Index
    # (S,) weights w. Single ones may be negative, if L is positive semidefinite all the same (obtuse triangles).
    weights: Float
    count: int  # number n of vertices

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return (self.factor,) if self.solved.size else ()

    @cached_property
    def incidence(self) -> sparse.csr_array:
        """The matrix B ``(S, n)``: -1 at a side's first vertex, +1 at its second."""
        number = len(self.sides)
        value = np.tile([-1.0, 1.0], number)
        places = (np.repeat(np.arange(number), 2), self.sides.reshape(-1))
        return sparse.coo_array((value, places), shape=(number, self.count)).tocsr()

    @cached_property
    def weighted(self) -> sparse.csr_array:
        """The matrix ``B^T W`` ``(n, S)``."""
        return sparse.csr_array(self.incidence.T @ sparse.diags_array(self.weights))

    @cached_property
    def solved(self) -> Index:
        """Unknown vertices: all but the first of every component."""
        i, j = self.sides.T
        graph = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(self.count, self.count))
        component = csgraph.connected_components(graph, directed=False)[1]
        return np.setdiff1d(np.arange(self.count), np.unique(component, return_index=True)[1])

    @cached_property
    def factor(self) -> Factor:
        """Factor of the Laplacian of the unknown vertices."""
        laplacian = sparse.csr_array(self.weighted @ self.incidence)
        return factorise(laplacian[self.solved][:, self.solved])

    def vertices(self, differences: Float) -> Float:
        """Solve for the vertices ``(n, 3)`` with sides ``x_j - x_i`` closest to differences ``(S, 3)``."""
        if differences.shape != (len(self.sides), 3):
            raise SettingsError(
                f"differences have shape {differences.shape}; one for each side is expected, ({len(self.sides)}, 3)"
            )
        result = np.zeros((self.count, 3))
        if self.solved.size:
            result[self.solved] = self.factor.solve((self.weighted @ differences)[self.solved])
        return result
