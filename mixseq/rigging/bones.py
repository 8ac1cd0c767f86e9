r"""Weights of vertices and motions of bones, and the sequences to which they are fitted.

With homogeneous rest positions :math:`\tilde r_v = (r_v, 1)`, motions :math:`M_{tb} = (R_{tb}, T_{tb})` ``(3, 4)`` and
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

Motions are stored transposed, ``(4, 3)``, next to those of all frames: ``(B, 4, 3T)``. Sequences are centred in every
frame, and in diagonals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from mixseq.mesh.rigid import kabsch, nearest_rotations
from mixseq.rigging.rigs import Skeleton, Skin, remove_sign_flips
from mixseq.runtime.jit import compiled
from mixseq.segmentation.motion import moments, union_errors
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, bounding_diagonal, load_frames
from mixseq.types import Float, Index

ROUNDS = 60  # of an active set: each adds or removes a bone
GAIN = 1e-12  # smallest decrease of the error by a bone, relative to the position's square
CANDIDATES = 12  # bones tried at a vertex besides its current ones
DAMPING = 1e-14  # share of the diagonal: two bones with the same motion share a weight
HELD = 1e-6  # pull of a rest position towards the one before, relative to one frame


@compiled
def solve(a: Float, b: Float, n: int) -> None:
    """Solve a symmetric positive system by Cholesky factors, in place; b becomes the solution."""
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
def _on_plane(h: Float, chosen: Index, n: int, scale: float, a: Float, z: Float) -> None:
    """Minimise z^T h z over the chosen bones with sum one, of any sign: h z is constant."""
    for i in range(n):
        for j in range(n):
            # A constant added to h changes nothing where the sum is one, and keeps h regular.
            a[i, j] = h[chosen[i], chosen[j]] + scale
        a[i, i] += DAMPING * scale
        z[i] = 1.0
    solve(a, z, n)
    total = 0.0
    for i in range(n):
        total += z[i]
    for i in range(n):
        z[i] /= total


@compiled
def _descend(h: Float, chosen: Index, n: int, w: Float, scale: float, a: Float, z: Float) -> int:
    """Minimise over the chosen bones with sum one and no weight negative, from feasible w; return the number left."""
    while True:
        _on_plane(h, chosen, n, scale, a, z)
        step, out = 1.0, -1
        for i in range(n):
            if z[i] <= 0.0 and w[i] - z[i] > 0.0 and w[i] / (w[i] - z[i]) < step:
                step, out = w[i] / (w[i] - z[i]), i
        for i in range(n):
            w[i] += step * (z[i] - w[i])
        if out < 0:
            return n
        n -= 1
        for i in range(out, n):
            chosen[i], w[i] = chosen[i + 1], w[i + 1]
        total = 0.0
        for i in range(n):
            w[i] = max(w[i], 0.0)
            total += w[i]
        for i in range(n):
            w[i] /= total


@compiled
def _value(h: Float, chosen: Index, n: int, w: Float) -> float:
    value = 0.0
    for i in range(n):
        for j in range(n):
            value += w[i] * w[j] * h[chosen[i], chosen[j]]
    return value


@compiled
def _active_set(
    h: Float, scale: float, candidates: Index, chosen: Index, w: Float, n: int, most: int, a: Float, z: Float
) -> int:
    """Minimise by Lawson and Hanson's active set on the simplex, from feasible w, with at most `most` bones."""
    for _ in range(ROUNDS):
        if n == most:
            break
        value = _value(h, chosen, n, w)
        best, lowest = -1, value - GAIN * scale
        for b in candidates:
            slope = 0.0
            for i in range(n):
                slope += h[b, chosen[i]] * w[i]
            if slope < lowest:
                known = False
                for i in range(n):
                    known = known or chosen[i] == b
                if not known:
                    best, lowest = b, slope
        if best < 0:
            break
        chosen[n], w[n] = best, 0.0
        n = _descend(h, chosen, n + 1, w, scale, a, z)
    return n


