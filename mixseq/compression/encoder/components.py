r"""Compute principal components of a sequence, divide its mesh into parts, and compute those of the parts.

trajectories
    :math:`x_t(v) = m(t) + \sum_k u_k(t)\, b_k(v)`: principal components of the vertices' trajectories about their mean
    m. A basis vector :math:`b_k` has one number per vertex, a coefficient :math:`u_k(t)` three coordinates. A rigid
    part needs three vectors, which are affine functions of the position. This kind is best for most sequences.
shapes
    :math:`x_t(v) = m(v) + \sum_k u_k(t)\, b_k(v)`: principal components of the frames about their mean m. A basis
    vector has three coordinates per vertex, a coefficient is one number. This kind is best for meshes with few
    vertices and many frames.

Both kinds are optimal in the least-squares sense. Every number of :math:`b_k` and of :math:`u_k \|b_k\|` is rounded to
a multiple of the same step, so that all numbers have the same expected error (reverse water-filling).

Only the trajectory components of the whole mesh are computed from frames. Shapes, components of parts and best-fitting
coefficients are computed from these trajectory components, which are far fewer than the frames.

*Parts.* A part that moves with a few bones needs few components, whereas the whole mesh needs components for every
bone. So the mesh is cut into parts, as in clustered principal component analysis (Sattler, Sarlette and Klein 2005,
*Simple and efficient compression of animation sequences*). All parts have the same quantisation step. Near-rigid parts
are merged by their common rigid motion; they need not be adjacent, as the vertices of one bone may be in several
pieces. Then they are refined: the motion y of a vertex, in the coordinates of the principal components, is modelled as
normally distributed about the mean of its part. If y is rounded to steps :math:`\Delta`, it takes about

.. math:: L_p(y) = \tfrac12 \log \det \Bigl(1 + \frac{C_p}{\Delta^2}\Bigr)
                   + \tfrac12 (y - m_p)^T (C_p + \Delta^2)^{-1} (y - m_p)

nats, where :math:`m_p` and :math:`C_p` are the mean and the covariance of part p. Every vertex joins the part with the
least :math:`L_p`, averaged over its neighbourhood because borders cost bits. Then means and covariances are updated
(Lloyd's iteration).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import fsum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from mixseq.compression.bitstream.spatial_basis import MAX_PARTS, BasisKind, Part, PartBasis
from mixseq.errors import SegmentationError
from mixseq.mesh.measures import element_blocks
from mixseq.mesh.polygons import label_vertices
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import LargeArray, column_blocks, new_large_array
from mixseq.runtime.parallel import two_thread_executor
from mixseq.segmentation.methods import segment
from mixseq.sequence.sequence import FrameStore
from mixseq.types import Float, Index

MAX_TABLE_SIDE = 3000  # largest smaller side of a table for components; from larger ones, evenly spaced frames are used


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """Principal components of a sequence, largest first: each is a curve over time times a vector over the mesh."""

    kind: BasisKind  # whether components are trajectories or shapes
    # Trajectories: (T, 3) mean of all vertices at every frame. Shapes: (3, V) mean of all frames at every vertex.
    mean: Float
    curves: Float  # (K, T, d) orthonormal coefficients; d = 3 for trajectories, 1 for shapes
    # (K, c, V) orthogonal basis vectors in the units of the sequence; c = 1 for trajectories, 3 for shapes.
    vectors: Float
    left_out: float  # sum of squares of the omitted small components

    @cached_property
    def norms(self) -> Float:
        """Norms ``(K,)`` of the vectors, decreasing: the singular values."""
        return np.asarray(np.sqrt(np.square(self.vectors).sum(axis=(1, 2))))


def trajectory_components(sequence: FrameStore, min_norm: float) -> PrincipalComponents:
    """Compute the principal components of all vertices' trajectories."""
    count = len(sequence.points)
    table, means = _centred_trajectories(sequence, np.arange(count))
    stride = -(-min(table.shape) // MAX_TABLE_SIDE)
    if stride == 1 and table.shape[0] <= table.shape[1]:
        curves = _leading_eigenvectors(_row_gram(table), min_norm)
        vectors = _multiply(curves, table)
    else:
        # Every used frame represents `stride` frames, so norms are smaller by the root of `stride`.
        used = table if stride == 1 else _centred_trajectories(sequence, np.arange(0, count, stride))[0]
        scores = _project(table, _principal_directions(used, min_norm / np.sqrt(stride)))
        curves = np.asarray(linalg.qr(scores, mode="economic")[0].T, dtype=np.float64)
        vectors = _multiply(curves, table)
        rotation = _leading_eigenvectors(vectors @ vectors.T, 0.0)
        curves, vectors = rotation @ curves, rotation @ vectors
    energy = fsum(float(np.square(row).sum()) for _, block in column_blocks(table) for row in block)
    left_out = max(energy - float(np.square(vectors).sum()), 0.0)
    curves = curves.reshape(-1, count, 3)
    return PrincipalComponents("trajectories", means, curves, vectors[:, None], left_out)


def shape_components(components: PrincipalComponents, min_norm: float) -> PrincipalComponents:
    """Compute the principal components of the frames from the components of the trajectories."""
    used_mask = components.norms > 0
    curves, norms = components.curves[used_mask], components.norms[used_mask]
    vectors = components.vectors[used_mask, 0]
    mean = components.mean.mean(axis=0)[:, None] + curves.mean(axis=1).T @ vectors
    # Frames are scores (T, 3 (K + 1)) times orthonormal vectors, the last of which is constant.
    scales = np.append(norms, np.sqrt(vectors.shape[1]))
    scores = np.concatenate([curves, components.mean[None]])
    scores = (scores - scores.mean(axis=1, keepdims=True)) * scales[:, None, None]
    table = scores.transpose(1, 2, 0).reshape(len(components.mean), -1)
    if table.shape[0] <= table.shape[1]:
        shape_curves = _leading_eigenvectors(_row_gram(table), min_norm)
    else:
        directions = _leading_eigenvectors(table.T @ table, min_norm)
        shape_curves = np.asarray(linalg.qr(table @ directions.T, mode="economic")[0].T)
    loadings = (shape_curves @ table).reshape(len(shape_curves), 3, -1) / scales
    shapes = loadings[..., :-1] @ vectors + loadings[..., -1:]
    left_out = max(float(np.square(table).sum() - np.square(loadings * scales).sum()), 0.0)
    left_out += components.left_out
    return PrincipalComponents("shapes", mean, shape_curves[..., None], shapes, left_out)


def _leading_eigenvectors(gram: Float, min_norm: float) -> Float:
    """Return the eigenvectors ``(K, n)`` of a matrix ``(n, n)`` with eigenvalues above `min_norm`^2, at least one."""
    vectors = linalg.eigh(gram, subset_by_value=(max(min_norm, 0.0) ** 2, np.inf), check_finite=False)[1]
    if not vectors.shape[1]:
        vectors = np.eye(len(gram))[:, -1:]
    return np.ascontiguousarray(vectors[:, ::-1].T)


def _row_gram(table: LargeArray) -> Float:
    gram = np.zeros((table.shape[0],) * 2)
    for _, block in column_blocks(table):
        gram += block @ block.T
    return gram


def _principal_directions(table: LargeArray, min_norm: float) -> Float:
    """Return orthogonal vectors ``(K, V)`` that nearly span the rows of a table ``(R, V)``."""
    height, width = table.shape
    if height <= width:
        return _multiply(_leading_eigenvectors(_row_gram(table), min_norm), table)
    gram = np.zeros((width, width))
    for start in range(0, height, width):
        block = table[start : start + width]
        gram += block.T @ block
    return _leading_eigenvectors(gram, min_norm)


def _multiply(matrix: Float, table: LargeArray) -> Float:
    product = np.empty((len(matrix), table.shape[1]))
    for columns, block in column_blocks(table):
        product[:, columns] = matrix @ block
    return product


def _project(table: LargeArray, directions: Float) -> Float:
    scores, size = np.empty((len(table), len(directions))), 1 << 10
    for start in range(0, len(table), size):
        scores[start : start + size] = table[start : start + size] @ directions.T
    return scores


def _centred_trajectories(sequence: FrameStore, frames: Index) -> tuple[LargeArray, Float]:
    """Return trajectories ``(3T, V)`` relative to the mean of all vertices, and these means ``(T, 3)``."""
    table = new_large_array((3 * len(frames), sequence.points.shape[1]))
    means = np.empty((len(frames), 3))
    for row, frame in enumerate(frames):
        points = sequence.points[frame : frame + 1][0].astype(np.float64)
        means[row] = points.mean(axis=0)
        table[3 * row : 3 * row + 3] = (points - means[row]).T
    return table, means


MIN_FACES_PER_PART = 8  # smallest mean number of faces per part; a mesh with fewer faces remains one part
RIGID_PARTS = 24  # number of near-rigid parts before merging
SEGMENTATION_FRAMES = 16  # number of evenly spread frames for segmentation and merging


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


MAX_REFINING_ROUNDS = 5  # largest number of rounds in which vertices change parts
MIN_PART_VERTICES = 8  # smallest number of vertices in a part
MAX_COMPONENTS = 64  # largest number of components of the whole mesh that are used
MIN_COMPONENT_STEPS = 0.1  # mean displacement of vertices by a component, in steps, below which it is ignored


def refine_parts(components: PrincipalComponents, labels: Index, faces: NDArray[np.integer], step: float) -> Index:
    """Move vertices of a mesh with faces ``(F, 3)`` between parts to save bytes; return the new labels ``(V,)``."""
    part_count, vertex_count = int(labels.max()) + 1, len(labels)
    min_norm = MIN_COMPONENT_STEPS * step * np.sqrt(vertex_count)
    rank = np.count_nonzero(components.norms > min_norm)
    motion = components.vectors[: min(max(rank, 1), MAX_COMPONENTS), 0]
    neighbour_mean = _neighbour_mean_matrix(faces, vertex_count)
    squares = np.einsum("rv,rv->v", motion, motion)
    lengths = np.empty((vertex_count, part_count))
    for _ in range(MAX_REFINING_ROUNDS):
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


MIN_VECTOR_STEPS = 0.9
"""Largest magnitude in a basis vector, in steps, below which it vanishes: rounding sets nearly all numbers to zero."""

MAX_VANISHING_VECTORS = 2  # number of consecutive vanishing basis vectors after which no more vectors are coded
_VECTORS_PER_BATCH = 16  # number of basis vectors computed at once


class Fit(NamedTuple):
    """Least-squares coefficients of a part."""

    coefficients: Float  # (K, T, d) coefficients of the varying vectors, scaled to unit length
    gram: Float  # (K, K) inner products of these vectors
    squares: float  # sum of squared distances of the part from the fit

    def squares_of(self, coefficients: Float) -> float:
        """Return the sum of squared distances of the part from a fit with other coefficients ``(K, T, d)``."""
        difference = coefficients - self.coefficients
        return self.squares + float(np.vdot(difference, np.tensordot(self.gram, difference, 1)))


class PartComponents:
    """Principal components of a part of the mesh, computed on demand."""

    def __init__(self, components: PrincipalComponents, part: Part, min_norm: float) -> None:
        self.part, self.norms = part, components.norms
        self._components = components
        self._first = 0  # number of the first vector of the newest batch
        self._batch: list[Float] = list(components.vectors)
        if len(part.vertices) < components.vectors.shape[2]:
            self._directions, self._offsets, self.norms = _rotate_to_part(self._loadings, min_norm)
            self._batch = []
        elif components.kind == "shapes":
            root = np.sqrt(components.curves.shape[1])
            self._batch = [root * components.mean, *components.vectors]
            self.norms = np.append(root * np.linalg.norm(components.mean), self.norms)

    @property
    def _loadings(self) -> Float:
        """Vectors ``(R, c n)`` of the whole mesh at the vertices of the part."""
        vectors = self._components.vectors
        if len(self.part.vertices) < vectors.shape[2]:
            vectors = vectors[..., self.part.vertices]
        return vectors.reshape(len(vectors), -1)

    @property
    def coordinates(self) -> int:
        """Number c of coordinates of a vector at a vertex."""
        return int(self._components.vectors.shape[1])

    @property
    def width(self) -> int:
        """Number of entries of a vector."""
        return self.coordinates * len(self.part.vertices)

    def vector(self, number: int) -> Float:
        """Return a basis vector ``(c, n)``, in the units of the sequence."""
        if not self._first <= number < self._first + len(self._batch):
            self._first = number - number % _VECTORS_PER_BATCH
            batch = slice(self._first, self._first + _VECTORS_PER_BATCH)
            vectors = self._directions[batch] @ self._loadings - self._offsets[batch, None]
            self._batch = list(vectors[:, None])
        return np.asarray(self._batch[number - self._first])

    def free_vectors(self) -> None:
        """Free the vectors of a part of the mesh, which are computed again when needed."""
        if len(self.part.vertices) < self._components.vectors.shape[2]:
            self._first, self._batch = 0, []

    def rank(self, step: float) -> int:
        """Return the number of vectors, at least one, before the vanishing vectors at which coding stops."""
        vanishing = number = 0
        while number < len(self.norms) and vanishing < MAX_VANISHING_VECTORS:
            vanishes = np.abs(self.vector(number)).max() < MIN_VECTOR_STEPS * step
            vanishing = vanishing + 1 if vanishes else 0
            number += 1
        return max(number - vanishing, 1)

    def fit(self, basis: PartBasis) -> Fit:
        """Fit coefficients of rounded vectors to the motion of the part, by least squares."""
        loadings, curves = self._loadings, self._components.curves.reshape(len(self._loadings), -1)
        count, vectors = self._components.curves.shape[1], basis.vectors.reshape(len(basis.vectors), -1)
        has_mean_shape = self._components.kind == "shapes"
        if has_mean_shape:  # the rounding error of the mean is one more component
            loadings = np.append(loadings, self.vector(0).reshape(1, -1) - vectors[:1], axis=0)
            curves = np.append(curves, np.full((1, count), count**-0.5), axis=0)
            vectors = vectors[1:]
        unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        gram, right = unit @ unit.T, unit @ loadings.T
        solution = solve_damped(gram, right)
        squares = np.square(loadings).sum() + np.vdot(solution, gram @ solution - 2 * right)
        coefficients = solution @ curves
        if not has_mean_shape:  # the first vector is constant, and represents the whole mean
            coefficients[0] += np.sqrt(self.width) * self._components.mean.reshape(-1)
        return Fit(coefficients.reshape(len(unit), count, 3 // self.coordinates), gram, float(squares))


def _rotate_to_part(loadings: Float, min_norm: float) -> tuple[Float, Float, Float]:
    """Compute a part's principal components from the whole mesh's vectors ``(R, n)`` at its vertices.

    Return directions ``(K, R)``, their products ``(K,)`` with the means of the vectors, and norms ``(K,)``.
    """
    means = loadings.mean(axis=1)
    gram = loadings @ loadings.T - loadings.shape[1] * np.outer(means, means)
    values, vectors = linalg.eigh(gram, check_finite=False)
    kept = max(1, min(int(np.count_nonzero(values > min_norm**2)), loadings.shape[1]))
    directions = np.ascontiguousarray(vectors[:, ::-1][:, :kept].T)
    return directions, directions @ means, np.sqrt(np.maximum(values[::-1][:kept], 0.0))


def solve_damped(gram: Float, right: Float) -> Float:
    """Solve the normal equations of nearly orthogonal vectors."""
    if not len(gram):  # a mean shape, and no motion
        return right
    # Damping keeps the matrix regular if vectors are equal after rounding; a second solve corrects for the damping.
    factor = linalg.cho_factor(gram + 1e-9 * np.eye(len(gram)), check_finite=False)
    solution = linalg.cho_solve(factor, right, check_finite=False)
    return np.asarray(solution + linalg.cho_solve(factor, right - gram @ solution, check_finite=False))
