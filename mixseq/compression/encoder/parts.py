r"""Divide a mesh into parts with a basis each: merge near-rigid parts, then refine them to take fewer bytes.

A part that moves with a few bones needs few components, whereas the whole mesh needs components for every bone. So the
mesh is cut into parts, as in clustered principal component analysis (Sattler, Sarlette and Klein 2005, *Simple and
efficient compression of animation sequences*). All parts have the same quantisation step.

*Merging.* Two parts S with the least increase of the error E are merged, until the requested number of parts remains.
E is the squared error of the best rigid motions from the first frame,

.. math:: E(S) = \min_{R_t, c_t} \sum_{t,\, v \in S} |R_t x_0(v) + c_t - x_t(v)|^2,

Merged parts need not be adjacent, as the vertices of one bone may be in several pieces.

*Refining.* The motion y of a vertex, in the coordinates of the principal components, is modelled as normally
distributed about the mean of its part. If y is rounded to steps :math:`\Delta`, it takes about

.. math:: L_p(y) = \tfrac12 \log \det \Bigl(1 + \frac{C_p}{\Delta^2}\Bigr)
                   + \tfrac12 (y - m_p)^T (C_p + \Delta^2)^{-1} (y - m_p)

nats, where :math:`m_p` and :math:`C_p` are the mean and the covariance of part p. Every vertex joins the part with the
least :math:`L_p`, averaged over its neighbourhood because borders cost bits. Then means and covariances are updated
(Lloyd's iteration).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from mixseq.compression.bitstream.spatial_basis import MAX_PARTS
from mixseq.compression.encoder.components import PrincipalComponents
from mixseq.errors import SegmentationError
from mixseq.mesh.measures import element_blocks
from mixseq.mesh.polygons import label_vertices
from mixseq.mesh.topology import Topology
from mixseq.runtime.parallel import two_thread_executor
from mixseq.segmentation.methods import segment
from mixseq.sequence.sequence import FrameStore
from mixseq.types import Float, Index

MIN_FACES_PER_PART = 8
"""Smallest mean number of faces per part; a mesh with fewer faces remains one part."""

RIGID_PARTS = 24
"""Number of near-rigid parts before merging."""

SEGMENTATION_FRAMES = 16
"""Number of evenly spread frames for segmentation and merging."""


def initial_parts(sequence: FrameStore, counts: tuple[int, ...]) -> dict[int, Index]:
    """Return part labels ``(V,)`` by number of parts, for every possible number in `counts`, in increasing order."""
    header = sequence.header
    if len(header.faces) < MIN_FACES_PER_PART * counts[-1]:
        return {}
    frames = np.unique(np.linspace(0, len(sequence.points) - 1, SEGMENTATION_FRAMES).astype(np.int64))
    points = sequence.points[frames].astype(np.float64)
    topology = Topology(header.faces, header.vertex_count)
    try:
        part_of_face = segment(points, topology, parts=RIGID_PARTS)
    except SegmentationError:
        return {}
    part_count = int(part_of_face.max(initial=0)) + 1
    if part_count == 1 or part_count > MAX_PARTS:
        return {}
    labels = label_vertices(header.faces, part_of_face, header.vertex_count)
    return dict(sorted(merge_parts(points, labels, counts).items()))


def merge_parts(points: NDArray[np.floating], labels: Index, counts: tuple[int, ...]) -> dict[int, Index]:
    """Merge the parts of points ``(T, V, 3)`` pairwise; return new labels ``(V,)`` by number of parts in `counts`."""
    part_count = int(labels.max(initial=0)) + 1
    sums = _PartSums.from_labels(points, labels, part_count)
    errors = sums.rigid_errors()
    costs = np.full((part_count, part_count), np.inf)
    for part in range(part_count - 1):
        others = np.arange(part + 1, part_count)
        costs[part, others] = sums.merge(part, others).rigid_errors() - errors[part] - errors[others]
    labels, remaining_mask, labels_of_counts = labels.copy(), np.ones(part_count, dtype=bool), {}
    for count in range(part_count, 0, -1):
        if count in counts:
            labels_of_counts[count] = np.unique(labels, return_inverse=True)[1].astype(np.int64)
        if count == 1:
            break
        part, other = (int(index) for index in np.unravel_index(np.argmin(costs), costs.shape))
        labels[labels == other] = part
        union = sums.merge(part, np.array([other]))
        for values, new in zip(sums, union, strict=True):
            values[part] = new[0]
        errors[part], remaining_mask[other] = union.rigid_errors()[0], False
        costs[other], costs[:, other] = np.inf, np.inf
        others = np.flatnonzero(remaining_mask & (np.arange(part_count) != part))
        if len(others):
            new_costs = sums.merge(part, others).rigid_errors() - errors[part] - errors[others]
            costs[np.minimum(part, others), np.maximum(part, others)] = new_costs
    return labels_of_counts


class _PartSums(NamedTuple):
    """Sums over the vertices of each of n parts, from which the errors of rigid motions are computed."""

    sizes: Float  # (n,) number of vertices
    first: Float  # (n, 3) sums of x_0
    points: Float  # (n, T, 3) sums of x_t
    products: Float  # (n, T, 3, 3) sums of products of x_0 and x_t
    squares: Float  # (n,) sums of |x_0|^2 + |x_t|^2 over frames and vertices

    @classmethod
    def from_labels(cls, points: NDArray[np.floating], labels: Index, part_count: int) -> _PartSums:
        rows = []
        for part in range(part_count):
            x = points[:, labels == part].astype(np.float64)
            squares = len(x) * np.square(x[0]).sum() + np.square(x).sum()
            products = np.einsum("vi,tvj->tij", x[0], x)
            rows.append((float(x.shape[1]), x[0].sum(axis=0), x.sum(axis=1), products, squares))
        return cls(*(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))

    def merge(self, part: int, others: Index) -> _PartSums:
        """Return the sums of n unions: of one part with each of `others` ``(n,)``."""
        return _PartSums(*(values[part] + values[others] for values in self))

    def rigid_errors(self) -> Float:
        """Return the errors ``(n,)`` of the best rigid motions, by singular values of the products (Kabsch 1976)."""
        mean_products = self.first[:, None, :, None] * self.points[:, :, None, :]
        products = self.products - mean_products / self.sizes[:, None, None, None]
        values = np.linalg.svd(products, compute_uv=False)
        rotated = values[..., 0] + values[..., 1] + np.sign(np.linalg.det(products)) * values[..., 2]
        first_means = self.points.shape[1] * np.square(self.first).sum(axis=1)
        means = first_means + np.square(self.points).sum(axis=(1, 2))
        return np.asarray(self.squares - means / self.sizes - 2 * rotated.sum(axis=1))


MAX_ROUNDS = 5
"""Largest number of rounds in which vertices change parts."""

MIN_PART_VERTICES = 8
"""Smallest number of vertices in a part."""

MAX_COMPONENTS = 64
"""Largest number of components of the whole mesh that are used."""

MIN_COMPONENT_STEPS = 0.1
"""Mean displacement of vertices by a component, in steps, below which it is ignored."""


def refine_parts(components: PrincipalComponents, labels: Index, faces: NDArray[np.integer], step: float) -> Index:
    """Move vertices of a mesh with faces ``(F, 3)`` between parts to save bytes; return the new labels ``(V,)``."""
    part_count, vertex_count = int(labels.max()) + 1, len(labels)
    min_norm = MIN_COMPONENT_STEPS * step * np.sqrt(vertex_count)
    rank = np.count_nonzero(components.norms > min_norm)
    motion = components.vectors[: min(max(rank, 1), MAX_COMPONENTS), 0]
    neighbour_mean = _neighbour_mean_matrix(faces, vertex_count)
    squares = np.einsum("rv,rv->v", motion, motion)
    lengths = np.empty((vertex_count, part_count))
    for _ in range(MAX_ROUNDS):
        work = two_thread_executor()(_code_lengths, (motion, squares, labels, step), range(part_count))
        for part, of_part in enumerate(work):
            lengths[:, part] = of_part
        refined = np.empty_like(labels)
        for rows in element_blocks(vertex_count, part_count):
            refined[rows] = ((lengths[rows] + neighbour_mean[rows] @ lengths) / 2).argmin(axis=1)
        sizes = np.bincount(refined, minlength=part_count)
        if sizes.min() < MIN_PART_VERTICES or np.array_equal(refined, labels):
            break
        labels = refined
    return labels


def _code_lengths(shared: tuple[Float, Float, Index, float], part: int) -> Float:
    """Return the approximate code length ``(V,)`` in nats that the motion of every vertex would have in a part.

    `shared` has the motion ``(R, V)`` of the vertices, its squares ``(V,)``, the part labels ``(V,)``, and the step.
    """
    motion, squares, labels, step = shared
    own, unit = motion[:, labels == part], step**2
    mean = own.mean(axis=1)
    covariance = own @ own.T / own.shape[1] - np.outer(mean, mean)
    values, directions = linalg.eigh(covariance, subset_by_value=(unit, np.inf), check_finite=False)
    # Directions of smaller variance are assumed to have rounding errors only.
    lengths, constant = np.empty(len(squares)), np.log1p(values / unit).sum()
    for block in element_blocks(len(squares), len(motion)):
        scores = directions.T @ motion[:, block] - (directions.T @ mean)[:, None]
        distances = squares[block] - 2 * (mean @ motion[:, block]) + mean @ mean
        explained = (1 - unit / (values + unit)) @ np.square(scores, out=scores)
        lengths[block] = ((distances - explained) / unit + constant) / 2
    return lengths


def _neighbour_mean_matrix(faces: NDArray[np.integer], vertex_count: int) -> sparse.csr_array:
    """Return the matrix ``(V, V)`` that averages values over adjacent vertices."""
    next_corners = np.roll(faces, 1, axis=1)
    rows, columns = np.append(faces, next_corners), np.append(next_corners, faces)
    ones = np.ones(len(rows), dtype=np.int32)
    adjacency = sparse.coo_array((ones, (rows, columns)), (vertex_count, vertex_count)).tocsr()
    del rows, columns, ones, next_corners
    weights = np.repeat(1 / np.maximum(adjacency.sum(axis=1), 1), np.diff(adjacency.indptr))
    weights *= adjacency.data
    return sparse.csr_array((weights, adjacency.indices, adjacency.indptr), adjacency.shape)