@compiled
def _sparsest(h: Float, scale: float, chosen: Index, w: Float, most: int, n: int, a: Float, z: Float) -> int:
    """Remove the bone of least loss until at most `most` are left."""
    rest, trial, best = np.empty_like(chosen), np.empty_like(w), np.empty_like(w)
    best_chosen = np.empty_like(chosen)
    while n > most:
        lowest, best_n = np.inf, 0
        for out in range(n):
            m = 0
            for i in range(n):
                if i != out:
                    rest[m], trial[m] = chosen[i], w[i]
                    m += 1
            total = 0.0
            for i in range(m):
                total += trial[i]
            for i in range(m):
                trial[i] = trial[i] / total if total > 0.0 else 1.0 / m
            m = _descend(h, rest, m, trial, scale, a, z)
            value = _value(h, rest, m, trial)
            if value < lowest:
                lowest, best_n = value, m
                for i in range(m):
                    best_chosen[i], best[i] = rest[i], trial[i]
        n = best_n
        for i in range(n):
            chosen[i], w[i] = best_chosen[i], best[i]
    return n


@compiled
def _quadratic(p: Float, x: float, y: float, z: float) -> float:
    """Return r^T p r with r = (x, y, z, 1)."""
    value: float = (
        x * (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3])
        + y * (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3])
        + z * (p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3])
        + (p[3, 0] * x + p[3, 1] * y + p[3, 2] * z + p[3, 3])
    )
    return value


@compiled
def _candidates(single: Float, influences: Index, weights: Float, candidates: Index) -> int:
    """Choose the bones that alone come nearest, best first, and the current ones; return their number."""
    n = 0
    for _ in range(min(CANDIDATES, len(single))):
        best = -1
        for b in range(len(single)):
            known = False
            for i in range(n):
                known = known or candidates[i] == b
            if not known and (best < 0 or single[b] < single[best]):
                best = b
        candidates[n] = best
        n += 1
    for i in range(len(influences)):
        known = weights[i] <= 0.0
        for j in range(n):
            known = known or candidates[j] == influences[i]
        if not known:
            candidates[n] = influences[i]
            n += 1
    return n


