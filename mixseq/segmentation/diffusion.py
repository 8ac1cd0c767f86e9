r"""Diffusion on a surface: smoothing, and diffusion distance.

With the cotangent Laplacian L and the vertex areas M of a mesh, heat spreads as :math:`M \dot u = -L u`. One implicit
step of time :math:`r^2`,

.. math:: (M + r^2 L)\, u = M u_0,

smooths values over about the distance r. The eigenvectors :math:`L \phi_i = \lambda_i M \phi_i`,
:math:`\phi_i^T M \phi_j = \delta_{ij}`, embed the surface so that Euclidean distances are *diffusion distances*
(Coifman et al. 2005; Bronstein and Bronstein 2011), which measure how well two vertices are connected:

.. math:: d_t(v, w)^2 = \sum_{i \ge 1} e^{-2 t \lambda_i} \bigl(\phi_i(v) - \phi_i(w)\bigr)^2 .

Distances are independent of the signs of eigenvectors and of their basis where eigenvalues coincide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from mixseq.arrays import Float, FloatArray, Index
from mixseq.topology import Topology

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU


_LEAST, _MOST = 1e-2, 1e2
"""Range of an edge's cotangent weight: slivers and obtuse triangles neither cut nor weld the surface."""

_DENSE = 400
"""Number of vertices of a component below which its matrix is decomposed as a dense one."""


@dataclass(frozen=True, eq=False)
class Diffusion:
    """Diffusion on one frame of a mesh."""

    points: FloatArray
    topology: Topology

    @cached_property
    def areas(self) -> Float:
        """Area ``(V,)`` of every vertex: a third of its faces'; tiny without faces, all equal without area."""
        corners = self.points[self.topology.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        thirds = np.repeat(np.linalg.norm(normals, axis=1) / 6.0, 3)
        areas = np.bincount(self.topology.faces.reshape(-1), thirds, self.topology.vertex_count)
        return np.asarray(np.maximum(areas, 1e-6 * (float(areas.mean()) or 1.0)))

    @cached_property
    def laplacian(self) -> sparse.csc_array:
        """The positive semidefinite Laplacian ``(V, V)`` of cotangent weights."""
        start, end, opposite = (np.roll(self.topology.faces, -i, axis=1).T.reshape(-1) for i in range(3))
        u, v = self.points[start] - self.points[opposite], self.points[end] - self.points[opposite]
        height = np.linalg.norm(np.cross(u, v), axis=1)
        cotangents = np.einsum("ci,ci->c", u, v) / np.maximum(height, 1e-12)
        weights = np.zeros(len(self.topology.edges))
        np.add.at(weights, self.topology.face_edges.T.reshape(-1), 0.5 * cotangents)
        weights = np.clip(weights, _LEAST, _MOST)
        i, j = self.topology.edges.T
        count = self.topology.vertex_count
        half = sparse.coo_array((weights, (i, j)), shape=(count, count))
        adjacency = half + half.T
        return sparse.csc_array(sparse.diags_array(adjacency.sum(axis=0)) - adjacency)

    def smoothed(self, values: Float, radius: float) -> Float:
        """Smooth values ``(V,)`` over about a radius; their mean over the surface is kept."""
        if radius == 0.0:
            return values.copy()
        system = sparse.diags_array(self.areas) + radius**2 * self.laplacian
        return np.asarray(_factored(system).solve(self.areas * values), dtype=np.float64)

    def embedding(self, time: float, count: int) -> Float:
        """Coordinates ``(V, count)`` with diffusion distances within each component; padded with zeros if small."""
        result = np.zeros((self.topology.vertex_count, count))
        for component, values, vectors in self._spectra(count):
            result[component, : len(values)] = vectors * np.exp(-time * values)
        return result

    def heat_kernel(self, times: Float, count: int) -> Float:
        """Return the heat ``(V, n)`` left at its source after times ``(n,)``, less the constant part."""
        result = np.zeros((self.topology.vertex_count, len(times)))
        for component, values, vectors in self._spectra(count):
            result[component] = vectors**2 @ np.exp(-2 * np.outer(values, times))
        return result

    def _spectra(self, count: int) -> Iterator[tuple[Index, Float, Float]]:
        """Yield vertices ``(n,)``, lowest eigenvalues ``(k,)``, and eigenvectors ``(n, k)`` of every component."""
        roots = 1.0 / np.sqrt(self.areas)
        scaled = sparse.csr_array(self.laplacian.multiply(roots[:, None]).multiply(roots[None, :]))
        number = self.topology.component_of_vertex
        order, ends = np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))
        blocks = scaled[order][:, order]  # on its diagonal there is one for every component
        for start, end in zip(np.append(0, ends[:-1]), ends, strict=True):
            component = order[start:end]
            values, vectors = _lowest(blocks[start:end, start:end], min(count, len(component) - 1))
            yield component, values, vectors * roots[component, None]


def _lowest(matrix: sparse.csr_array, count: int) -> tuple[Float, Float]:
    """Return the lowest eigenvalues ``(count,)`` without the first, which is zero, and their eigenvectors."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    size = matrix.shape[0]
    if size < _DENSE or count >= size // 4:
        values, vectors = np.linalg.eigh(matrix.toarray())
        return values[1 : count + 1], vectors[:, 1 : count + 1]
    # The shift makes the matrix definite. It is small against the eigenvalues wanted, of which the mean is about
    # that of all divided by the number of vertices.
    shift = 1e-3 * float(matrix.diagonal().mean()) / size
    factor = _factored(matrix + shift * sparse.eye_array(size))
    inverse = LinearOperator((size, size), matvec=factor.solve, dtype=np.float64)
    start = np.cos(np.arange(size, dtype=np.float64))  # any, but always the same
    values, vectors = eigsh(matrix, count + 1, sigma=-shift, OPinv=inverse, v0=start, tol=1e-8)
    order = np.argsort(values, kind="stable")[1:]
    return values[order], vectors[:, order]


def _factored(matrix: sparse.sparray) -> SuperLU:
    """Factor a symmetric positive definite matrix."""
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    return splu(sparse.csc_matrix(matrix), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
