r"""How much every vertex follows the parts around it: shares that are smooth over the mesh and explain the motion.

A vertex may follow the parts of faces near it. With the rigid motions :math:`M_{ti}` of part i from the reference
frame to frame t, shares w explain frames as far as the following is small,

.. math:: \sum_t \Bigl| \sum_i w_i\, M_{ti}(\bar x_v) - x_{tv} \Bigr|^2 + \mu_v\, |w - \bar w|^2,
   \qquad w_i \ge 0, \quad \sum_i w_i = 1 .

where :math:`\bar w` is the mean of the neighbours' shares, and :math:`\mu` the weight `SMOOTH` times how far the
motions of the parts are apart there: only the ratio of the two counts. Vertices are visited in turn, several times;
which parts a vertex may follow, and its first shares, are those of its faces spread over about `RINGS` rings of
edges, by two steps of implicit diffusion, :math:`(I + r^2 L / 4)\, u = v`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse

from mixseq.arrays import Float, FloatArray, Index, Mask
from mixseq.compiled import compiled
from mixseq.geometry.rotations import turned
from mixseq.segmentation.joints import Decomposition
from mixseq.shells.solvers import factorise
from mixseq.spaces.registered import registered
from mixseq.topology import Topology

EXCHANGES = 4


@compiled
def compare(
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
    """Add to sums how far the motions of parts take vertices from where they are in a frame, and from each other.

    Parameters
    ----------
    some : (n,) int64
        Vertices that are looked at.
    parts, shares : (V, k)
        Parts that every vertex may follow, -1 for none, and their shares.
    turns, shifts : (p, 3, 3), (p, 3) float64
        Motions of the parts from the reference frame, in diagonals.
    reference, x : (V, 3) float64
        The reference frame, and the frame.
    products, apart : (n, k, k), (n,) float64
        Changed in place: sums of products of errors, and of squared distances from their mean.
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
def smooth_and_fit(
    some: Index,
    parts: Index,
    shares: Float,
    products: Float,
    strengths: Float,
    starts: Index,
    others: Index,
    sweeps: int,
) -> None:
    """Find shares ``(V, k)`` that are near the means of neighbours' shares and explain frames; changed in place.

    Parameters
    ----------
    some : (n,) int64
        Vertices with several parts.
    parts : (V, k) int64
        Parts that every vertex may follow, -1 for none.
    shares : (V, k) float64
        Their shares; rows add up to one.
    products, strengths : (n, k, k), (n,) float64
        Quadratic forms of what is not explained, and weights of smoothness.
    starts, others : (V + 1,), (m,) int64
        Neighbours of vertices, as rows of a sparse matrix.
    sweeps : int
        So often all vertices are visited.
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
            for _ in range(EXCHANGES):
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


RINGS = 6.0
"""How far parts are followed, in edges. Ours; chosen on half of the animations of the benchmarks, as are the others."""

MOST = 6
"""A vertex follows so many parts at most."""

LEAST = 0.01
"""Smaller shares are none."""

SMOOTH = 0.1
"""Weight of smoothness."""

NOISE = 1e-12
"""Squared distances below this, in diagonals, are rounding errors: where parts move alike, shares are smooth."""

SWEEPS = 20
"""So often vertices are visited."""

LARGE = 200_000
"""Of meshes with more vertices only those near boundaries of parts are looked at: elsewhere a part has all. Ours."""

NEAR = 48
"""So many rings of vertices about boundaries. Shares fall to a hundredth within a third of them."""

_AT_ONCE = 16  # parts that are spread at once


def fitted_shares(
    topology: Topology, decomposition: Decomposition, shapes: Float, frames: FloatArray, reference: Float
) -> sparse.csr_array:
    """Find the shares ``(V, p)`` of a mesh with p parts; rows add up to one.

    Parameters
    ----------
    topology : Topology
        Connectivity of the mesh.
    decomposition : Decomposition
        Its parts.
    shapes : (N, 3) float64
        Mean shapes of the parts.
    frames : (S, V, 3) float
        Some frames, in the unit of the shapes.
    reference : (V, 3) float64
        The reference frame.
    """
    parts, shares = _spread(topology, decomposition)
    some = np.flatnonzero(parts[:, 1] >= 0)
    if len(some):
        _, rest, rest_centres = registered(shapes, decomposition.parts, reference)
        products, apart = np.zeros((len(some), MOST, MOST)), np.zeros(len(some))
        for frame in frames:
            x = frame.astype(np.float64)
            _, rotations, centres = registered(shapes, decomposition.parts, x)
            turns = rotations @ np.swapaxes(rest, 1, 2)
            shifts = centres - turned(turns, rest_centres)
            compare(some, parts, shares, turns, shifts, reference, x, products, apart)
        adjacency = topology.vertex_adjacency
        starts, others = adjacency.indptr.astype(np.int64), adjacency.indices.astype(np.int64)
        strengths = SMOOTH * apart + NOISE * len(frames)
        smooth_and_fit(some, parts, shares, products, strengths, starts, others, SWEEPS)
    shares[shares < LEAST] = 0.0
    rows, places = np.nonzero(shares)
    size = (topology.vertex_count, len(decomposition.parts))
    return _normalised(
        sparse.coo_array((shares[rows, places], (rows, parts[rows, places])), shape=size).tocsr()
    )


def _spread(topology: Topology, decomposition: Decomposition) -> tuple[Index, Float]:
    """Parts ``(V, MOST)`` near every vertex, largest shares first and -1 where there are fewer, and their shares."""
    count, vertices = len(decomposition.parts), topology.vertex_count
    labels = np.repeat(decomposition.part_of_face, 3)
    places = topology.faces.astype(np.int64).reshape(-1), labels
    at_faces = _normalised(sparse.coo_array((np.ones(len(labels)), places), shape=(vertices, count)).tocsr())
    adjacency = topology.vertex_adjacency
    degrees = np.asarray(adjacency.sum(axis=1)).reshape(-1)
    laplacian = sparse.diags_array(degrees) - adjacency
    system = sparse.csr_array(sparse.eye_array(vertices) + RINGS**2 / 4.0 * laplacian)
    near = _near_boundaries(at_faces, adjacency) if vertices > LARGE else np.ones(vertices, dtype=bool)
    spread_out = _diffusion(system, near)
    parts, shares = np.full((vertices, MOST), -1, dtype=np.int64), np.zeros((vertices, MOST))
    for start in range(0, count, _AT_ONCE):
        columns = at_faces[:, start : start + _AT_ONCE].toarray()
        spread = spread_out(columns)
        both = np.concatenate([shares, np.where(spread >= LEAST, spread, 0.0)], axis=1)
        which = np.concatenate(
            [parts, np.broadcast_to(start + np.arange(columns.shape[1]), columns.shape)], axis=1
        )
        order = np.argsort(-both, axis=1, kind="stable")[:, :MOST]
        shares, parts = np.take_along_axis(both, order, axis=1), np.take_along_axis(which, order, axis=1)
    loose = topology.unused_vertices
    shares[loose] = 0.0
    shares[loose, 0], parts[loose, 0] = 1.0, count - 1  # which are a part of their own, the last one
    parts[shares == 0.0] = -1
    return parts, shares / shares.sum(axis=1, keepdims=True)


def _diffusion(system: sparse.csr_array, near: Mask) -> Callable[[Float], Float]:
    """Return what two steps of diffusion make of columns ``(V, n)``; where it is not `near`, they stay as they are."""
    if near.all():
        factor = factorise(system)
        return lambda columns: factor.solve(factor.solve(columns))
    if not near.any():
        return lambda columns: columns
    rows = system[near]
    factor, border = factorise(sparse.csr_array(rows[:, near])), rows[:, ~near]

    def spread_out(columns: Float) -> Float:
        spread = columns.copy()
        for _ in range(2):
            spread[near] = factor.solve(spread[near] - border @ columns[~near])
        return spread

    return spread_out


def _near_boundaries(at_faces: sparse.csr_array, adjacency: sparse.csr_array) -> Mask:
    """Mark the vertices ``(V,)`` that are within `NEAR` rings of one whose faces have several parts."""
    near: Mask = np.diff(at_faces.indptr) > 1
    for _ in range(NEAR):
        near = near | (adjacency @ near.astype(np.float32) > 0)
    return near


def _normalised(matrix: sparse.csr_array) -> sparse.csr_array:
    sums = np.asarray(matrix.sum(axis=1)).reshape(-1)
    return sparse.csr_array(sparse.diags_array(1.0 / np.where(sums > 0, sums, 1.0)) @ matrix)
