r"""Segmentation by rigid motion: faces that rotate together form a part.

1. *Cluster.* Every cluster has one rigid motion per frame; faces go to the cluster that predicts them best
   (Lloyd's iteration), after costs are diffused over the surface for smooth boundaries. The worst predicted patch
   seeds the next cluster, until there are enough. Dense meshes are clustered by cells of faces first.
2. *Connect.* Clusters are split into connected patches; small regions join the neighbour that predicts them best.
3. *Merge.* Neighbours are merged, those with the least relative rotation first, until every boundary bends enough
   (or the given number of parts is reached). Bending is the measure because vertices of a part are combined linearly,
   which suits slides and small deformations, but shortens what rotates.

The result is deterministic: there are no random numbers.

Deviations from rigid motion follow from additive sums (`Moments`). For vertices with weights w, rest positions h and
positions x_t in frame t, the error of the best rigid motion is

.. math:: E = \sum_t \Bigl( S^{xx}_t + S^{hh} - 2 \max_R \mathrm{tr}(R^T C_t) \Bigr), \qquad
          C_t = \sum w\, x_t h^T - \frac{1}{W} \bigl(\sum w\, x_t\bigr)\bigl(\sum w\, h\bigr)^T

with centred second moments S. The maximum is the sum of the singular values of C_t, the last one with the sign
of det C_t (Kabsch 1976). All sums are additive over disjoint sets: the error of a union needs no vertices. In Lloyd's
iteration moving elements take their sums along (`tally`), and costs of unchanged clusters are reused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mixseq.mesh.rigid import largest_rotation, nearest_rotations
from mixseq.mesh.topology import Topology, split_labels
from mixseq.segmentation.elements import Elements, Rim, Trajectories, check_part_count, renumber_by_area
from mixseq.segmentation.joints import sample_frame_ids
from mixseq.types import Float, FloatArray, Index, Mask, Single


@dataclass(frozen=True, eq=False)
class Moments:
    """Weighted sums over a set of vertices, for T frames."""

    weight: float  # sum of w
    rest: Float  # (3,) sum of w h
    moved: Float  # (T, 3) sum of w x_t
    rest_square: float  # sum of w |h|^2
    moved_square: Float  # (T,) sum of w |x_t|^2
    cross: Float  # (T, 3, 3) sum of w x_t h^T

    def __add__(self, other: Moments) -> Moments:
        return Moments(
            weight=self.weight + other.weight,
            rest=self.rest + other.rest,
            moved=self.moved + other.moved,
            rest_square=self.rest_square + other.rest_square,
            moved_square=self.moved_square + other.moved_square,
            cross=self.cross + other.cross,
        )

    @property
    def covariance(self) -> Float:
        """Centred cross moments ``(T, 3, 3)``, the C_t above."""
        return self.cross - self.moved[:, :, None] * self.rest / max(self.weight, _TINY)

    def errors(self) -> Float:
        """Weighted squared error ``(T,)`` of the best rigid motion of every frame."""
        weight = max(self.weight, _TINY)
        moved = self.moved_square - np.einsum("ti,ti->t", self.moved, self.moved) / weight
        rest = self.rest_square - float(self.rest @ self.rest) / weight
        covariance = self.covariance
        traces = np.einsum("tij,tij->t", nearest_rotations(covariance), covariance)
        return np.asarray(np.maximum(moved + rest - 2.0 * traces, 0.0))

    def error(self) -> float:
        """Sum of `errors` over all frames."""
        return float(self.errors().sum())

    @property
    def softness(self) -> float:
        """Largest error of a frame, root mean square, relative to the radius of gyration at rest."""
        rest = self.rest_square - float(self.rest @ self.rest) / max(self.weight, _TINY)
        return float(np.sqrt(self.errors().max() / max(rest, _TINY)))

    def motion(self) -> tuple[Float, Float]:
        """Rotation ``(T, 3, 3)`` and translation ``(T, 3)`` of the best rigid motion."""
        weight = max(self.weight, _TINY)
        rotation = nearest_rotations(self.covariance)
        return rotation, (self.moved - rotation @ self.rest) / weight


_TINY = np.finfo(np.float64).tiny


def moments(rest: Float, moved: Float, weights: Float) -> Moments:
    """Gather the moments of vertices with rest positions ``(N, 3)``, positions ``(N, T, 3)``, weights ``(N,)``."""
    weighted = moved * weights[:, None, None]
    return Moments(
        weight=float(weights.sum()),
        rest=weights @ rest,
        moved=weighted.sum(axis=0),
        rest_square=float(weights @ np.einsum("ni,ni->n", rest, rest)),
        moved_square=np.einsum("nti,nti->t", weighted, moved),
        cross=(weighted.reshape(len(rest), -1).T @ rest).reshape(-1, 3, 3),
    )


def union_errors(one: Moments, others: Sequence[Moments]) -> Float:
    """Return the errors ``(n,)`` of the unions of a set with each of n others, ``(one + other).error()``, at once."""
    weight = np.maximum(one.weight + np.array([other.weight for other in others]), _TINY)[:, None]
    rest = one.rest + np.stack([other.rest for other in others])
    moved = one.moved + np.stack([other.moved for other in others])
    squares = one.rest_square + np.array([other.rest_square for other in others])[:, None]
    squares = squares + one.moved_square + np.stack([other.moved_square for other in others])
    cross = one.cross + np.stack([other.cross for other in others])
    covariance = cross - moved[..., None] * (rest / weight)[:, None, None]
    means = np.einsum("nti,nti->nt", moved, moved) + np.einsum("ni,ni->n", rest, rest)[:, None]
    traces = np.einsum("ntij,ntij->nt", nearest_rotations(covariance), covariance)
    return np.asarray(np.maximum(squares - means / weight - 2.0 * traces, 0.0).sum(axis=1))


_LANES = 8  # columns of costs computed at a time
_WORK = 1 << 24  # numbers in an array of costs, unless `_LANES` columns have more


class Clusters:
    """Elements in at most `capacity` clusters."""

    def __init__(self, elements: Elements, labels: Index, capacity: int) -> None:
        self.labels = labels
        self._elements = elements
        self._tallies = tally(elements, labels, capacity)
        self._sizes = np.bincount(labels, minlength=capacity)
        self._stale = self._sizes > 0
        self._rounds = -1
        longest = 1 + max(len(elements), elements.trajectories.moved.shape[1])
        self._at_once = max(_LANES, min(capacity + _LANES - 1, _WORK // longest) // _LANES * _LANES)
        self._work = np.empty((3, longest * self._at_once), dtype=np.float32)
        self._costs = np.full((len(elements), capacity), np.inf, dtype=np.float32)

    def assign(self, rounds: int) -> Single:
        """Assign every element to the cluster of lowest cost ``(E,)``, averaged `rounds` times over neighbours."""
        from mixseq.segmentation.segmentation_kernels import cheapest

        stale = np.flatnonzero(self._sizes > 0 if rounds != self._rounds else self._stale)
        self._rounds = rounds
        self._stale[:] = False
        labels, lowest = np.empty_like(self.labels), np.empty(len(self.labels), dtype=np.float32)
        for start in range(0, max(len(stale), 1), self._at_once):
            some = stale[start : start + self._at_once]
            cheapest(self._diffused(some, rounds), some, self._costs, labels, lowest)
        self._move(labels)
        return lowest

    def seed(self, members: Index, cluster: int) -> None:
        """Move elements to a cluster."""
        labels = self.labels.copy()
        labels[members] = cluster
        self._move(labels)

    def _move(self, labels: Index) -> None:
        from mixseq.segmentation.segmentation_kernels import transfer

        moved = np.flatnonzero(labels != self.labels)
        e = self._elements
        before = self._tallies[:, 3, -1].copy()
        transfer(moved, self.labels, labels, e.corners, e.weights, e.trajectories.rows, self._tallies)
        self._stale[self.labels[moved]] = self._stale[labels[moved]] = True
        self.labels = labels
        self._sizes = np.bincount(labels, minlength=len(self._sizes))
        # What is left of almost all is rounding: look again.
        for cluster in np.flatnonzero(self._stale & (self._tallies[:, 3, -1] < 1e-3 * before)):
            self._tallies[cluster] = tally(e, labels, len(self._sizes), labels == cluster)[cluster]
        for empty in np.flatnonzero((self._sizes == 0) & self._stale):
            self._stale[empty] = False
            self._costs[:, empty] = np.inf

    def _diffused(self, clusters: Index, rounds: int) -> Single:
        """Costs ``(E, n)`` of clusters, averaged over neighbours."""
        from mixseq.segmentation.segmentation_kernels import averages, squared_distances

        e = self._elements
        moved = e.trajectories.moved
        width = -(-len(clusters) // _LANES) * _LANES
        motions = motions_of(self._tallies[clusters], e.trajectories).astype(np.float32)
        costs, spare = (self._work[i, : (len(e) + 1) * width].reshape(len(e) + 1, width) for i in range(2))
        per_vertex = self._work[2, : (moved.shape[1] + 1) * width].reshape(moved.shape[1] + 1, width)
        costs[-1] = spare[-1] = per_vertex[-1] = 0.0  # of elements and vertices that are none
        per_vertex[:, len(clusters) :] = 0.0
        squared_distances(moved, moved[:3], motions, per_vertex[:-1])
        averages(per_vertex, e.corners, e.corner_factors, costs)
        for _ in range(rounds):
            averages(costs, e.around, e.factors, spare)
            costs, spare = spare, costs
        return costs


def tally(elements: Elements, labels: Index, count: int, counted: Mask | None = None) -> Float:
    """Sum ``w h y^T`` ``(count, 4, 4T + 4)`` over the vertices of the (counted) elements with each label."""
    from mixseq.segmentation.segmentation_kernels import transfer

    rows = elements.trajectories.rows
    tallies = np.zeros((count, 4, rows.shape[1]))
    chosen = np.arange(len(elements)) if counted is None else np.flatnonzero(counted)
    transfer(chosen, np.full(len(elements), -1), labels, elements.corners, elements.weights, rows, tallies)
    return tallies


def motions_of(tallies: Float, trajectories: Trajectories) -> Float:
    """Return the best rigid motions ``(K, 3T, 4)``, rotations and translations, of clusters."""
    count, frames = len(tallies), trajectories.frame_count
    sums = tallies[:, :, : 3 * frames].reshape(count, 4, frames, 3)
    cross, moved = sums[:, :3].transpose(0, 2, 3, 1), sums[:, 3]
    rest = tallies[:, 3, -4:-1]
    weight = np.maximum(tallies[:, 3, -1], _TINY)[:, None, None]
    rotations = nearest_rotations(cross - moved[..., None] * (rest / weight[:, 0])[:, None, None])
    translations = (moved - np.einsum("ktij,kj->kti", rotations, rest)) / weight
    return np.concatenate([rotations, translations[..., None]], axis=3).reshape(count, 3 * frames, 4)


def moments_of(tallies: Float, trajectories: Trajectories) -> list[Moments]:
    """Return the moments of clusters."""
    frames = trajectories.frame_count
    return [
        Moments(
            weight=float(sums[3, -1]),
            rest=sums[3, -4:-1],
            moved=sums[3, : 3 * frames].reshape(frames, 3),
            rest_square=float(np.trace(sums[:3, -4:-1])),
            moved_square=sums[3, 3 * frames : 4 * frames],
            cross=sums[:3, : 3 * frames].reshape(3, frames, 3).transpose(1, 2, 0),
        )
        for sums in tallies
    ]


DENSE = 20000
"""Number of faces above which meshes are clustered by cells first."""

LARGE = 160_000
"""Number of faces above which meshes are clustered by cells alone: borders are off by at most an edge."""


@dataclass(frozen=True)
class MotionSettings:
    """Settings of `segment_by_motion`.

    Attributes
    ----------
    clusters : int
        Number of initial clusters, from which parts are merged.
    frames : int
        Number of frames, evenly spread over the sequence.
    smoothing : float
        Rounds of averaging costs over neighbouring faces, per square root of the number of faces, so that
        boundaries are equally smooth on coarse and on dense meshes.
    bend : float
        A boundary stays if its sides rotate against each other by more than this between any two frames, in
        degrees ...
    narrow : float
        ... and by up to this fraction more where a side is so narrow that its joints would take all of it:
        such patches are bending skin.
    soft, stiff : float
        A patch softer than `soft` joins a neighbour with which it is stiffer than `stiff`, if there is one.
        Softness is the largest rigid error of a frame, root mean square, relative to the radius of gyration.
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
    points: FloatArray,
    topology: Topology,
    parts: int | None = None,
    settings: MotionSettings | None = None,
) -> Index:
    """Find the near-rigid part ``(F,)`` of every face from points ``(T, V, 3)``."""
    settings = settings or MotionSettings()
    check_part_count(parts, topology)
    faces = Elements.from_faces(topology, _looked_at(points, settings.frames))
    clusters = max(settings.clusters, round(1.5 * (parts or 1)))
    labels = _cluster(topology, faces, min(clusters, len(topology.faces)), settings)
    bodies = _Bodies.from_patches(topology, faces, split_labels(topology, labels))
    _absorb_small_regions(bodies, settings)
    _merge(bodies, topology, parts, settings)
    return renumber_by_area(bodies.patches, faces.weights)


