r"""Fit weights of vertices to given motions of bones.

With homogeneous rest positions :math:`\tilde r_v = (r_v, 1)`, motions :math:`M_{tb}` ``(3, 4)`` and
:math:`h_{bc} = \sum_t (M_{tb} \tilde r_v - x_t) \cdot (M_{tc} \tilde r_v - x_t)`, the squared error of vertex v is

.. math:: \sum_t \Bigl| \sum_b w_b M_{tb} \tilde r_v - x_t \Bigr|^2 = w^T h\, w
          \quad \text{where} \quad \sum_b w_b = 1.

It is minimised under :math:`w \ge 0` by an active set (Lawson and Hanson 1974). Where more than four bones are left,
the one of least loss is removed, one after the other, and the rest is fitted again; Le and Deng (2012) keep the four of
largest weight. Candidates are the twelve bones that come nearest alone, and those that the vertex has. h needs only
sums over the frames

.. math:: Q_{bc} = \sum_t M_{tb}^T M_{tc}, \quad g_b = \sum_t M_{tb}^T x_t, \quad s = \sum_t |x_t|^2, \qquad
          h_{bc} = \tilde r^T Q_{bc} \tilde r - (g_b + g_c) \cdot \tilde r + s .

Given weights, the rest position that minimises the same error solves three equations with the same sums.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from mixseq.arrays import Float, Index

_AT_ONCE = 1 << 21  # entries of sums over the frames in memory at once


@dataclass(frozen=True, eq=False)
class Binding:
    """Rest positions, and bones and weights of vertices."""

    rest: Float  # (V, 3) rest positions
    influences: Index  # (V, 4) bones
    weights: Float  # (V, 4) their weights
    errors: Float  # (V,) squared errors, summed over the frames, plus the cost of the weights
    # (V, B) cost of a weight of one, added to the squared errors; None for no costs.
    costs: Float | None = None

    def matrix(self, bones: int) -> sparse.csr_array:
        r"""Return the rows :math:`w_{vb} \tilde r_v` of all vertices as a matrix ``(V, 4 B)``."""
        homogeneous = np.concatenate([self.rest, np.ones((len(self.rest), 1))], axis=1)
        values = self.weights[:, :, None] * homogeneous[:, None]
        columns = 4 * self.influences[:, :, None] + np.arange(4)
        ends = np.arange(len(self.rest) + 1) * values[0].size
        return sparse.csr_array((values.reshape(-1), columns.reshape(-1), ends), (len(self.rest), 4 * bones))


def bind(tracks: Float, motions: Float, start: Binding, free_rest: bool = True) -> Binding:
    """Fit weights, and rest positions with them: tracks ``(V, 3T)``; motions ``(B, 4, 3T)``."""
    from mixseq.rigging.weight_kernels import fit_vertices

    bones, frames = len(motions), motions.shape[2] // 3
    flat = motions.reshape(4 * bones, -1)
    products = (flat @ flat.T).reshape(bones, 4, bones, 4).swapaxes(1, 2).copy()
    bound = replace(
        start,
        rest=start.rest.copy(),
        influences=start.influences.copy(),
        weights=start.weights.copy(),
        errors=np.empty(len(tracks)),
    )
    size = max(1, _AT_ONCE // len(flat))
    for first in range(0, len(tracks), size):
        some = slice(first, first + size)
        seen = (tracks[some] @ flat.T).reshape(-1, bones, 4)
        if start.costs is not None:
            seen[..., 3] -= start.costs[some] / 2  # h is c_b / 2 + c_c / 2 more, and w^T h w is w^T c more
        fit_vertices(
            bound.rest[some],
            np.einsum("vi,vi->v", tracks[some], tracks[some]),
            products,
            seen,
            frames,
            free_rest,
            bound.influences[some],
            bound.weights[some],
            bound.errors[some],
        )
    return bound
