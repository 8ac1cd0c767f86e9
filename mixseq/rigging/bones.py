r"""Skinning weights of vertices, rigid motions of bones, and the centred sequences to which both are fitted.

With homogeneous rest positions :math:`\tilde r_v = (r_v, 1)`, motions :math:`M_{tb} = (R_{tb}, T_{tb})` ``(3, 4)`` and
:math:`h_{bc} = \sum_t (M_{tb} \tilde r_v - x_t) \cdot (M_{tc} \tilde r_v - x_t)`, the squared error of vertex v is

.. math:: \sum_t \Bigl| \sum_b w_b M_{tb} \tilde r_v - x_t \Bigr|^2 = w^T h\, w
          \quad \text{where} \quad \sum_b w_b = 1.

This error is minimised under :math:`w \ge 0` by an active set (Lawson and Hanson 1974). While a vertex has more than
four bones, the bone whose removal increases the error least is removed, and the weights are fitted again. Le and Deng
(2012) keep the four bones of largest weight instead. Candidates are the current bones of the vertex, and the twelve
bones with the smallest errors as single bones. The form h needs only the sums over the frames

.. math:: Q_{bc} = \sum_t M_{tb}^T M_{tc}, \quad g_b = \sum_t M_{tb}^T x_t, \quad s = \sum_t |x_t|^2, \qquad
          h_{bc} = \tilde r^T Q_{bc} \tilde r - (g_b + g_c) \cdot \tilde r + s .

For given weights, the best rest position solves three linear equations with the same sums.

The motions ``(4, 3)`` of all frames are stored transposed and side by side: ``(B, 4, 3T)``. Sequences are centred in
every frame, in units of the diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from mixseq.mesh.measures import choose_origin
from mixseq.mesh.rigid import kabsch, nearest_rotations
from mixseq.rigging.rigs import Skeleton, Skin, remove_sign_flips
from mixseq.runtime.jit import compiled
from mixseq.segmentation.motion import moments, union_errors
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, load_frames, rounding_margin
from mixseq.types import Float, Index

MAX_ACTIVE_SET_ROUNDS = 60  # largest number of rounds, each of which adds a bone
MIN_RELATIVE_GAIN = 1e-12  # smallest decrease of the error by a bone, relative to the squared positions
NEAREST_CANDIDATES = 12  # number of bones that are tried besides the current bones
RELATIVE_DAMPING = 1e-14  # relative damping of the diagonal, so that bones of equal motion share the weight
REST_STIFFNESS = 1e-6  # weight of the previous rest position, relative to one frame


@compiled
def cholesky_solve(a: Float, b: Float, n: int) -> None:
    """Solve the symmetric positive definite n x n system a x = b in place by a Cholesky factor; b becomes x."""
    for j in range(n):
        for i in range(j, n):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                a[j, j] = np.sqrt(max(s, 1e-300))
            else:
                a[i, j] = s / a[j, j]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * b[k]
        b[i] = s / a[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= a[k, i] * b[k]
        b[i] = s / a[i, i]


@compiled
def _minimise_affine(h: Float, bones: Index, n: int, scale: float, a: Float, z: Float) -> None:
    """Minimise z^T h z for weights z of given bones with sum one and any signs; h z is constant at the minimum."""
    for i in range(n):
        for j in range(n):
            # A constant added to h keeps h regular; it does not change the minimum, since z has sum one.
            a[i, j] = h[bones[i], bones[j]] + scale
        a[i, i] += RELATIVE_DAMPING * scale
        z[i] = 1.0
    cholesky_solve(a, z, n)
    total = 0.0
    for i in range(n):
        total += z[i]
    for i in range(n):
        z[i] /= total


@compiled
def _minimise_convex(h: Float, bones: Index, n: int, w: Float, scale: float, a: Float, z: Float) -> int:
    """Minimise w^T h w for w >= 0 with sum one, from feasible w; return the number of bones with w > 0."""
    while True:
        _minimise_affine(h, bones, n, scale, a, z)
        step, removed = 1.0, -1
        for i in range(n):
            if z[i] <= 0.0 and w[i] - z[i] > 0.0 and w[i] / (w[i] - z[i]) < step:
                step, removed = w[i] / (w[i] - z[i]), i
        for i in range(n):
            w[i] += step * (z[i] - w[i])
        if removed < 0:
            return n
        n -= 1
        for i in range(removed, n):
            bones[i], w[i] = bones[i + 1], w[i + 1]
        total = 0.0
        for i in range(n):
            w[i] = max(w[i], 0.0)
            total += w[i]
        for i in range(n):
            w[i] /= total


@compiled
def _squared_error(h: Float, bones: Index, n: int, w: Float) -> float:
    value = 0.0
    for i in range(n):
        for j in range(n):
            value += w[i] * w[j] * h[bones[i], bones[j]]
    return value


@compiled
def _active_set(h: Float, scale: float, bones: Index, w: Float, n: int, limit: int, a: Float, z: Float) -> int:
    """Minimise by Lawson and Hanson's active set, from feasible w; return the number of bones, at most `limit`."""
    for _ in range(MAX_ACTIVE_SET_ROUNDS):
        if n == limit:
            break
        value = _squared_error(h, bones, n, w)
        best_bone, lowest_slope = -1, value - MIN_RELATIVE_GAIN * scale
        for b in range(len(h)):
            slope, is_active = 0.0, False
            for i in range(n):
                slope += h[b, bones[i]] * w[i]
                is_active |= bones[i] == b
            if slope < lowest_slope and not is_active:
                best_bone, lowest_slope = b, slope
        if best_bone < 0:
            break
        bones[n], w[n] = best_bone, 0.0
        n = _minimise_convex(h, bones, n + 1, w, scale, a, z)
    return n