@compiled
def fit_vertices(
    rest: Float,
    squares: Float,
    products: Float,
    seen: Float,
    frames: int,
    free_rest: bool,
    influences: Index,
    weights: Float,
    errors: Float,
) -> None:
    """Fit weights, and rest positions ``(V, 3)`` if `free_rest`, of vertices, in place.

    Sums over the T `frames`: `squares` ``(V,)`` of |x_t|^2, `products` ``(B, B, 4, 4)`` of M_tb^T M_tc, `seen`
    ``(V, B, 4)`` of M_tb^T x_t. Initial and final `influences`, `weights` ``(V, 4)``; squared `errors` ``(V,)``.
    """
    bones, most = products.shape[0], influences.shape[1]
    h, a, z = np.empty((bones, bones)), np.empty((bones, bones)), np.empty(bones)
    chosen, w = np.empty(bones, dtype=np.int64), np.empty(bones)
    kept, old = np.empty(bones, dtype=np.int64), np.empty(bones)
    single, candidates = np.empty(bones), np.empty(bones, dtype=np.int64)
    near, normal, right = np.empty(bones), np.empty((3, 3)), np.empty(3)
    for v in range(len(rest)):
        x, y, q = rest[v, 0], rest[v, 1], rest[v, 2]
        for b in range(bones):
            s = seen[v, b]
            near[b] = s[0] * x + s[1] * y + s[2] * q + s[3]
        for b in range(bones):
            h[b, b] = _quadratic(products[b, b], x, y, q) - 2.0 * near[b] + squares[v]
            single[b] = h[b, b]
        n_candidates = _candidates(single, influences[v], weights[v], candidates)
        for i in range(n_candidates):
            for j in range(i):
                b, c = candidates[i], candidates[j]
                h[b, c] = h[c, b] = _quadratic(products[b, c], x, y, q) - near[b] - near[c] + squares[v]
        scale = max(squares[v], 1e-300)
        chosen[0], w[0] = candidates[0], 1.0
        n = _active_set(h, scale, candidates[:n_candidates], chosen, w, 1, bones, a, z)
        n = _sparsest(h, scale, chosen, w, most, n, a, z)
        # The weights of the round before, fitted again, are a second start: errors never grow.
        m = 0
        for i in range(most):
            if weights[v, i] > 0.0:
                kept[m], old[m] = influences[v, i], weights[v, i]
                m += 1
        if m > 0:
            m = _descend(h, kept, m, old, scale, a, z)
            m = _active_set(h, scale, candidates[:n_candidates], kept, old, m, most, a, z)
            if _value(h, kept, m, old) < _value(h, chosen, n, w):
                n = m
                for i in range(n):
                    chosen[i], w[i] = kept[i], old[i]
        for i in range(most):
            influences[v, i] = chosen[i] if i < n else chosen[0]
            weights[v, i] = w[i] if i < n else 0.0
        errors[v] = max(_value(h, chosen, n, w), 0.0)
        if free_rest:
            # Normal equations of sum_t |A_t r + b_t - x_t|^2, A_t and b_t the weighted means of the motions.
            for i in range(3):
                for j in range(3):
                    a3 = 0.0
                    for k in range(n):
                        for l in range(n):  # noqa: E741
                            a3 += w[k] * w[l] * products[chosen[k], chosen[l], i, j]
                    normal[i, j] = a3
            for i in range(3):
                total = 0.0
                for k in range(n):
                    total += w[k] * seen[v, chosen[k], i]
                    for l in range(n):  # noqa: E741
                        total -= w[k] * w[l] * products[chosen[k], chosen[l], i, 3]
                normal[i, i] += HELD * frames
                right[i] = total + HELD * frames * rest[v, i]
            solve(normal, right, 3)
            for i in range(3):
                rest[v, i] = right[i]


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


@dataclass(frozen=True, eq=False)
class Centred:
    """A centred sequence, and the positions of its frames."""

    header: SequenceHeader  # mesh and times
    points: Float  # (T, V, 3) in the file's units
    centres: Float  # (T, 3) mean of the points of every frame
    diagonal: float  # that of the first frame, or one

    @classmethod
    def of(cls, sequence: Frames) -> Centred:
        """Read a sequence into memory."""
        held = load_frames(sequence)
        points = np.asarray(held.points[: held.header.frame_count], dtype=np.float64)
        return cls(held.header, points, points.mean(axis=1), bounding_diagonal(points[0]) or 1.0)

    @property
    def frames(self) -> Float:
        """The points ``(T, V, 3)``, centred, in diagonals."""
        return (self.points - self.centres[:, None]) / self.diagonal

    @cached_property
    def tracks(self) -> Float:
        """The same as positions of every vertex ``(V, 3T)``, frame by frame."""
        return np.ascontiguousarray(self.frames.swapaxes(0, 1).reshape(self.header.vertex_count, -1))

    def skin(self, binding: Binding, motions: Float, skeleton: Skeleton, origin: Float) -> Skin:
        """Return a skin in the file's units: motions ``(B, 4, 3T)``; origin ``(3,)``."""
        order = np.argsort(-binding.weights, axis=1, kind="stable")
        weights = np.take_along_axis(binding.weights, order, axis=1)
        influences = np.take_along_axis(binding.influences, order, axis=1)
        m = motions.reshape(len(motions), 4, -1, 3).transpose(2, 0, 3, 1)  # (T, B, 3, 4)
        pivots = (skeleton.pivots - origin) / self.diagonal
        places = np.einsum("tbij,bj->tbi", m[..., :3], pivots) + m[..., 3]
        quaternions = Rotation.from_matrix(m[..., :3].reshape(-1, 3, 3)).as_quat().reshape(*m.shape[:2], 4)
        return Skin(
            header=self.header,
            rest=self.diagonal * binding.rest + origin,
            skeleton=skeleton,
            rotations=remove_sign_flips(quaternions),
            translations=self.diagonal * places + self.centres[:, None],
            influences=np.where(weights > 0, influences, 0),
            weights=weights,
            targets=np.zeros((0, len(weights), 3)),
            target_weights=np.zeros((len(m), 0)),
        )