def _looked_at(points: FloatArray, frames: int) -> Float:
    """Return sampled frames ``(T, V, 3)``, centred, in diagonals of the first, or else of the largest."""
    x = points[sample_frame_ids(len(points), frames)].astype(np.float64)
    x -= x.mean(axis=1, keepdims=True)
    diagonals = np.linalg.norm(np.ptp(x, axis=1), axis=1)
    x /= diagonals[0] or diagonals.max() or 1.0
    return x


def _cluster(topology: Topology, faces: Elements, count: int, settings: MotionSettings) -> Index:
    """Cluster faces by Lloyd's iteration with one more cluster at a time; only the end uses fully diffused costs.

    Dense meshes are clustered by cells first, large ones by cells alone.
    """
    rounds = settings.smoothing * len(faces) ** 0.5
    if len(faces) <= DENSE:
        return _settled(_grown(faces, count, rounds), rounds, 4)
    cells, cell_of_face = Elements.from_cells(topology, faces)
    rounds_of_cells = rounds * len(cells) / len(faces)
    labels = _settled(_grown(cells, count, rounds_of_cells), rounds_of_cells, 4)[cell_of_face]
    return labels if len(faces) > LARGE else _settled(Clusters(faces, labels, count), rounds, 2)


def _grown(elements: Elements, count: int, rounds: float) -> Clusters:
    """Add one cluster at a time, seeded at the worst predicted elements."""
    seed_size = max(4, len(elements) // (6 * count))
    few = 1 + max(1, round(rounds)) // 4
    clusters = Clusters(elements, np.zeros(len(elements), dtype=np.int64), count)
    for cluster in range(1, count):
        own = clusters.assign(few)
        clusters.seed(elements.ball(int(np.argmax(own)), seed_size), cluster)
        clusters.assign(few)
    return clusters


def _settled(clusters: Clusters, rounds: float, times: int) -> Index:
    """Reassign all elements several times, by costs averaged over `rounds` rounds."""
    for _ in range(times):
        clusters.assign(max(1, round(rounds)))
    return clusters.labels


@dataclass(eq=False)
class _Bodies:
    """Patches of faces that are merged step by step."""

    patches: Index  # (F,) patch of every face
    moments: dict[int, Moments]  # moments of every remaining patch
    sizes: dict[int, int]  # number of its faces
    neighbours: dict[int, set[int]]  # neighbours of every patch

    @classmethod
    def from_patches(cls, topology: Topology, faces: Elements, patches: Index) -> _Bodies:
        count = int(patches.max()) + 1
        moments = moments_of(tally(faces, patches, count), faces.trajectories)
        neighbours: dict[int, set[int]] = {p: set() for p in range(count)}
        i, j = patches[topology.hinge_faces].T
        for border in np.unique(np.minimum(i, j)[i != j] * count + np.maximum(i, j)[i != j]).tolist():
            low, high = divmod(border, count)
            neighbours[low].add(high)
            neighbours[high].add(low)
        sizes = np.bincount(patches, minlength=count).tolist()
        return cls(patches, dict(enumerate(moments)), dict(enumerate(sizes)), neighbours)

    @property
    def borders(self) -> list[tuple[int, int]]:
        """Pairs of neighbouring patches, lower number first."""
        return [(p, q) for p, beside in self.neighbours.items() for q in beside if p < q]

    def merge(self, keep: int, drop: int) -> None:
        """Move all faces of a patch to another one, in place."""
        self.patches[self.patches == drop] = keep
        self.moments[keep] += self.moments.pop(drop)
        self.sizes[keep] += self.sizes.pop(drop)
        for beside in self.neighbours.pop(drop):
            self.neighbours[beside].discard(drop)
            if beside != keep:
                self.neighbours[beside].add(keep)
                self.neighbours[keep].add(beside)


def _absorb_small_regions(bodies: _Bodies, settings: MotionSettings) -> None:
    """Merge small patches, the smallest first, into the neighbour with the least growth of the rigid error."""
    smallest = max(4, round(settings.small_region * len(bodies.patches)))
    moments = bodies.moments
    while True:
        small = [(size, p) for p, size in bodies.sizes.items() if size < smallest and bodies.neighbours[p]]
        if not small:
            return
        region = min(small)[1]
        into = min(
            bodies.neighbours[region],
            key=lambda n: ((moments[n] + moments[region]).error() - moments[n].error(), n),
        )
        bodies.merge(into, region)


def _merge(bodies: _Bodies, topology: Topology, parts: int | None, settings: MotionSettings) -> None:
    """Merge neighbours, the stiffest pair first, until `parts` are left or every boundary bends enough."""
    moments = bodies.moments
    turns = {p: m.motion()[0] for p, m in moments.items()}
    softness = {p: m.softness for p, m in moments.items()}
    bends: dict[tuple[int, int], float] = {}
    joined: dict[tuple[int, int], float] = {}  # softness of pairs
    rim = Rim.from_labels(topology, bodies.patches)
    while parts is None or len(moments) > parts:
        bends = {(i, j): bends.get((i, j), -1.0) for i, j in bodies.borders}
        if not bends:
            break
        bends = {(i, j): b if b >= 0 else largest_rotation(turns[i], turns[j]) for (i, j), b in bends.items()}
        narrow = rim.narrowness(bodies.patches)
        worth = {
            (i, j): b / (1.0 + settings.narrow * max(narrow[i], narrow[j])) for (i, j), b in bends.items()
        }
        for i, j in bends:
            if max(softness[i], softness[j]) > settings.soft:
                joined[i, j] = joined.get((i, j)) or (moments[i] + moments[j]).softness
                if joined[i, j] < settings.stiff:
                    worth[i, j] = 0.0
        keep, drop = min(worth, key=lambda pair: (worth[pair], bends[pair], pair))
        if parts is None and worth[keep, drop] > settings.bend:
            break
        bodies.merge(keep, drop)
        turns[keep] = moments[keep].motion()[0]
        softness[keep] = moments[keep].softness
        bends = {pair: b for pair, b in bends.items() if keep not in pair and drop not in pair}
        joined = {pair: s for pair, s in joined.items() if keep not in pair and drop not in pair}
