"""Segmentation by rigid motion: faces that rotate together form a part.

1. *Cluster.* Every cluster has one rigid motion per frame; faces go to the cluster that predicts them best
   (Lloyd's iteration), after costs are diffused over the surface for smooth boundaries. The worst predicted patch
   seeds the next cluster, until there are enough. Dense meshes are clustered by cells of faces first.
2. *Connect.* Clusters are split into connected patches; small regions join the neighbour that predicts them best.
3. *Merge.* Neighbours are merged, those with the least relative rotation first, until every boundary bends enough
   (or the given number of parts is reached). Bending is the measure because vertices of a part are combined linearly,
   which suits slides and small deformations, but shortens what rotates.

The result is deterministic: there are no random numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.geometry.rigid import bend
from mixseq.segmentation.boundaries import Rim
from mixseq.segmentation.clusters import Clusters, moments_of, tally
from mixseq.segmentation.elements import Elements
from mixseq.segmentation.growing import by_area, check_parts
from mixseq.segmentation.observed import frames_to_look_at
from mixseq.segmentation.rigid_error import Moments
from mixseq.topology import Topology, split_labels

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
    check_parts(parts, topology)
    faces = Elements.faces(topology, _looked_at(points, settings.frames))
    clusters = max(settings.clusters, round(1.5 * (parts or 1)))
    labels = _cluster(topology, faces, min(clusters, len(topology.faces)), settings)
    bodies = _Bodies.of(topology, faces, split_labels(topology, labels))
    _absorb_small_regions(bodies, settings)
    _merge(bodies, topology, parts, settings)
    return by_area(bodies.patches, faces.weights)


def _looked_at(points: FloatArray, frames: int) -> Float:
    """Return sampled frames ``(T, V, 3)``, centred, in diagonals of the first, or else of the largest."""
    x = points[frames_to_look_at(len(points), frames)].astype(np.float64)
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
    cells, cell_of_face = Elements.cells(topology, faces)
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
    def of(cls, topology: Topology, faces: Elements, patches: Index) -> _Bodies:
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
    rim = Rim.of(topology, bodies.patches)
    while parts is None or len(moments) > parts:
        bends = {(i, j): bends.get((i, j), -1.0) for i, j in bodies.borders}
        if not bends:
            break
        bends = {(i, j): b if b >= 0 else bend(turns[i], turns[j]) for (i, j), b in bends.items()}
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
