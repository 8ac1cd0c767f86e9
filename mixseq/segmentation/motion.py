r"""Segmentation by rigid motion: faces that rotate together form a part.

1. *Cluster.* Every cluster has one rigid motion per frame. Faces are assigned to the cluster with the least error
   (Lloyd's iteration), with errors averaged over neighbours for smooth boundaries. The patch with the largest error
   seeds the next cluster, until all exist. Dense meshes are first clustered by cells of faces.
2. *Connect.* Clusters are split into connected patches; small patches join the neighbour with the least error.
3. *Merge.* Neighbours with the least relative rotation are merged first, until every boundary bends enough (or the
   given number of parts is reached). The criterion is bending, as linear combinations of vertices are accurate for
   translations and small deformations, but shrink rotating shapes.

The result is deterministic, as no random numbers are used.

Deviations from rigid motion follow from additive sums (`Moments`). For vertices with weights w, rest positions h and
positions x_t in frame t, the error of the best rigid motion is

.. math:: E = \sum_t \Bigl( S^{xx}_t + S^{hh} - 2 \max_R \mathrm{tr}(R^T C_t) \Bigr), \qquad
          C_t = \sum w\, x_t h^T - \frac{1}{W} \bigl(\sum w\, x_t\bigr)\bigl(\sum w\, h\bigr)^T

with centred second moments S. The maximum is the sum of the singular values of C_t, where the last value has the sign
of det C_t (Kabsch 1976). The error of a union of disjoint sets follows from their added sums. In Lloyd's iteration,
moving elements updates the sums (`tally`), and costs of unchanged clusters are reused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from mixseq.mesh.rigid import largest_rotation, nearest_rotations
from mixseq.mesh.topology import Topology, split_labels
from mixseq.runtime.jit import compiled
from mixseq.segmentation.elements import (
    Elements,
    Rim,
    Trajectories,
    check_part_count,
    face_areas,
    renumber_by_area,
    sample_frames,
)
from mixseq.segmentation.still import segment_still
from mixseq.types import Float, FloatArray, Index, Int32, Mask, Single


@dataclass(frozen=True, eq=False)
class Moments:
    """Weighted sums over a set of vertices, for T frames."""

    weight: float  # sum of w
    rest: Float  # (3,) sum of w h
    posed: Float  # (T, 3) sum of w x_t
    rest_square: float  # sum of w |h|^2
    posed_square: Float  # (T,) sum of w |x_t|^2
    cross: Float  # (T, 3, 3) sum of w x_t h^T

    def __add__(self, other: Moments) -> Moments:
        return Moments(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(Moments)))

    @property
    def covariance(self) -> Float:
        """Centred cross moments ``(T, 3, 3)``, called C_t in the module docstring."""
        return self.cross - self.posed[:, :, None] * self.rest / max(self.weight, _SMALLEST_FLOAT)

    def errors(self) -> Float:
        """Weighted squared error ``(T,)`` of the best rigid motion in every frame."""
        weight = max(self.weight, _SMALLEST_FLOAT)
        posed = self.posed_square - np.einsum("ti,ti->t", self.posed, self.posed) / weight
        rest = self.rest_square - float(self.rest @ self.rest) / weight
        covariance = self.covariance
        traces = np.einsum("tij,tij->t", nearest_rotations(covariance), covariance)
        return np.asarray(np.maximum(posed + rest - 2.0 * traces, 0.0))

    def error(self) -> float:
        """Sum of `errors` over all frames."""
        return float(self.errors().sum())

    @property
    def softness(self) -> float:
        """Largest root mean square error in a frame, relative to the radius of gyration at rest."""
        rest = self.rest_square - float(self.rest @ self.rest) / max(self.weight, _SMALLEST_FLOAT)
        return float(np.sqrt(self.errors().max() / max(rest, _SMALLEST_FLOAT)))

    def motion(self) -> tuple[Float, Float]:
        """Rotation ``(T, 3, 3)`` and translation ``(T, 3)`` of the best rigid motion."""
        weight = max(self.weight, _SMALLEST_FLOAT)
        rotation = nearest_rotations(self.covariance)
        return rotation, (self.posed - rotation @ self.rest) / weight


_SMALLEST_FLOAT = np.finfo(np.float64).tiny


def moments(rest: Float, posed: Float, weights: Float) -> Moments:
    """Compute the moments of vertices with rest positions ``(N, 3)``, positions ``(N, T, 3)``, weights ``(N,)``."""
    weighted = posed * weights[:, None, None]
    return Moments(
        weight=float(weights.sum()),
        rest=weights @ rest,
        posed=weighted.sum(axis=0),
        rest_square=float(weights @ np.einsum("ni,ni->n", rest, rest)),
        posed_square=np.einsum("nti,nti->t", weighted, posed),
        cross=(weighted.reshape(len(rest), -1).T @ rest).reshape(-1, 3, 3),
    )


def union_errors(one: Moments, others: Sequence[Moments]) -> Float:
    """Return the errors ``(n,)`` of the unions of one set with each of n other sets: ``(one + other).error()``."""
    weight = np.maximum(one.weight + np.array([other.weight for other in others]), _SMALLEST_FLOAT)[:, None]
    rest = one.rest + np.stack([other.rest for other in others])
    posed = one.posed + np.stack([other.posed for other in others])
    squares = one.rest_square + np.array([other.rest_square for other in others])[:, None]
    squares = squares + one.posed_square + np.stack([other.posed_square for other in others])
    cross = one.cross + np.stack([other.cross for other in others])
    covariance = cross - posed[..., None] * (rest / weight)[:, None, None]
    means = np.einsum("nti,nti->nt", posed, posed) + np.einsum("ni,ni->n", rest, rest)[:, None]
    traces = np.einsum("ntij,ntij->nt", nearest_rotations(covariance), covariance)
    return np.asarray(np.maximum(squares - means / weight - 2.0 * traces, 0.0).sum(axis=1))


@compiled
def move_elements(
    elements: Index, source: Index, target: Index, corners: Int32, weights: Float, rows: Float, tallies: Float
) -> None:
    """Move elements ``(n,)`` between clusters ``(E,)`` (-1: no cluster), and update tallies ``(K, 4, D)`` in place.

    A vertex with weight w (an area in squared diagonals) and row y ``(D,)`` of `Trajectories`, which ends with
    ``h = (rest position, 1)``, adds ``w h y^T`` to the tally. Corners ``(E, 4)`` are padded with V.
    """
    width = rows.shape[1]
    for e in elements:
        k, l = target[e], source[e]  # noqa: E741
        for corner in corners[e]:
            if corner == len(rows):
                continue
            row = rows[corner]
            for i in range(4):
                factor = weights[e] * row[width - 4 + i]
                target_tally = tallies[k, i]
                for j in range(width):
                    target_tally[j] += factor * row[j]
                if l >= 0:
                    source_tally = tallies[l, i]
                    for j in range(width):
                        source_tally[j] -= factor * row[j]


@compiled
def squared_distances(posed: Single, rest: Single, motions: Single, result: Single) -> None:
    """Write mean squared distances ``(V, K)`` of ``(3T, V)`` from rest ``(3, V)`` moved by motions ``(K, 3T, 4)``."""
    chunk = 512  # vertices per chunk, so that inner loops fit into the cache
    sums = np.empty(chunk, dtype=np.float32)
    count = np.float32(len(posed) // 3)
    for start in range(0, posed.shape[1], chunk):
        end = min(start + chunk, posed.shape[1])
        h0, h1, h2 = rest[0, start:end], rest[1, start:end], rest[2, start:end]
        for k in range(len(motions)):
            m = motions[k]
            sums[:] = 0.0
            for i in range(0, len(posed), 3):
                a0, b0, c0, d0 = m[i, 0], m[i, 1], m[i, 2], m[i, 3]
                a1, b1, c1, d1 = m[i + 1, 0], m[i + 1, 1], m[i + 1, 2], m[i + 1, 3]
                a2, b2, c2, d2 = m[i + 2, 0], m[i + 2, 1], m[i + 2, 2], m[i + 2, 3]
                x, y, z = posed[i, start:end], posed[i + 1, start:end], posed[i + 2, start:end]
                for v in range(end - start):
                    p = x[v] - (a0 * h0[v] + b0 * h1[v] + c0 * h2[v] + d0)
                    q = y[v] - (a1 * h0[v] + b1 * h1[v] + c1 * h2[v] + d1)
                    r = z[v] - (a2 * h0[v] + b2 * h1[v] + c2 * h2[v] + d2)
                    sums[v] += p * p + q * q + r * r
            for v in range(end - start):
                result[start + v, k] = sums[v] / count


@compiled
def average_members(values: Single, members: Int32, factors: Single, result: Single) -> None:
    """Write the means ``(E, K)`` of values ``(n, K)`` over each element's members ``(E, m)``; padding has value 0."""
    for e in range(len(members)):
        a, b = values[members[e, 0]], values[members[e, 1]]
        c, d = values[members[e, 2]], values[members[e, 3]]
        mean, factor = result[e], factors[e]
        for k in range(len(mean)):  # four members at once, as faces have three neighbours
            mean[k] = (a[k] + b[k] + c[k] + d[k]) * factor
        for i in range(4, members.shape[1]):
            a = values[members[e, i]]
            for k in range(len(mean)):
                mean[k] += a[k] * factor


