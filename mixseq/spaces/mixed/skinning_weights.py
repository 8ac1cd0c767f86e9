r"""Skinning weights that are smooth over the mesh and explain the motion.

With the rigid motions :math:`M_{ti}` of part i from the reference frame to frame t, weights w of nearby parts minimise

.. math:: \sum_t \Bigl| \sum_i w_i\, M_{ti}(\bar x_v) - x_{tv} \Bigr|^2 + \mu_v\, |w - \bar w|^2,
   \qquad w_i \ge 0, \quad \sum_i w_i = 1 .

Here :math:`\bar w` is the mean of the neighbours' weights, and :math:`\mu_v` is `SMOOTHNESS_WEIGHT` times the squared
distance of the part motions at the vertex from their mean. Gauss-Seidel sweeps visit the vertices in turn. Candidate
parts of a vertex, and initial weights, come from nearby faces, diffused over about `INFLUENCE_RINGS` rings of edges by
two implicit steps, :math:`(I + r^2 L / 4)\, u = v`.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from mixseq.mesh.rotations import rotate_vectors
from mixseq.mesh.topology import Topology, dilate_vertices
from mixseq.runtime.jit import compiled
from mixseq.segmentation.joints import Decomposition
from mixseq.shells.solvers import factorise
from mixseq.spaces.pieces import register_parts
from mixseq.types import Float, FloatArray, Index, Int32, index_mask

EXCHANGE_ROUNDS = 4  # number of rounds of exchanges between the parts of a vertex in a sweep


@compiled
def fit_weights(
    vertex_ids: Index,
    parts: Index,
    weights: Float,
    products: Float,
    smoothness: Float,
    starts: Int32,
    neighbours: Int32,
    sweeps: int,
) -> None:
    """Fit skinning weights ``(V, k)`` of vertices ``(n,)``, in place, by Gauss-Seidel sweeps.

    Products ``(n, k, k)`` are the quadratic forms of the errors, smoothness ``(n,)`` contains smoothness weights;
    starts ``(V + 1,)`` index the neighbours ``(m,)`` of vertices.
    """
    max_parts = parts.shape[1]
    mean = np.empty(max_parts)
    for _ in range(sweeps):
        for k in range(len(vertex_ids)):
            v = vertex_ids[k]
            count = 0
            while count < max_parts and parts[v, count] >= 0:
                mean[count] = 0.0
                count += 1
            total = 0.0
            for n in range(starts[v], starts[v + 1]):
                u = neighbours[n]
                for b in range(max_parts):
                    if parts[u, b] < 0:
                        break
                    for a in range(count):
                        if parts[v, a] == parts[u, b]:
                            mean[a] += weights[u, b]
                            total += weights[u, b]
            if total == 0.0:
                continue
            mu = smoothness[k]
            for a in range(count):
                mean[a] /= total
            # Exchanges between two parts preserve the sum; the energy is a quadratic function of the exchange.
            for _ in range(EXCHANGE_ROUNDS):
                for a in range(count):
                    for b in range(a):
                        gradient = mu * (weights[v, a] - mean[a] - weights[v, b] + mean[b])
                        for c in range(count):
                            gradient += (products[k, a, c] - products[k, b, c]) * weights[v, c]
                        curvature = products[k, a, a] + products[k, b, b] - 2.0 * products[k, a, b] + 2.0 * mu
                        if curvature > 0.0:
                            step = -gradient / curvature
                            step = min(max(step, -weights[v, a]), weights[v, b])
                            weights[v, a] += step
                            weights[v, b] -= step


@compiled
def add_motion_errors(
    turns: Float,
    shifts: Float,
    rest: Float,
    posed: Float,
    parts: Index,
    weights: Float,
    products: Float,
    variances: Float,
) -> None:
    """Add the errors of a frame ``(n, 3)`` by the motions of parts ``(p, 3, 3), (p, 3)`` from rest ``(n, 3)``.

    Products ``(n, k, k)`` of errors are those of `fit_weights`; variances ``(n,)`` are weighted, as are their means.
    """
    errors, mean = np.empty((parts.shape[1], 3)), np.empty(3)
    for v in range(len(parts)):
        count = 0
        mean[:] = 0.0
        while count < parts.shape[1] and parts[v, count] >= 0:
            part = parts[v, count]
            for i in range(3):
                moved = turns[part, i, 0] * rest[v, 0] + turns[part, i, 1] * rest[v, 1] + turns[part, i, 2] * rest[v, 2]
                errors[count, i] = moved + shifts[part, i] - posed[v, i]
                mean[i] += weights[v, count] * errors[count, i]
            count += 1
        for a in range(count):
            for i in range(3):
                variances[v] += weights[v, a] * (errors[a, i] - mean[i]) ** 2
            for b in range(count):
                for i in range(3):
                    products[v, a, b] += errors[a, i] * errors[b, i]


INFLUENCE_RINGS = 6.0
"""Radius of influence of parts in rings of edges; chosen empirically, as are the next constants (docs/between.md)."""

MAX_PARTS_PER_VERTEX = 6  # largest number of parts that a vertex is skinned to
MIN_WEIGHT = 0.01  # least skinning weight; smaller weights are set to zero
SMOOTHNESS_WEIGHT = 0.1  # weight of smoothness relative to the squared distance of part motions
MOTION_NOISE = 1e-12  # squared distance of part motions, in squared diagonals, below which smoothness decides
GAUSS_SEIDEL_SWEEPS = 20  # number of Gauss-Seidel sweeps
MAX_FULLY_FITTED_VERTICES = 200_000  # largest mesh with all vertices fitted; others are near part boundaries
FITTED_BOUNDARY_RINGS = 32  # rings of fitted vertices; weights fall to a hundredth within half of them
WEIGHT_STEP = 2.0**-16  # rounding step of skinning weights
_PARTS_PER_BLOCK = 16  # parts that are diffused together


def fit_skinning_weights(
    topology: Topology, decomposition: Decomposition, shapes: Float, frames: FloatArray, scale: float, reference: Float
) -> sparse.csr_array:
    """Fit skinning weights ``(V, p)``, rows adding up to one, to frames ``(S, V, 3)`` / scale; shapes ``(N, 3)``."""
    fitted, part_of_vertex = _split_vertices(topology, decomposition)
    graph = topology.vertex_adjacency[fitted][:, fitted]
    parts, weights = _diffuse(graph, _parts_near(topology, decomposition, fitted))
    blended = np.flatnonzero(parts[:, 1] >= 0)
    if len(blended):
        rest_rotations, rest_centres = register_parts(shapes, decomposition.parts, reference)
        size = len(blended), MAX_PARTS_PER_VERTEX, MAX_PARTS_PER_VERTEX
        products, variances = np.zeros(size), np.zeros(len(blended))
        for frame in frames:
            x = (frame / scale).astype(np.float64)
            rotations, centres = register_parts(shapes, decomposition.parts, x)
            turns = rotations @ np.swapaxes(rest_rotations, 1, 2)
            shifts = centres - rotate_vectors(turns, rest_centres)
            positions = reference[fitted[blended]], x[fitted[blended]]
            add_motion_errors(turns, shifts, *positions, parts[blended], weights[blended], products, variances)
        smoothness = SMOOTHNESS_WEIGHT * variances + MOTION_NOISE * len(frames)
        fit_weights(blended, parts, weights, products, smoothness, graph.indptr, graph.indices, GAUSS_SEIDEL_SWEEPS)
    weights[weights < MIN_WEIGHT] = 0.0
    rows, columns = np.nonzero(weights)
    shape = len(fitted), len(decomposition.parts)
    entries = sparse.coo_array((weights[rows, columns], (rows, parts[rows, columns])), shape=shape).tocsr()
    return _with_rigid_rows(_round_weights(_normalise_rows(entries)), fitted, part_of_vertex)


def _with_rigid_rows(weights: sparse.csr_array, fitted: Index, part_of_vertex: Int32) -> sparse.csr_array:
    """Return weights ``(V, p)`` from those of fitted vertices ``(n, p)``; others have one part ``(V,)``."""
    counts = np.ones(len(part_of_vertex), dtype=np.int32)
    counts[fitted] = np.diff(weights.indptr)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    parts, is_fitted = np.repeat(part_of_vertex, counts), np.repeat(index_mask(fitted, len(counts)), counts)
    data = np.ones(len(parts))
    parts[is_fitted], data[is_fitted] = weights.indices, weights.data
    return sparse.csr_array((data, parts, starts), shape=(len(counts), weights.shape[1]))


def _split_vertices(topology: Topology, decomposition: Decomposition) -> tuple[Index, Int32]:
    """Return fitted vertices ``(n,)``, and a part ``(V,)`` of every vertex.

    Vertices near vertices with faces of several parts are fitted; in small meshes, all vertices with faces are fitted.
    """
    labels = decomposition.part_of_face[:, None]
    # Unused vertices are the last part.
    part = np.full(topology.vertex_count, len(decomposition.parts) - 1, dtype=np.int32)
    part[topology.faces] = labels
    mask = np.zeros(topology.vertex_count, dtype=bool)
    if topology.vertex_count <= MAX_FULLY_FITTED_VERTICES:
        mask[topology.faces] = True
    else:
        mask[topology.faces[part[topology.faces] != labels]] = True
        mask = dilate_vertices(topology, mask, FITTED_BOUNDARY_RINGS)
    return np.flatnonzero(mask), part


def _parts_near(topology: Topology, decomposition: Decomposition, vertex_ids: Index) -> sparse.csr_array:
    """Return the fractions ``(n, p)`` of parts among the faces of vertices ``(n,)``."""
    row_of_vertex = np.full(topology.vertex_count, -1)
    row_of_vertex[vertex_ids] = np.arange(len(vertex_ids))
    rows, columns = row_of_vertex[topology.faces].reshape(-1), np.repeat(decomposition.part_of_face, 3)
    mask, shape = rows >= 0, (len(vertex_ids), len(decomposition.parts))
    ones = np.ones(np.count_nonzero(mask))
    return _normalise_rows(sparse.coo_array((ones, (rows[mask], columns[mask])), shape=shape).tocsr())


def _diffuse(graph: sparse.csr_array, fractions: sparse.csr_array) -> tuple[Index, Float]:
    """Diffuse fractions ``(n, p)``: return nearby parts ``(n, k)``, -1 for none, and their weights, decreasing."""
    vertex_count, part_count = fractions.shape
    degrees = np.asarray(graph.sum(axis=1), dtype=np.float64).reshape(-1)
    diffusion = INFLUENCE_RINGS**2 / 4.0 * (sparse.diags_array(degrees) - graph)
    diffusion = sparse.eye_array(vertex_count) + diffusion
    factor = factorise(diffusion)
    del diffusion
    parts: Index = np.full((vertex_count, MAX_PARTS_PER_VERTEX), -1, dtype=np.int64)
    weights: Float = np.zeros(parts.shape)
    for start in range(0, part_count, _PARTS_PER_BLOCK):
        columns = fractions[:, start : start + _PARTS_PER_BLOCK].toarray()
        diffused = factor.solve(factor.solve(columns))
        new_parts = np.broadcast_to(start + np.arange(columns.shape[1]), columns.shape)
        weights = np.concatenate([weights, np.where(diffused >= MIN_WEIGHT, diffused, 0.0)], axis=1)
        parts = np.concatenate([parts, new_parts], axis=1)
        order = np.argsort(-weights, axis=1, kind="stable")[:, :MAX_PARTS_PER_VERTEX]
        weights = np.take_along_axis(weights, order, axis=1)
        parts = np.take_along_axis(parts, order, axis=1)
    parts[weights == 0.0] = -1
    return parts, weights / weights.sum(axis=1, keepdims=True)


def _normalise_rows(matrix: sparse.csr_array) -> sparse.csr_array:
    sums = np.asarray(matrix.sum(axis=1)).reshape(-1)
    return sparse.csr_array(sparse.diags_array(1.0 / np.where(sums > 0, sums, 1.0)) @ matrix)


def _round_weights(weights: sparse.csr_array) -> sparse.csr_array:
    """Round weights to `WEIGHT_STEP`, to save bytes; the largest of each row absorbs the error of the sum."""
    data = np.round(weights.data / WEIGHT_STEP) * WEIGHT_STEP
    starts = weights.indptr[:-1]
    largest = np.repeat(np.maximum.reduceat(weights.data, starts), np.diff(weights.indptr)) == weights.data
    rows = np.repeat(np.arange(len(starts)), np.diff(weights.indptr))
    first = np.unique(rows[largest], return_index=True)[1]
    data[np.flatnonzero(largest)[first]] += 1.0 - np.add.reduceat(data, starts)
    return sparse.csr_array((data, weights.indices, weights.indptr), shape=weights.shape)
