r"""Parts of the mesh with a basis each: near-rigid parts, merged down to a number, and refined to take fewer bytes.

Vertices that move with the same few bones need few components; all vertices together need as many as there are bones.
So the mesh is cut into parts, as in clustered principal component analysis (Sattler, Sarlette and Klein 2005, *Simple
and efficient compression of animation sequences*), all with one step.

*Merging.* Repeatedly, the two parts are merged whose union adds least to the error of the nearest rigid motions from
the first frame,

.. math:: E(S) = \min_{R_t, c_t} \sum_{t,\, v \in S} |R_t x_0(v) + c_t - x_t(v)|^2,

whether they touch or not: vertices on one bone may be in several pieces.

*Refining.* The motion y of a vertex, in the coordinates of the principal components, is taken to be normal about the
mean of the part. Rounded to steps :math:`\Delta` it takes about

.. math:: L_p(y) = \tfrac12 \log \det \Bigl(1 + \frac{C_p}{\Delta^2}\Bigr)
                   + \tfrac12 (y - m_p)^T (C_p + \Delta^2)^{-1} (y - m_p)

nats, with the mean :math:`m_p` and the covariance :math:`C_p` of the part. Vertices join the part of least length,
averaged with their neighbours, as borders cost bits, too. Then means and covariances are updated, and so on (Lloyd's
iteration).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from mixseq.compression.bitstream.spatial_basis import MOST_PARTS
from mixseq.compression.encoder.components import PrincipalComponents
from mixseq.errors import SegmentationError
from mixseq.mesh.topology import Topology
from mixseq.runtime.parallel import two_thread_executor
from mixseq.segmentation.methods import segment
from mixseq.sequence.sequence import FrameStore
from mixseq.types import Float, Index

FACES = 8
"""Faces per part, at least; smaller meshes are not cut."""

FIRST = 24
"""Number of near-rigid parts to begin with."""

FRAMES = 16
"""Number of evenly spread frames that are used."""


def vertex_parts(sequence: FrameStore, counts: tuple[int, ...]) -> dict[int, Index]:
    """Return labels ``(V,)`` of the vertices, for those of the numbers of parts that are possible, increasing."""
    header = sequence.header
    if len(header.faces) < FACES * counts[-1]:
        return {}
    frames = np.unique(np.linspace(0, len(sequence.points) - 1, FRAMES).astype(np.int64))
    points = sequence.points[frames].astype(np.float64)
    topology = Topology(header.faces, header.vertex_count)
    try:
        of_faces = segment(points, topology, parts=FIRST)
    except SegmentationError:
        return {}
    number = int(of_faces.max(initial=0)) + 1
    if number == 1 or number > MOST_PARTS:
        return {}
    votes = np.zeros((header.vertex_count, number), dtype=np.int64)
    np.add.at(votes, (header.faces.reshape(-1), np.repeat(of_faces, 3)), 1)
    labels = np.unique(votes.argmax(axis=1), return_inverse=True)[1].astype(np.int64)
    return dict(sorted(merged(points, labels, counts).items()))


def merged(points: NDArray[np.floating], labels: Index, counts: tuple[int, ...]) -> dict[int, Index]:
    """Merge parts pairwise: points ``(T, V, 3)``; labels ``(V,)``."""
    number = int(labels.max(initial=0)) + 1
    sums = _Sums.of(points, labels, number)
    own = sums.energies()
    costs = np.full((number, number), np.inf)
    for one in range(number - 1):
        others = np.arange(one + 1, number)
        costs[one, others] = sums.merged(one, others).energies() - own[one] - own[others]
    labels, alive, found = labels.copy(), np.ones(number, dtype=bool), {}
    for left in range(number, 0, -1):
        if left in counts:
            found[left] = np.unique(labels, return_inverse=True)[1].astype(np.int64)
        if left == 1:
            break
        one, other = (int(index) for index in np.unravel_index(np.argmin(costs), costs.shape))
        labels[labels == other] = one
        union = sums.merged(one, np.array([other]))
        for mine, new in zip(sums, union, strict=True):
            mine[one] = new[0]
        own[one], alive[other] = union.energies()[0], False
        costs[other], costs[:, other] = np.inf, np.inf
        others = np.flatnonzero(alive & (np.arange(number) != one))
        if len(others):
            new_costs = sums.merged(one, others).energies() - own[one] - own[others]
            costs[np.minimum(one, others), np.maximum(one, others)] = new_costs
    return found


class _Sums(NamedTuple):
    """Sums over the vertices of sets: number ``(n,)``, x_0 ``(n, 3)``, x_t ``(n, T, 3)``, products and squares."""

    sizes: Float
    first: Float
    points: Float
    products: Float
    squares: Float

    @classmethod
    def of(cls, points: NDArray[np.floating], labels: Index, number: int) -> _Sums:
        rows = []
        for part in range(number):
            x = points[:, labels == part].astype(np.float64)
            squares = len(x) * np.square(x[0]).sum() + np.square(x).sum()
            products = np.einsum("vi,tvj->tij", x[0], x)
            rows.append((float(x.shape[1]), x[0].sum(axis=0), x.sum(axis=1), products, squares))
        return cls(*(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))

    def merged(self, one: int, others: Index) -> _Sums:
        return _Sums(*(values[one] + values[others] for values in self))

    def energies(self) -> Float:
        """Errors ``(n,)`` of the nearest rigid motions, by the singular values of the products (Kabsch 1976)."""
        about = self.first[:, None, :, None] * self.points[:, :, None, :] / self.sizes[:, None, None, None]
        products = self.products - about
        values = np.linalg.svd(products, compute_uv=False)
        turned = values[..., 0] + values[..., 1] + np.sign(np.linalg.det(products)) * values[..., 2]
        means = self.points.shape[1] * np.square(self.first).sum(axis=1) + np.square(self.points).sum(
            axis=(1, 2)
        )
        return np.asarray(self.squares - means / self.sizes - 2 * turned.sum(axis=1))


ROUNDS = 5
"""Largest number of rounds in which vertices change parts."""

SMALLEST = 8
"""Smallest number of vertices of a part."""

MODES = 64
"""Largest number of components of the whole mesh that are used."""

VISIBLE = 0.1
"""Mean displacement of vertices by a component, in steps, below which it is ignored."""


def refined(components: PrincipalComponents, labels: Index, faces: NDArray[np.integer], step: float) -> Index:
    """Return better labels ``(V,)`` for the same number of parts of a mesh: faces ``(F, 3)``."""
    number, vertices = int(labels.max()) + 1, len(labels)
    seen = np.count_nonzero(components.norms > VISIBLE * step * np.sqrt(vertices))
    motion = components.vectors[: min(max(seen, 1), MODES), 0]
    mean_of_neighbours = _mean_of_neighbours(faces, vertices)
    squares = np.einsum("rv,rv->v", motion, motion)
    for _ in range(ROUNDS):
        found = two_thread_executor()(_lengths, _Motion(motion, squares, labels, step), range(number))
        lengths = np.stack(list(found), axis=1)
        lengths = (lengths + mean_of_neighbours @ lengths) / 2
        changed = lengths.argmin(axis=1)
        sizes = np.bincount(changed, minlength=number)
        if sizes.min() < SMALLEST or np.array_equal(changed, labels):
            break
        labels = changed
    return labels


class _Motion(NamedTuple):
    """Motion ``(R, V)`` of the vertices, its squares ``(V,)``, the parts they are in ``(V,)``, and the step."""

    of_vertices: Float
    squares: Float
    labels: Index
    step: float


def _lengths(motion: _Motion, part: int) -> Float:
    """Return the approximate code length in nats of every vertex's motion in a part."""
    everywhere, unit = motion.of_vertices, motion.step**2
    own = everywhere[:, motion.labels == part]
    mean = own.mean(axis=1)
    covariance = own @ own.T / own.shape[1] - np.outer(mean, mean)
    values, directions = linalg.eigh(covariance, subset_by_value=(unit, np.inf), check_finite=False)
    # All other directions are taken to have rounding errors only.
    scores = directions.T @ everywhere - (directions.T @ mean)[:, None]
    squares = motion.squares - 2 * (mean @ everywhere) + mean @ mean
    explained = (1 - unit / (values + unit)) @ np.square(scores, out=scores)
    return np.asarray(((squares - explained) / unit + np.log1p(values / unit).sum()) / 2)


def _mean_of_neighbours(faces: NDArray[np.integer], vertices: int) -> sparse.csr_array:
    corners = np.roll(faces, 1, axis=1)
    rows, columns = np.append(faces, corners), np.append(corners, faces)
    beside = sparse.coo_array((np.ones(len(rows)), (rows, columns)), (vertices, vertices)).tocsr()
    sizes = np.maximum(beside.sum(axis=1), 1.0)
    return sparse.csr_array(sparse.diags_array(1 / sizes) @ beside)