@compiled
def _bound_removals(h: Float, scale: float, bones: Index, w: Float, n: int, a: Float, z: Float, bounds: Float) -> None:
    """Compute `bounds` ``(n,)`` of the errors without each of n bones, whose weights w are optimal.

    Without a bone and with weights of any sign, the error increases by w_i^2 / P_ii, where P is the inverse of h on
    weights with sum zero: h^-1 - h^-1 1 1^T h^-1 / (1^T h^-1 1).
    """
    _minimise_affine(h, bones, n, scale, a, z)  # the lower triangle of a is the Cholesky factor
    value, total = _squared_error(h, bones, n, w), 0.0
    for j in range(n):  # the upper triangle becomes the transposed inverse factor
        z[j] = 0.0
        inverse = 1.0 / a[j, j]
        for i in range(j):
            s = a[j, i] * a[i, i]
            for k in range(i + 1, j):
                s += a[j, k] * a[i, k]
            a[i, j] = -s * inverse
            z[j] += a[i, j]
        a[j, j] = inverse
        z[j] += inverse
        total += z[j] * z[j]
    for i in range(n):
        diagonal, row_sum = 0.0, 0.0
        for j in range(i, n):
            diagonal += a[i, j] * a[i, j]
            row_sum += a[i, j] * z[j]
        bounds[i] = value + w[i] * w[i] / max(diagonal - row_sum * row_sum / total, 1e-300)


@compiled
def _remove_least_bones(h: Float, scale: float, bones: Index, w: Float, limit: int, n: int, a: Float, z: Float) -> int:
    """Remove the bones whose removal increases the error least, until `limit` remain; return their number."""
    rest, trial, best_weights = np.empty_like(bones), np.empty_like(w), np.empty_like(w)
    best_bones, bounds = np.empty_like(bones), np.empty_like(w)
    while n > limit:
        _bound_removals(h, scale, bones, w, n, a, z, bounds)
        lowest_value, best_n = np.inf, 0
        while True:
            removed = 0
            for i in range(1, n):
                if bounds[i] < bounds[removed]:
                    removed = i
            if bounds[removed] >= lowest_value:
                break
            m, total = 0, 0.0
            for i in range(n):
                if i != removed:
                    rest[m], trial[m] = bones[i], w[i]
                    total += w[i]
                    m += 1
            for i in range(m):
                trial[i] = trial[i] / total if total > 0.0 else 1.0 / m
            m = _minimise_convex(h, rest, m, trial, scale, a, z)
            value, bounds[removed] = _squared_error(h, rest, m, trial), np.inf
            if value < lowest_value:
                lowest_value, best_n = value, m
                for i in range(m):
                    best_bones[i], best_weights[i] = rest[i], trial[i]
        n = best_n
        for i in range(n):
            bones[i], w[i] = best_bones[i], best_weights[i]
    return n


@compiled
def _homogeneous_form(p: Float, x: float, y: float, z: float) -> float:
    """Return r^T p r with r = (x, y, z, 1)."""
    value: float = (
        x * (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3])
        + y * (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3])
        + z * (p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3])
        + (p[3, 0] * x + p[3, 1] * y + p[3, 2] * z + p[3, 3])
    )
    return value


