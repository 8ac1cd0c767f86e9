r"""Skinning weights that are smooth over the mesh and explain the motion.

With the rigid motions :math:`M_{ti}` of part i from the reference frame to frame t, weights w of nearby parts minimise

.. math:: \sum_t \Bigl| \sum_i w_i\, M_{ti}(\bar x_v) - x_{tv} \Bigr|^2 + \mu_v\, |w - \bar w|^2,
   \qquad w_i \ge 0, \quad \sum_i w_i = 1 .

where :math:`\bar w` is the mean of the neighbours' weights, and :math:`\mu` is `SMOOTH` times the distance between the
motions of the parts there: only the ratio of the two counts. Gauss-Seidel sweeps visit the vertices in turn. Candidate
parts of a vertex, and its first weights, are those of its faces spread over about `RINGS` rings of edges, by two steps
of implicit diffusion, :math:`(I + r^2 L / 4)\, u = v`.
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
from mixseq.types import Float, FloatArray, Index

EXCHANGE_ROUNDS = 4
"""Number of rounds of exchanges between the parts of a vertex, per sweep."""


@compiled
def accumulate_errors(
    some: Index,
    parts: Index,
    shares: Float,
    turns: Float,
    shifts: Float,
    reference: Float,
    x: Float,
    products: Float,
    apart: Float,
) -> None:
    """Add the errors of part motions at vertices ``(n,)`` in a frame to sums, in place.

    Products ``(n, k, k)``: sums of products of errors. Apart ``(n,)``: sums of squared distances from their mean.
    """
    most = parts.shape[1]
    away = np.empty((most, 3))
    for row in range(len(some)):
        v = some[row]
        count = 0
        while count < most and parts[v, count] >= 0:
            part = parts[v, count]
            for i in range(3):
                place = shifts[part, i] - x[v, i]
                for j in range(3):
                    place += turns[part, i, j] * reference[v, j]
                away[count, i] = place
            count += 1
        for i in range(3):
            mean = 0.0
            for a in range(count):
                mean += shares[v, a] * away[a, i]
            for a in range(count):
                apart[row] += shares[v, a] * (away[a, i] - mean) ** 2
                for b in range(count):
                    products[row, a, b] += away[a, i] * away[b, i]


@compiled
def fit_weights(
    some: Index,
    parts: Index,
    shares: Float,
    products: Float,
    strengths: Float,
    starts: Index,
    others: Index,
    sweeps: int,
) -> None:
    """Fit skinning weights ``(V, k)`` of vertices ``(n,)``, in place, by Gauss-Seidel sweeps.

    Products ``(n, k, k)`` are quadratic forms of the error, strengths ``(n,)`` the weights of smoothness; `starts`
    ``(V + 1,)`` and `others` ``(m,)`` list neighbours as rows of a sparse matrix.
    """
    most = parts.shape[1]
    wanted = np.empty(most)
    for _ in range(sweeps):
        for row in range(len(some)):
            v = some[row]
            count = 0
            while count < most and parts[v, count] >= 0:
                wanted[count] = 0.0
                count += 1
            total = 0.0
            for place in range(starts[v], starts[v + 1]):
                u = others[place]
                for b in range(most):
                    if parts[u, b] < 0:
                        break
                    for a in range(count):
                        if parts[v, a] == parts[u, b]:
                            wanted[a] += shares[u, b]
                            total += shares[u, b]
            if total == 0.0:
                continue
            mu = strengths[row]
            for a in range(count):
                wanted[a] /= total
            # Exchanges between two parts keep the sum; each is a parabola.
            for _ in range(EXCHANGE_ROUNDS):
                for a in range(count):
                    for b in range(a):
                        slope = mu * (shares[v, a] - wanted[a] - shares[v, b] + wanted[b])
                        for c in range(count):
                            slope += (products[row, a, c] - products[row, b, c]) * shares[v, c]
                        bend = (
                            products[row, a, a] + products[row, b, b] - 2.0 * products[row, a, b] + 2.0 * mu
                        )
                        if bend > 0.0:
                            step = -slope / bend
                            step = min(max(step, -shares[v, a]), shares[v, b])
                            shares[v, a] += step
                            shares[v, b] -= step


INFLUENCE_RADIUS_RINGS = 6.0
"""Radius of influence of parts, in edges; chosen on half of the benchmark animations, as are the next constants."""

MAX_PARTS_PER_VERTEX = 6
"""Largest number of parts per vertex."""

MIN_WEIGHT = 0.01
"""Least skinning weight; smaller ones are set to zero."""

SMOOTHNESS_WEIGHT = 0.1
"""Weight of smoothness."""

MOTION_NOISE = 1e-12
"""Squared distance of motions, in diagonals, below which weights are only smooth."""

GAUSS_SEIDEL_SWEEPS = 20
"""Number of Gauss-Seidel sweeps."""

MAX_FULLY_FITTED_VERTICES = 200_000
"""Number of vertices above which only those near boundaries of parts are fitted; others follow one part."""

FITTED_BOUNDARY_RINGS = 32
"""Rings of vertices about boundaries that are fitted. Weights fall to a hundredth within half of them."""

WEIGHT_STEP = 2.0**-16
"""Rounding step of skinning weights."""

_PARTS_PER_BLOCK = 16  # parts that are spread at once


def fit_skinning_weights(
    topology: Topology, decomposition: Decomposition, shapes: Float, frames: FloatArray, reference: Float
) -> sparse.csr_array:
    """Fit skinning weights ``(V, p)``, rows adding up to one, to frames ``(S, V, 3)``; shapes ``(N, 3)``."""
    near, far, part_of_far = _split_vertices(topology, decomposition)
    graph = topology.vertex_adjacency[near][:, near]
    parts, shares = _diffuse(graph, _parts_around_vertices(topology, decomposition, near))
    some = np.flatnonzero(parts[:, 1] >= 0)
    if len(some):
        _, rest, rest_centres = register_parts(shapes, decomposition.parts, reference)
        products, apart = (
            np.zeros((len(some), MAX_PARTS_PER_VERTEX, MAX_PARTS_PER_VERTEX)),
            np.zeros(len(some)),
        )
        for frame in frames:
            x = frame.astype(np.float64)
            _, rotations, centres = register_parts(shapes, decomposition.parts, x)
            turns = rotations @ np.swapaxes(rest, 1, 2)
            shifts = centres - rotate_vectors(turns, rest_centres)
            accumulate_errors(some, parts, shares, turns, shifts, reference[near], x[near], products, apart)
        starts, others = graph.indptr.astype(np.int64), graph.indices.astype(np.int64)
        strengths = SMOOTHNESS_WEIGHT * apart + MOTION_NOISE * len(frames)
        fit_weights(some, parts, shares, products, strengths, starts, others, GAUSS_SEIDEL_SWEEPS)
    shares[shares < MIN_WEIGHT] = 0.0
    rows, places = np.nonzero(shares)
    vertices = np.concatenate([near[rows], far])
    followed = np.concatenate([parts[rows, places], part_of_far])
    values = np.concatenate([shares[rows, places], np.ones(len(far))])
    size = (topology.vertex_count, len(decomposition.parts))
    return _round_weights(
        _normalise_rows(sparse.coo_array((values, (vertices, followed)), shape=size).tocsr())
    )


def _split_vertices(topology: Topology, decomposition: Decomposition) -> tuple[Index, Index, Index]:
    """Return fitted vertices ``(n,)``, the others ``(m,)``, and the part ``(m,)`` of each of these.

    Fitted are those within `NEAR` rings of a vertex with faces of several parts; in small meshes all with faces.
    """
    labels = decomposition.part_of_face[:, None]
    part = np.full(topology.vertex_count, len(decomposition.parts) - 1)  # of no face: they are the last part
    part[topology.faces] = labels
    near = np.zeros(topology.vertex_count, dtype=bool)
    if topology.vertex_count <= MAX_FULLY_FITTED_VERTICES:
        near[topology.faces] = True
    else:
        near[topology.faces[part[topology.faces] != labels]] = True
        near = dilate_vertices(topology, near, FITTED_BOUNDARY_RINGS)
    far = np.flatnonzero(~near)
    return np.flatnonzero(near), far, part[far]


def _parts_around_vertices(topology: Topology, decomposition: Decomposition, some: Index) -> sparse.csr_array:
    """Return the shares ``(n, p)`` of parts in the faces of vertices ``(n,)``."""
    row = np.full(topology.vertex_count, -1)
    row[some] = np.arange(len(some))
    rows = row[topology.faces].reshape(-1)
    counted = rows >= 0
    places = rows[counted], np.repeat(decomposition.part_of_face, 3)[counted]
    size = (len(some), len(decomposition.parts))
    return _normalise_rows(sparse.coo_array((np.ones(len(places[0])), places), shape=size).tocsr())


def _diffuse(graph: sparse.csr_array, at_faces: sparse.csr_array) -> tuple[Index, Float]:
    """Return nearby parts ``(n, MOST)`` and their weights, largest first, -1 for none: graph ``(n, n)``."""
    vertices, count = at_faces.shape
    degrees = np.asarray(graph.sum(axis=1)).reshape(-1)
    laplacian = sparse.diags_array(degrees) - graph
    factor = factorise(
        sparse.csr_array(sparse.eye_array(vertices) + INFLUENCE_RADIUS_RINGS**2 / 4.0 * laplacian)
    )
    parts, shares = (
        np.full((vertices, MAX_PARTS_PER_VERTEX), -1, dtype=np.int64),
        np.zeros((vertices, MAX_PARTS_PER_VERTEX)),
    )
    for start in range(0, count, _PARTS_PER_BLOCK):
        columns = at_faces[:, start : start + _PARTS_PER_BLOCK].toarray()
        spread = factor.solve(factor.solve(columns))
        both = np.concatenate([shares, np.where(spread >= MIN_WEIGHT, spread, 0.0)], axis=1)
        which = np.concatenate(
            [parts, np.broadcast_to(start + np.arange(columns.shape[1]), columns.shape)], axis=1
        )
        order = np.argsort(-both, axis=1, kind="stable")[:, :MAX_PARTS_PER_VERTEX]
        shares, parts = np.take_along_axis(both, order, axis=1), np.take_along_axis(which, order, axis=1)
    parts[shares == 0.0] = -1
    return parts, shares / shares.sum(axis=1, keepdims=True)


def _normalise_rows(matrix: sparse.csr_array) -> sparse.csr_array:
    sums = np.asarray(matrix.sum(axis=1)).reshape(-1)
    return sparse.csr_array(sparse.diags_array(1.0 / np.where(sums > 0, sums, 1.0)) @ matrix)


def _round_weights(weights: sparse.csr_array) -> sparse.csr_array:
    """Round weights to `GRID`, to save bytes; the largest of each row takes the rest of one."""
    data = np.round(weights.data / WEIGHT_STEP) * WEIGHT_STEP
    starts = weights.indptr[:-1]
    largest = np.repeat(np.maximum.reduceat(weights.data, starts), np.diff(weights.indptr)) == weights.data
    rows = np.repeat(np.arange(len(starts)), np.diff(weights.indptr))
    first = np.unique(rows[largest], return_index=True)[1]
    data[np.flatnonzero(largest)[first]] += 1.0 - np.add.reduceat(data, starts)
    return sparse.csr_array((data, weights.indices, weights.indptr), shape=weights.shape)