@compiled
def choose_lowest(costs: Single, labels: Index, lowest: Single) -> None:
    """Replace labels 0 and costs ``(E,)`` of the first of K clusters by the lowest of costs ``(K, E)``."""
    for k in range(1, len(costs)):
        row = costs[k]
        for e in range(len(row)):  # without branches, for vectorised loops
            is_lower = row[e] < lowest[e]
            labels[e] = k if is_lower else labels[e]
            lowest[e] = row[e] if is_lower else lowest[e]


_COLUMN_MULTIPLE = 8  # columns are padded to a multiple, for vectorised loops over clusters
_MAX_WORK_NUMBERS = 1 << 22  # entries in an array of costs with more than `_COLUMN_MULTIPLE` columns
_MAX_TALLY_NUMBERS = 1 << 22  # entries in rows of trajectories of several frames


class Clusters:
    """Elements in at most `capacity` clusters."""

    def __init__(self, elements: Elements, labels: Index, capacity: int) -> None:
        self.labels = labels
        self._elements = elements
        self._tallies = tally(elements, labels, capacity)
        self._sizes = np.bincount(labels, minlength=capacity)
        self._stale = self._sizes > 0
        self._rounds = -1
        longest = 1 + max(len(elements), elements.trajectories.coordinates.shape[1])
        self._batch_size = max(
            _COLUMN_MULTIPLE,
            min(capacity + _COLUMN_MULTIPLE - 1, _MAX_WORK_NUMBERS // longest) // _COLUMN_MULTIPLE * _COLUMN_MULTIPLE,
        )
        self._work = np.empty((3, longest * self._batch_size), dtype=np.float32)
        self._costs = np.full((capacity, len(elements)), np.inf, dtype=np.float32)

    def assign(self, rounds: int) -> Single:
        """Assign elements to clusters of lowest cost, averaged over neighbours `rounds` times; return it ``(E,)``."""
        stale = np.flatnonzero(self._sizes > 0 if rounds != self._rounds else self._stale)
        self._rounds = rounds
        self._stale[:] = False
        for start in range(0, len(stale), self._batch_size):
            batch = stale[start : start + self._batch_size]
            self._costs[batch] = self._average_costs(batch, rounds)[: len(self.labels), : len(batch)].T
        labels, lowest = np.zeros(len(self.labels), dtype=np.int64), self._costs[0].copy()
        choose_lowest(self._costs[: np.flatnonzero(self._sizes)[-1] + 1], labels, lowest)
        self._move(labels)
        return np.asarray(lowest)

    def seed(self, members: Index, cluster: int) -> None:
        """Move elements to a cluster."""
        labels = self.labels.copy()
        labels[members] = cluster
        self._move(labels)

    def _move(self, labels: Index) -> None:
        moved = np.flatnonzero(labels != self.labels)
        e = self._elements
        previous_weights = self._tallies[:, 3, -1].copy()
        move_elements(moved, self.labels, labels, e.corners, e.weights, e.trajectories.rows, self._tallies)
        self._stale[self.labels[moved]] = self._stale[labels[moved]] = True
        self.labels = labels
        self._sizes = np.bincount(labels, minlength=len(self._sizes))
        # Recompute tallies that became small by subtraction, as their rounding errors are large.
        for cluster in np.flatnonzero(self._stale & (self._tallies[:, 3, -1] < 1e-3 * previous_weights)):
            self._tallies[cluster] = tally(e, labels, len(self._sizes), labels == cluster)[cluster]
        for empty in np.flatnonzero((self._sizes == 0) & self._stale):
            self._stale[empty] = False
            self._costs[empty] = np.inf

    def _average_costs(self, clusters: Index, rounds: int) -> Single:
        """Return the costs ``(E, n)`` of elements in the given clusters, averaged over neighbours."""
        e = self._elements
        x = e.trajectories.coordinates
        width = -(-len(clusters) // _COLUMN_MULTIPLE) * _COLUMN_MULTIPLE
        motions = motions_of(self._tallies[clusters], e.trajectories).astype(np.float32)
        costs, averaged = (self._work[i, : (len(e) + 1) * width].reshape(len(e) + 1, width) for i in range(2))
        per_vertex = self._work[2, : (x.shape[1] + 1) * width].reshape(x.shape[1] + 1, width)
        costs[-1] = averaged[-1] = per_vertex[-1] = 0.0  # rows of padding
        per_vertex[:, len(clusters) :] = 0.0
        squared_distances(x, x[:3], motions, per_vertex[:-1])
        average_members(per_vertex, e.corners, e.corner_factors, costs)
        for _ in range(rounds):
            average_members(costs, e.neighbourhoods, e.factors, averaged)
            costs, averaged = averaged, costs
        return costs


def tally(elements: Elements, labels: Index, count: int, mask: Mask | None = None) -> Float:
    """Sum ``w h y^T`` ``(count, 4, 4T + 4)`` over the vertices of (masked) elements with each label."""
    frames, vertices = elements.trajectories.x.shape[:2]
    tallies = np.zeros((count, 4, 4 * frames + 4))
    ids = np.arange(len(elements)) if mask is None else np.flatnonzero(mask)
    size = max(_MAX_TALLY_NUMBERS // (4 * vertices), 1)
    for start in range(0, frames, size):  # sums of frames are independent
        block = slice(start, min(start + size, frames))
        rows = elements.trajectories.rows if size >= frames else elements.trajectories.frame_rows(block)
        sums = np.zeros((count, 4, rows.shape[1]))
        move_elements(ids, np.full(len(elements), -1), labels, elements.corners, elements.weights, rows, sums)
        width = block.stop - block.start
        tallies[:, :, 3 * block.start : 3 * block.stop] = sums[:, :, : 3 * width]
        tallies[:, :, 3 * frames + block.start : 3 * frames + block.stop] = sums[:, :, 3 * width : 4 * width]
        tallies[:, :, -4:] = sums[:, :, -4:]
    return tallies


def motions_of(tallies: Float, trajectories: Trajectories) -> Float:
    """Return the best rigid motions ``(K, 3T, 4)`` of clusters: rotations and translations side by side."""
    count, frames = len(tallies), trajectories.frame_count
    sums = tallies[:, :, : 3 * frames].reshape(count, 4, frames, 3)
    cross, posed = sums[:, :3].transpose(0, 2, 3, 1), sums[:, 3]
    rest = tallies[:, 3, -4:-1]
    weight = np.maximum(tallies[:, 3, -1], _SMALLEST_FLOAT)[:, None, None]
    rotations = nearest_rotations(cross - posed[..., None] * (rest / weight[:, 0])[:, None, None])
    translations = (posed - np.einsum("ktij,kj->kti", rotations, rest)) / weight
    return np.concatenate([rotations, translations[..., None]], axis=3).reshape(count, 3 * frames, 4)


def moments_of(tallies: Float, trajectories: Trajectories) -> list[Moments]:
    """Return the moments of clusters."""
    frames = trajectories.frame_count
    return [
        Moments(
            weight=float(sums[3, -1]),
            rest=sums[3, -4:-1],
            posed=sums[3, : 3 * frames].reshape(frames, 3),
            rest_square=float(np.trace(sums[:3, -4:-1])),
            posed_square=sums[3, 3 * frames : 4 * frames],
            cross=sums[:3, : 3 * frames].reshape(3, frames, 3).transpose(1, 2, 0),
        )
        for sums in tallies
    ]


MAX_FACES_WITHOUT_CELLS = 20_000  # larger meshes are clustered by cells first
MAX_FACES_TO_REFINE = 160_000  # larger meshes are clustered by cells only; boundaries are wrong by at most an edge


@dataclass(frozen=True)
class MotionSettings:
    """Settings of `segment_by_motion`.

    Attributes
    ----------
    clusters : int
        Number of initial clusters, which are merged to parts.
    frames : int
        Number of frames, evenly spread over the sequence.
    smoothing : float
        Rounds of averaging costs over neighbouring faces, per square root of the number of faces, so that
        boundaries are equally smooth on coarse and on dense meshes.
    bend : float
        A boundary is kept if the relative rotation of the patches at it, between any two frames, exceeds this angle in
        degrees.
    narrow : float
        Largest fraction by which `bend` is raised at patches that are too narrow for their joints. Such patches are
        bending skin.
    soft, stiff : float
        A patch softer than `soft` joins a neighbour if the union is stiffer than `stiff`. Softness is the largest root
        mean square rigid error in a frame, relative to the radius of gyration.
    small_region : float
        Patches below this fraction of the faces join a neighbour.
    """

    clusters: int = 23
    frames: int = 24
    smoothing: float = 0.1
    bend: float = 20.0
    narrow: float = 1.0
    soft: float = 0.5
    stiff: float = 0.35
    small_region: float = 0.003


def segment_by_motion(
    points: FloatArray, topology: Topology, parts: int | None = None, settings: MotionSettings | None = None
) -> Index:
    """Find the near-rigid part ``(F,)`` of every face from points ``(T, V, 3)``."""
    settings = settings or MotionSettings()
    check_part_count(parts, topology)
    x = sample_frames(points, settings.frames)
    if len(x) == 1:  # nothing moves
        areas = face_areas(x[0], topology)
        return renumber_by_area(segment_still(x[0], topology, areas, parts or 1), areas)
    areas, trajectories = face_areas(x[0], topology), Trajectories(x)
    clusters = max(settings.clusters, round(1.5 * (parts or 1)))
    labels = _cluster(topology, trajectories, areas, min(clusters, len(topology.faces)), settings)
    faces = Elements.from_faces(topology, trajectories, areas)
    patches = _Patches.from_labels(topology, faces, split_labels(topology, labels))
    _merge_small_patches(patches, settings)
    _merge_stiff_pairs(patches, topology, parts, settings)
    return renumber_by_area(patches.labels, faces.weights)


def _cluster(
    topology: Topology, trajectories: Trajectories, areas: Float, count: int, settings: MotionSettings
) -> Index:
    """Cluster faces by Lloyd's iteration with an increasing number of clusters, on cells if the mesh is dense."""
    rounds = settings.smoothing * len(areas) ** 0.5
    if len(areas) <= MAX_FACES_WITHOUT_CELLS:
        return _relax(_grow_clusters(Elements.from_faces(topology, trajectories, areas), count, rounds), rounds, 4)
    cells, cell_of_face = Elements.from_cells(topology, trajectories, areas)
    cell_rounds = rounds * len(cells) / len(areas)
    labels = _relax(_grow_clusters(cells, count, cell_rounds), cell_rounds, 4)[cell_of_face]
    if len(areas) > MAX_FACES_TO_REFINE:
        return labels
    return _relax(Clusters(Elements.from_faces(topology, trajectories, areas), labels, count), rounds, 2)


def _grow_clusters(elements: Elements, count: int, rounds: float) -> Clusters:
    """Add clusters one at a time, each seeded at the element of largest cost, with few rounds of averaging."""
    seed_size = max(4, len(elements) // (6 * count))
    few_rounds = 1 + max(1, round(rounds)) // 4
    clusters = Clusters(elements, np.zeros(len(elements), dtype=np.int64), count)
    for cluster in range(1, count):
        costs = clusters.assign(few_rounds)
        clusters.seed(elements.ball(int(np.argmax(costs)), seed_size), cluster)
        clusters.assign(few_rounds)
    return clusters


def _relax(clusters: Clusters, rounds: float, iterations: int) -> Index:
    """Reassign all elements `iterations` times, by costs averaged `rounds` times over neighbours."""
    for _ in range(iterations):
        clusters.assign(max(1, round(rounds)))
    return clusters.labels


@dataclass(eq=False)
class _Patches:
    """Patches of faces that are merged step by step."""

    labels: Index  # (F,) patch of every face
    moments: dict[int, Moments]  # moments of every remaining patch
    sizes: dict[int, int]  # number of faces of every remaining patch
    neighbours: dict[int, set[int]]

    @classmethod
    def from_labels(cls, topology: Topology, faces: Elements, labels: Index) -> _Patches:
        count = int(labels.max()) + 1
        moments = moments_of(tally(faces, labels, count), faces.trajectories)
        neighbours: dict[int, set[int]] = {p: set() for p in range(count)}
        i, j = labels[topology.hinge_faces].T
        for pair in np.unique(np.minimum(i, j)[i != j] * count + np.maximum(i, j)[i != j]).tolist():
            low, high = divmod(pair, count)
            neighbours[low].add(high)
            neighbours[high].add(low)
        sizes = np.bincount(labels, minlength=count).tolist()
        return cls(labels, dict(enumerate(moments)), dict(enumerate(sizes)), neighbours)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of neighbouring patches, lower number first."""
        return [(p, q) for p, neighbours in self.neighbours.items() for q in neighbours if p < q]

    def merge(self, keep: int, drop: int) -> None:
        """Move all faces of a patch to another one."""
        self.labels[self.labels == drop] = keep
        self.moments[keep] += self.moments.pop(drop)
        self.sizes[keep] += self.sizes.pop(drop)
        for neighbour in self.neighbours.pop(drop):
            self.neighbours[neighbour].discard(drop)
            if neighbour != keep:
                self.neighbours[neighbour].add(keep)
                self.neighbours[keep].add(neighbour)


def _merge_small_patches(patches: _Patches, settings: MotionSettings) -> None:
    """Merge small patches, smallest first, into the neighbour for which the rigid error increases least."""
    min_size = max(4, round(settings.small_region * len(patches.labels)))
    moments = patches.moments
    while True:
        small = [(size, p) for p, size in patches.sizes.items() if size < min_size and patches.neighbours[p]]
        if not small:
            return
        drop = min(small)[1]
        keep = min(
            patches.neighbours[drop], key=lambda n: ((moments[n] + moments[drop]).error() - moments[n].error(), n)
        )
        patches.merge(keep, drop)


def _merge_stiff_pairs(patches: _Patches, topology: Topology, parts: int | None, settings: MotionSettings) -> None:
    """Merge the neighbours that bend least, until `parts` patches remain or every boundary bends enough."""
    moments = patches.moments
    rotations = {p: m.motion()[0] for p, m in moments.items()}
    softness = {p: m.softness for p, m in moments.items()}
    bends: dict[tuple[int, int], float] = {}
    pair_softness: dict[tuple[int, int], float] = {}
    rim = Rim.from_labels(topology, patches.labels)
    while parts is None or len(moments) > parts:
        pairs = patches.pairs
        if not pairs:
            break
        for i, j in set(pairs) - bends.keys():
            bends[i, j] = largest_rotation(rotations[i], rotations[j])
        bends = {pair: bends[pair] for pair in pairs}
        narrow = rim.narrowness(patches.labels)
        costs = {(i, j): b / (1.0 + settings.narrow * max(narrow[i], narrow[j])) for (i, j), b in bends.items()}
        for i, j in bends:
            if max(softness[i], softness[j]) > settings.soft:
                pair_softness[i, j] = pair_softness.get((i, j)) or (moments[i] + moments[j]).softness
                if pair_softness[i, j] < settings.stiff:
                    costs[i, j] = 0.0
        keep, drop = min(costs, key=lambda pair: (costs[pair], bends[pair], pair))
        if parts is None and costs[keep, drop] > settings.bend:
            break
        patches.merge(keep, drop)
        rotations[keep] = moments[keep].motion()[0]
        softness[keep] = moments[keep].softness
        bends = {pair: b for pair, b in bends.items() if not {keep, drop} & {*pair}}
        pair_softness = {pair: s for pair, s in pair_softness.items() if not {keep, drop} & {*pair}}