@compiled
def _choose_candidates(errors: Float, influences: Index, weights: Float, candidates: Index) -> int:
    """Choose the bones of smallest errors, the best first, then the current bones; return the number of candidates."""
    n = 0
    for b in range(len(errors)):
        i = n
        if n < NEAREST_CANDIDATES:
            n += 1
        elif errors[b] < errors[candidates[n - 1]]:
            i = n - 1
        else:
            continue
        while i > 0 and errors[b] < errors[candidates[i - 1]]:
            candidates[i] = candidates[i - 1]
            i -= 1
        candidates[i] = b
    for i in range(len(influences)):
        if weights[i] > 0.0:
            is_candidate = False
            for j in range(n):
                is_candidate |= candidates[j] == influences[i]
            if not is_candidate:
                candidates[n] = influences[i]
                n += 1
    return n


@compiled
def fit_vertices(
    rest: Float,
    squares: Float,
    products: Float,
    projections: Float,
    frames: int,
    free_rest: bool,
    influences: Index,
    weights: Float,
    errors: Float,
) -> None:
    """Fit skinning weights in place, and also rest positions ``(V, 3)`` if `free_rest`.

    Sums over the T `frames`: `squares` ``(V,)`` of |x_t|^2, `products` ``(B, B, 4, 4)`` of M_tb^T M_tc, `projections`
    ``(V, B, 4)`` of M_tb^T x_t. Updated in place: `influences`, `weights` ``(V, 4)``, squared `errors` ``(V,)``.
    """
    bone_count, max_count = products.shape[0], influences.shape[1]
    size = NEAREST_CANDIDATES + max_count
    a, z = np.empty((size, size)), np.empty(size)
    bones, w = np.empty(size, dtype=np.int64), np.empty(size)  # bones are numbered as candidates
    old, old_weights, selected = np.empty(size, dtype=np.int64), np.empty(size), np.empty(size, dtype=np.int64)
    bone_errors, candidates = np.empty(bone_count), np.empty(bone_count, dtype=np.int64)
    linear, normal, right_side = np.empty(bone_count), np.empty((3, 3)), np.empty(3)
    for v in range(len(rest)):
        x, y, q = rest[v, 0], rest[v, 1], rest[v, 2]
        for b in range(bone_count):
            s = projections[v, b]
            linear[b] = s[0] * x + s[1] * y + s[2] * q + s[3]
            bone_errors[b] = _homogeneous_form(products[b, b], x, y, q) - 2.0 * linear[b] + squares[v]
        n = _choose_candidates(bone_errors, influences[v], weights[v], candidates)
        h = np.empty((n, n))
        for i in range(n):
            b = candidates[i]
            h[i, i] = bone_errors[b]
            for j in range(i):
                c = candidates[j]
                h[i, j] = h[j, i] = _homogeneous_form(products[b, c], x, y, q) - linear[b] - linear[c] + squares[v]
        scale = max(squares[v], 1e-300)
        bones[0], w[0] = 0, 1.0
        count = _active_set(h, scale, bones, w, 1, n, a, z)
        count = _remove_least_bones(h, scale, bones, w, max_count, count, a, z)
        # A second start from the previous weights ensures that errors never increase.
        m = 0
        for i in range(max_count):
            if weights[v, i] > 0.0:
                for j in range(n):
                    if candidates[j] == influences[v, i]:
                        old[m], old_weights[m] = j, weights[v, i]
                m += 1
        if m > 0:
            m = _minimise_convex(h, old, m, old_weights, scale, a, z)
            m = _active_set(h, scale, old, old_weights, m, max_count, a, z)
            if _squared_error(h, old, m, old_weights) < _squared_error(h, bones, count, w):
                count = m
                bones[:m], w[:m] = old[:m], old_weights[:m]
        errors[v] = max(_squared_error(h, bones, count, w), 0.0)
        for i in range(count):
            selected[i] = candidates[bones[i]]
        influences[v], weights[v] = selected[0], 0.0
        influences[v, :count], weights[v, :count] = selected[:count], w[:count]
        if free_rest:
            # Normal equations of sum_t |A_t r + b_t - x_t|^2; A_t and b_t are weighted means of the motions.
            for i in range(3):
                for j in range(3):
                    a3 = 0.0
                    for k in range(count):
                        for l in range(count):  # noqa: E741
                            a3 += w[k] * w[l] * products[selected[k], selected[l], i, j]
                    normal[i, j] = a3
            for i in range(3):
                total = 0.0
                for k in range(count):
                    total += w[k] * projections[v, selected[k], i]
                    for l in range(count):  # noqa: E741
                        total -= w[k] * w[l] * products[selected[k], selected[l], i, 3]
                normal[i, i] += REST_STIFFNESS * frames
                right_side[i] = total + REST_STIFFNESS * frames * rest[v, i]
            cholesky_solve(normal, right_side, 3)
            for i in range(3):
                rest[v, i] = right_side[i]