def transposed(rotations: Float, translations: Float) -> Float:
    """Return rotations ``(T, 3, 3)`` and translations ``(T, 3)`` as a transposed motion ``(4, 3T)``."""
    whole = np.concatenate([rotations, translations[:, :, None]], axis=2)
    return whole.transpose(2, 0, 1).reshape(4, -1)


def on_rotations(motions: Float) -> Float:
    """Return transposed motions ``(B, 4, 3T)`` with the nearest rotations."""
    parts = motions.reshape(len(motions), 4, -1, 3).transpose(0, 2, 3, 1)  # (B, T, 3, 4)
    turns = nearest_rotations(parts[..., :3])
    return np.stack([transposed(turn, part[..., 3]) for turn, part in zip(turns, parts, strict=True)])


def motion_of(tracks: Float, rest: Float, vertices: Index) -> Float:
    """Return the best rigid motion ``(4, 3T)`` of some vertices."""
    some = tracks[vertices].reshape(len(vertices), -1, 3).swapaxes(0, 1)
    return transposed(*kabsch(rest[vertices], some))


def label_vertices(faces: Index, labels: Index, vertex_count: int) -> Index:
    """Return the most frequent label ``(V,)`` of triangles at a vertex, ties to the lowest; 0 where there is none."""
    votes = np.zeros((vertex_count, int(labels.max()) + 1), dtype=np.int64)
    np.add.at(votes, (faces.reshape(-1), np.repeat(labels, 3)), 1)
    return np.asarray(votes.argmax(axis=1), dtype=np.int64)


def merged(tracks: Float, labels: Index, count: int) -> Index:
    """Merge bones, in contact or not, down to `count`, first the pair whose common rigid motion costs least."""
    labels = np.unique(labels, return_inverse=True)[1]
    x = tracks.reshape(len(tracks), -1, 3)
    bones = int(labels.max()) + 1
    own = [x[labels == bone] for bone in range(bones)]
    sums = [moments(each[:, 0], each, np.ones(len(each))) for each in own]
    errors = np.array([each.error() for each in sums])
    left = list(range(bones))
    costs = np.full((bones, bones), np.inf)  # above the diagonal
    if bones > count:
        for i in range(bones - 1):
            costs[i, i + 1 :] = union_errors(sums[i], sums[i + 1 :]) - errors[i] - errors[i + 1 :]
    while len(left) > count:
        keep, drop = divmod(int(costs.argmin()), bones)
        labels[labels == drop] = keep
        left.remove(drop)
        sums[keep] += sums[drop]
        errors[keep] = sums[keep].error()
        costs[drop] = costs[:, drop] = np.inf
        others = np.array([bone for bone in left if bone != keep], dtype=np.int64)
        if others.size:
            unions = union_errors(sums[keep], [sums[bone] for bone in others])
            costs[np.minimum(keep, others), np.maximum(keep, others)] = unions - errors[keep] - errors[others]
    return np.asarray(np.unique(labels, return_inverse=True)[1], dtype=np.int64)


def seeded(tracks: Float, binding: Binding, count: int, size: int) -> Float:
    """Return motions ``(n, 4, 3T)`` of new bones at vertices of largest error, with the `size` nearest vertices."""
    errors = binding.errors.copy()
    found = []
    for _ in range(count):
        worst = int(errors.argmax())
        if errors[worst] <= 0:
            break
        off = tracks - tracks[worst]
        near = np.argpartition(np.einsum("vi,vi->v", off, off), min(size, len(off)) - 1)[:size]
        found.append(motion_of(tracks, binding.rest, np.sort(near)))
        errors[near] = 0.0
        errors[worst] = 0.0
    return np.stack(found) if found else np.zeros((0, 4, tracks.shape[1]))