MAX_CHUNK_ENTRIES = 1 << 21  # largest number of entries of projections in memory


@dataclass(frozen=True, eq=False)
class Binding:
    """Rest positions and skinning weights."""

    rest: Float  # (V, 3) rest positions
    influences: Index  # (V, 4) bones of each vertex
    weights: Float  # (V, 4) skinning weights of these bones
    errors: Float  # (V,) squared errors, summed over the frames, plus the costs of weights
    costs: Float | None = None  # (V, B) cost of a weight of one for each bone; None without costs

    def matrix(self, bone_count: int) -> sparse.csr_array:
        r"""Return the rows :math:`w_{vb} \tilde r_v` of all vertices as a matrix ``(V, 4 B)``."""
        homogeneous = np.concatenate([self.rest, np.ones((len(self.rest), 1))], axis=1)
        values = self.weights[:, :, None] * homogeneous[:, None]
        columns = 4 * self.influences[:, :, None] + np.arange(4)
        row_starts = np.arange(len(self.rest) + 1) * values[0].size
        entries = values.reshape(-1), columns.reshape(-1), row_starts
        return sparse.csr_array(entries, (len(self.rest), 4 * bone_count))


def bind(tracks: Float, motions: Float, start: Binding, free_rest: bool = True) -> Binding:
    """Fit skinning weights, and rest positions if `free_rest`: tracks ``(V, 3T)``; motions ``(B, 4, 3T)``."""
    bones, frames = len(motions), motions.shape[2] // 3
    flat = motions.reshape(4 * bones, -1)
    products = (flat @ flat.T).reshape(bones, 4, bones, 4).swapaxes(1, 2).copy()
    binding = replace(
        start,
        rest=start.rest.copy(),
        influences=start.influences.copy(),
        weights=start.weights.copy(),
        errors=np.empty(len(tracks)),
    )
    chunk_size = max(1, MAX_CHUNK_ENTRIES // len(flat))
    for first in range(0, len(tracks), chunk_size):
        chunk = slice(first, first + chunk_size)
        projections = (tracks[chunk] @ flat.T).reshape(-1, bones, 4)
        if start.costs is not None:  # add c_b / 2 + c_c / 2 to h, and thereby w^T c to w^T h w
            projections[..., 3] -= start.costs[chunk] / 2
        fit_vertices(
            binding.rest[chunk],
            np.einsum("vi,vi->v", tracks[chunk], tracks[chunk]),
            products,
            projections,
            frames,
            free_rest,
            binding.influences[chunk],
            binding.weights[chunk],
            binding.errors[chunk],
        )
    return binding


@dataclass(frozen=True, eq=False)
class Centred:
    """Sequence in memory, with the centres of its frames."""

    header: SequenceHeader  # mesh and times
    points: Float  # (T, V, 3) points in the file's units
    centres: Float  # (T, 3) mean point of every frame
    diagonal: float  # unit of errors, or one if all frames are points

    @classmethod
    def from_sequence(cls, sequence: Frames) -> Centred:
        """Read a sequence into memory."""
        store = load_frames(sequence)
        points = np.asarray(store.points[: store.header.frame_count], dtype=np.float64)
        return cls(store.header, points, points.mean(axis=1), store.diagonal or 1.0)

    def to_length(self, error: float) -> float:
        """Return an error in diagonals as a length, less the margin for rounding to single precision in files."""
        length, origin = error * self.diagonal, choose_origin(self.points[0])
        return length - rounding_margin(length, max(float(np.abs(frame - origin).max()) for frame in self.points))

    @property
    def frames(self) -> Float:
        """Centred points ``(T, V, 3)``, in diagonals."""
        return (self.points - self.centres[:, None]) / self.diagonal

    @cached_property
    def tracks(self) -> Float:
        """Trajectories ``(V, 3T)`` of the centred points, in diagonals."""
        return np.ascontiguousarray(self.frames.swapaxes(0, 1).reshape(self.header.vertex_count, -1))

    def to_skin(self, binding: Binding, motions: Float, skeleton: Skeleton, origin: Float) -> Skin:
        """Return a skin in the file's units: motions ``(B, 4, 3T)``; origin ``(3,)`` of the rest shape."""
        order = np.argsort(-binding.weights, axis=1, kind="stable")
        weights = np.take_along_axis(binding.weights, order, axis=1)
        influences = np.take_along_axis(binding.influences, order, axis=1)
        matrices = motions.reshape(len(motions), 4, -1, 3).transpose(2, 0, 3, 1)  # (T, B, 3, 4)
        pivots = (skeleton.pivots - origin) / self.diagonal
        pivot_positions = np.einsum("tbij,bj->tbi", matrices[..., :3], pivots) + matrices[..., 3]
        rotations = Rotation.from_matrix(matrices[..., :3].reshape(-1, 3, 3))
        quaternions = rotations.as_quat().reshape(*matrices.shape[:2], 4)
        return Skin(
            header=self.header,
            rest=self.diagonal * binding.rest + origin,
            skeleton=skeleton,
            rotations=remove_sign_flips(quaternions),
            translations=self.diagonal * pivot_positions + self.centres[:, None],
            influences=np.where(weights > 0, influences, 0),
            weights=weights,
            targets=np.zeros((0, len(weights), 3)),
            target_weights=np.zeros((len(matrices), 0)),
        )


def transpose_motion(rotations: Float, translations: Float) -> Float:
    """Return rotations ``(T, 3, 3)`` and translations ``(T, 3)`` as a transposed motion ``(4, 3T)``."""
    matrices = np.concatenate([rotations, translations[:, :, None]], axis=2)
    return matrices.transpose(2, 0, 1).reshape(4, -1)


def project_to_rotations(motions: Float) -> Float:
    """Replace the linear parts of transposed motions ``(B, 4, 3T)`` by the nearest rotations."""
    matrices = motions.reshape(len(motions), 4, -1, 3).transpose(0, 2, 3, 1)  # (B, T, 3, 4)
    bones = zip(nearest_rotations(matrices[..., :3]), matrices[..., 3], strict=True)
    return np.stack([transpose_motion(rotations, translations) for rotations, translations in bones])


def fit_rigid_motion(tracks: Float, rest: Float, vertices: Index) -> Float:
    """Fit a transposed rigid motion ``(4, 3T)`` to given vertices: tracks ``(V, 3T)``; rest ``(V, 3)``."""
    positions = tracks[vertices].reshape(len(vertices), -1, 3).swapaxes(0, 1)
    return transpose_motion(*kabsch(rest[vertices], positions))


def merge_bones(tracks: Float, labels: Index, count: int) -> Index:
    """Merge labels ``(V,)`` to `count` bones, first those whose common rigid motion increases the error least."""
    labels = np.unique(labels, return_inverse=True)[1]
    positions = tracks.reshape(len(tracks), -1, 3)
    bones = np.arange(int(labels.max()) + 1)
    if len(bones) <= count:
        return np.asarray(labels, dtype=np.int64)
    bone_positions = [positions[labels == bone] for bone in bones]
    bone_moments = [moments(points[:, 0], points, np.ones(len(points))) for points in bone_positions]
    errors = np.array([each.error() for each in bone_moments])
    costs = np.full((len(bones), len(bones)), np.inf)  # above the diagonal

    def update_costs(bone: int, others: Index) -> None:
        if others.size:
            unions = union_errors(bone_moments[bone], [bone_moments[other] for other in others])
            costs[np.minimum(bone, others), np.maximum(bone, others)] = unions - errors[bone] - errors[others]

    for bone in bones.tolist():
        update_costs(bone, bones[bone + 1 :])
    while len(bones) > count:
        keep, drop = divmod(int(costs.argmin()), len(costs))
        labels[labels == drop] = keep
        bones = bones[bones != drop]
        bone_moments[keep] += bone_moments[drop]
        errors[keep] = bone_moments[keep].error()
        costs[drop] = costs[:, drop] = np.inf
        update_costs(keep, bones[bones != keep])
    return np.asarray(np.unique(labels, return_inverse=True)[1], dtype=np.int64)


def seed_bones(tracks: Float, binding: Binding, count: int, neighbour_count: int) -> Float:
    """Return motions ``(n, 4, 3T)`` of new bones, fitted to the vertices with tracks nearest to a worst vertex."""
    errors = binding.errors.copy()
    motions = []
    for _ in range(count):
        worst = int(errors.argmax())
        if errors[worst] <= 0:
            break
        offsets = tracks - tracks[worst]
        distances = np.einsum("vi,vi->v", offsets, offsets)
        last = min(neighbour_count, len(offsets)) - 1
        neighbours = np.argpartition(distances, last)[:neighbour_count]
        motions.append(fit_rigid_motion(tracks, binding.rest, np.sort(neighbours)))
        errors[neighbours] = 0.0
        errors[worst] = 0.0
    return np.stack(motions) if motions else np.zeros((0, 4, tracks.shape[1]))
